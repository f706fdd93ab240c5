"""`efficiency.json`: the parts that were measured; each is kept when it is done, so that a cut run goes on."""

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from datasets.errors import InputError
from datasets.files import write_json
from datasets.records import Record, from_mapping
from validation.bench.efficiency.rows import Made, OverPoints, OverUnknowns, Race

FILE = "efficiency.json"


@dataclass(frozen=True, kw_only=True)
class Parts(Record):
    """All that is known."""

    races: dict[str, Race] = field(default_factory=dict)
    """By problem."""
    unknowns: OverUnknowns | None = None
    points: OverPoints | None = None

    def made(self, name: str) -> Made | None:
        """How a part was measured, if it was."""
        part = self.races.get(name) or {"unknowns": self.unknowns, "points": self.points}.get(name)
        return None if part is None else part.made

    def with_part(self, part: Race | OverUnknowns | OverPoints) -> "Parts":
        """With one more part, or another one in its place."""
        if isinstance(part, Race):
            return dataclasses.replace(self, races={**self.races, part.problem: part})
        if isinstance(part, OverUnknowns):
            return dataclasses.replace(self, unknowns=part)
        return dataclasses.replace(self, points=part)


def read(folder: Path) -> Parts:
    """What FOLDER/efficiency.json has, nothing where there is none. Raises InputError."""
    path = folder / FILE
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return Parts()
    try:
        data = json.loads(text)
        if not isinstance(data, dict):
            raise InputError("expected the parts of a comparison")
        return from_mapping(Parts, data)
    except json.JSONDecodeError as error:
        raise InputError(f"expected JSON, {error}; delete it to begin anew", where=str(path)) from None
    except InputError as error:
        raise error.at(str(path)) from None


def write(folder: Path, parts: Parts) -> None:
    """Keep all parts."""
    write_json(folder / FILE, dataclasses.asdict(parts))


def key(models: Sequence[Path], *settings: object) -> str:
    """What a part's figures depend on, in a word. Raises InputError where there is no such model."""
    digest = hashlib.sha256(repr(settings).encode())
    for model in models:
        try:
            digest.update(model.read_bytes())
        except OSError:
            raise InputError("expected the weights of a surrogate, there are none", where=str(model)) from None
    return digest.hexdigest()[:16]
