"""The reference paper's numbers, read from `paper.toml`."""

from dataclasses import dataclass
from pathlib import Path

from datasets.records import Record, from_mapping, read_toml


@dataclass(frozen=True, kw_only=True)
class Scenario(Record):
    """The paper's results for one column."""

    name: str
    runout: float
    """Largest x of the deposit in its MPM [m]; the friction and damping behind it are not stated there."""
    phi_estimated: float
    phi_error_pct: float
    front_error_pct: float


@dataclass(frozen=True, kw_only=True)
class Velocity(Record):
    """The paper's results for ten layers: mean squared distances of the particles [m^2]."""

    mse_initial: float
    mse_surrogate: float
    mse_mpm: float
    """Of its MPM with the velocities found."""
    iterations: int


@dataclass(frozen=True, kw_only=True)
class Baffles(Record):
    """The paper's results for two baffles: squared distances of the toe [m^2]."""

    loss_initial: float
    loss_surrogate: float
    loss_mpm: float
    """Of its MPM with the positions found."""
    iterations: int
    z: tuple[float, float]
    """Where they ended [m], in the coordinates of our scene."""


@dataclass(frozen=True, kw_only=True)
class Paper(Record):
    """The paper's numbers (`paper.toml`)."""

    scenarios: tuple[Scenario, ...]
    seconds_per_iteration: dict[str, float]
    """By method: ad_gns, fd_gns, fd_mpm."""
    fd_gns_phi_estimated: float
    """Of the tall column at 42 degrees [deg]."""
    velocity: Velocity
    baffles: Baffles


def read_paper() -> Paper:
    """The paper's numbers."""
    return from_mapping(Paper, read_toml(Path(__file__).with_suffix(".toml")))
