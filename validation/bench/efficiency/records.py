"""What is measured, one record per measurement, and the file that keeps it: `efficiency.json`."""

import dataclasses
import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

from datasets.errors import InputError
from datasets.files import write_json
from datasets.processes import processors
from datasets.records import Record, from_mapping
from gns.library import shipped
from validation.report.page import GNS, MPM, machine

FILE = "efficiency.json"
AD, FD_GNS, FD_MPM, FD_JITTER = "AD, GNS", "differences, GNS", "differences, MPM", "differences, MPM, another jitter"
ADJOINT = "adjoint, MPM"
JITTERS = 4
"""Jitter seeds of the MPM's differences that other gradients are compared with."""
ADJOINT_MEAN = f"adjoint, MPM, mean of {JITTERS} jitters"
"""Methods of a gradient."""
LONG_STEPS = 400
"""As many as the rollouts whose gradient does not fit into the memory of the paper's GPU."""
AD_LONG = f"AD, GNS, {LONG_STEPS} steps"
"""Of a longer flow; the others are of one second."""


@dataclass(frozen=True, kw_only=True)
class Origin(Record):
    """On what a part was measured, and when."""

    machine: str
    date: str
    key: str
    """Hash of what the figures depend on: weights, processors, `--quick`."""
    quick: bool = False

    @staticmethod
    def here(*, quick: bool) -> "Origin":
        """This machine, today, with the weights that ship."""
        digest = hashlib.sha256(repr((processors(), quick)).encode())
        for dimension in (2, 3):
            digest.update(shipped(dimension).read_bytes())
        return Origin(
            machine=f"{machine(GNS | MPM)}; PyTorch and the MPM on {processors()} threads",
            date=date.today().isoformat(),
            key=digest.hexdigest()[:16],
            quick=quick,
        )


@dataclass(frozen=True, kw_only=True)
class CheckedLoss(Record):
    """What the MPM shows at the best iterate that a search had after some time."""

    seconds: float
    loss: float
    """Of a run whose jitter neither target nor search used."""


@dataclass(frozen=True, kw_only=True)
class MethodResult(Record):
    """The search of one method on one problem."""

    method: str
    optimiser: str
    forward: float
    """Mean seconds of an iteration's prediction."""
    backward: float
    """Mean seconds of the gradient on top of it."""
    paper: float | None
    """The paper's seconds per iteration."""
    iterations: int
    """Those of a sample not counted."""
    allowed: int
    """Most iterations by the problem's own rule."""
    ended: str
    mpm_runs: int
    """Whole runs of the search, checks not included."""
    seconds: float
    """Of the whole search, a surrogate's start included."""
    error: dict[str, float]
    """Of the unknowns, root mean square by unit; empty where the truth is not known."""
    curve: tuple[CheckedLoss, ...]
    """From the first iterate to the last improvement."""
    sample: int = 0
    """Predictions over the box before the first iteration."""

    @property
    def loss(self) -> float:
        """What the MPM shows at the answer."""
        return self.curve[-1].loss

    @property
    def per_iteration(self) -> float:
        """Seconds."""
        return self.forward + self.backward

    def seconds_to(self, loss: float) -> float:
        """When the MPM loss fell to `loss` and stayed there [s], inf where it did not."""
        above = [number for number, each in enumerate(self.curve) if each.loss > loss]
        first = above[-1] + 1 if above else 0
        return self.curve[first].seconds if first < len(self.curve) else float("inf")


@dataclass(frozen=True, kw_only=True)
class ProblemResult(Record):
    """All methods on one problem."""

    origin: Origin
    problem: str
    start: str
    rule: str
    """When a search ends."""
    limit: float
    """Seconds that each method may use."""
    floor: float | None
    """Loss that the MPM shows at the truth, by its own scatter; None where the truth is not known."""
    methods: tuple[MethodResult, ...]


@dataclass(frozen=True, kw_only=True)
class Gradient(Record):
    """One gradient by one method."""

    method: str
    unknowns: int
    seconds: float
    columns: int
    """Unknowns whose differences were run; the seconds of the others are taken to be the same."""
    cosine: float | None
    """Of the angle between it and the mean of the MPM's differences of `JITTERS` seeds, over those unknowns."""
    error: float | None
    """Its distance from that mean over the mean's norm, over those unknowns."""

    @property
    def extrapolated(self) -> bool:
        """Whether its seconds are those of some of the unknowns, multiplied."""
        return self.columns < self.unknowns


@dataclass(frozen=True, kw_only=True)
class OverUnknowns(Record):
    """The same column of sand cut into more and more blocks."""

    origin: Origin
    particles: int
    steps: dict[str, float]
    """Step of the differences by number of unknowns [m/s]."""
    gradients: tuple[Gradient, ...]


@dataclass(frozen=True, kw_only=True)
class Cost(Record):
    """Seconds and memory of one gradient in a scene of some size."""

    method: str
    particles: int
    """Of the MPM."""
    nodes: int
    """What the method itself computes with: the graph's nodes, the MPM's particles."""
    unknowns: int
    seconds: float
    memory: int
    """Peak above what the process held before [bytes]."""
    measured: str
    """What was run for it, where that was not all; else empty."""
    dimension: int = 2
    """Of the scene."""


@dataclass(frozen=True, kw_only=True)
class OverParticles(Record):
    """The tall column, larger and larger on the same cells."""

    origin: Origin
    costs: tuple[Cost, ...]


Part = ProblemResult | OverUnknowns | OverParticles


@dataclass(frozen=True, kw_only=True)
class Parts(Record):
    """All that is measured."""

    problems: dict[str, ProblemResult] = field(default_factory=dict)
    unknowns: OverUnknowns | None = None
    particles: OverParticles | None = None

    def all(self) -> Iterable[Part]:
        """The parts that there are."""
        return [*self.problems.values(), *(each for each in (self.unknowns, self.particles) if each is not None)]

    def get(self, name: str) -> Part | None:
        """A part by its name: that of a problem, unknowns or particles."""
        return self.problems.get(name) or {"unknowns": self.unknowns, "particles": self.particles}.get(name)

    def with_part(self, part: Part) -> "Parts":
        """With one more part, or in place of an older one."""
        if isinstance(part, ProblemResult):
            return dataclasses.replace(self, problems={**self.problems, part.problem: part})
        if isinstance(part, OverUnknowns):
            return dataclasses.replace(self, unknowns=part)
        return dataclasses.replace(self, particles=part)


def read(folder: Path) -> Parts:
    """FOLDER/efficiency.json, empty where there is none. Raises InputError."""
    path = folder / FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise InputError("expected the parts of a comparison")
        return from_mapping(Parts, data)
    except FileNotFoundError:
        return Parts()
    except json.JSONDecodeError as error:
        raise InputError(f"expected JSON, {error}; delete it to begin anew", where=str(path)) from None
    except InputError as error:
        raise error.at(str(path)) from None


def write(folder: Path, parts: Parts) -> None:
    """Write FOLDER/efficiency.json."""
    write_json(folder / FILE, dataclasses.asdict(parts))
