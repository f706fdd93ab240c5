"""Fronts of columns by several codes, as `peers.toml` holds them."""

from dataclasses import dataclass
from pathlib import Path

from datasets.records import Record, from_mapping, read_toml

PUBLISHED = Path(__file__).with_name("peers.toml")


@dataclass(frozen=True, kw_only=True)
class Code(Record):
    """Another code."""

    name: str
    repository: str
    commit: str
    settings: str


@dataclass(frozen=True, kw_only=True)
class Front(Record):
    """A column that came to rest, in units of its length L."""

    code: str
    transfer: str
    aspect: float
    """H / L."""
    cells: int
    """Across the smaller of L and H."""
    seed: int
    front: float
    """(x - L) / L of 99.5 % of the particles."""
    runout: float
    """The same of the furthest."""
    height: float
    """h / L at the axis."""

    @property
    def name(self) -> str:
        """Code and transfer."""
        return f"{self.code} {self.transfer}"


@dataclass(frozen=True, kw_only=True)
class Peers(Record):
    """The contents of `peers.toml`."""

    codes: tuple[Code, ...]
    fronts: tuple[Front, ...]


def read_peers() -> Peers:
    """What other codes found."""
    return from_mapping(Peers, read_toml(PUBLISHED))
