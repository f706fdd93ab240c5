"""What was measured, as it is kept in `efficiency.json` and told in `efficiency.md`."""

from dataclasses import dataclass

from datasets.records import Record


@dataclass(frozen=True, kw_only=True)
class Made(Record):
    """How a part was measured."""

    command: str
    machine: str
    date: str
    key: str
    """What figures depend on: weights, threads, limits. A part of another key is not gone on from."""
    quick: bool = False
    """A trial: shortened flows and searches, figures that say nothing."""


@dataclass(frozen=True, kw_only=True)
class Shown(Record):
    """What the MPM shows of the best that a method knew after some time."""

    seconds: float
    loss: float
    """Of a run whose jitter neither target nor search used [m^2]."""


@dataclass(frozen=True, kw_only=True)
class Row(Record):
    """One method on one problem."""

    method: str
    optimiser: str
    forward: float
    """Mean seconds of an iteration's prediction."""
    backward: float
    """Mean seconds of the gradient on top of it."""
    paper: float | None
    """The paper's seconds per iteration."""
    iterations: int
    allowed: int
    """Most iterations by the problem's own rule."""
    ended: str
    mpm_runs: int
    """Whole runs that the search made; the check is not among them."""
    seconds: float
    """Of the whole search, a surrogate's start included."""
    error: dict[str, float]
    """Of the unknowns, root mean square by unit; empty where the truth is not known."""
    curve: tuple[Shown, ...]
    """From the first answer to the last one."""

    @property
    def loss(self) -> float:
        """What the MPM shows at the answer [m^2]."""
        return self.curve[-1].loss

    @property
    def per_iteration(self) -> float:
        """Seconds."""
        return self.forward + self.backward

    def by(self, seconds: float) -> float | None:
        """What the MPM shows of the best known after `seconds` [m^2]; None before there was any."""
        return next((each.loss for each in reversed(self.curve) if each.seconds <= seconds), None)


@dataclass(frozen=True, kw_only=True)
class Race(Record):
    """All methods on one problem."""

    made: Made
    problem: str
    start: str
    rule: str
    limit: float
    """Seconds that each method may take."""
    floor: float | None
    """Loss that the MPM shows at the truth: no method can do better but by chance [m^2]."""
    rows: tuple[Row, ...]


@dataclass(frozen=True, kw_only=True)
class Gradient(Record):
    """One gradient by one method."""

    method: str
    unknowns: int
    seconds: float
    columns: int
    """Unknowns whose differences were run; the seconds of the others are taken to be the same."""
    cosine: float | None
    """Of the angle between it and the MPM's differences, over those unknowns."""
    error: float | None
    """Its distance from the MPM's differences over their length, over those unknowns."""

    @property
    def multiplied(self) -> bool:
        """Whether its seconds are those of some of the unknowns, multiplied."""
        return self.columns < self.unknowns


@dataclass(frozen=True, kw_only=True)
class OverUnknowns(Record):
    """The same heap cut into more and more blocks."""

    made: Made
    points: int
    steps: dict[str, float]
    """Step of the differences by number of unknowns [m/s]."""
    gradients: tuple[Gradient, ...]


@dataclass(frozen=True, kw_only=True)
class Cost(Record):
    """Seconds and memory of one gradient in a scene of some size."""

    method: str
    points: int
    """Of the MPM."""
    followed: int
    """Points that the method itself computes with."""
    unknowns: int
    seconds: float
    memory: int
    """Peak above what the process held before [bytes]."""
    measured: str
    """What was run for it, where that was not all; else empty."""


@dataclass(frozen=True, kw_only=True)
class OverPoints(Record):
    """The tall column, larger and larger on the same cells."""

    made: Made
    costs: tuple[Cost, ...]
