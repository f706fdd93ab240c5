"""The result of a problem as its folder holds it: `result.json`, and by which command and model it was made."""

import dataclasses
import hashlib
import math
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from datasets.errors import InputError
from datasets.files import write_json
from datasets.records import Record, from_mapping, read_json
from gns.library import shipped
from inverse.problem import Problem
from validation.report.page import GNS, MPM, machine

RESULT, ORIGIN = "result.json", "origin.json"


@dataclass(frozen=True, kw_only=True)
class Origin(Record):
    """How a result was made."""

    command: str
    machine: str
    date: str
    problem: str
    """Digest of the problem as it was read."""
    weights: str
    """Digest of the surrogate's file."""
    resumed: bool
    """Whether MPM runs of an earlier start were there: the total does not count their seconds then."""

    @staticmethod
    def from_problem(problem: Problem, command: str, folder: Path) -> "Origin":
        """The origin of a result that is about to be made in `folder`."""
        return Origin(
            command=command,
            machine=machine(MPM | GNS),
            date=date.today().isoformat(),
            problem=digest(repr(dataclasses.replace(problem, folder=Path())).encode()),
            weights=digest(shipped(problem.scene.dimension).read_bytes()),
            resumed=any((folder / "mpm").glob("*.npz")),
        )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A result with the problem that it belongs to."""

    problem: Problem
    folder: Path
    result: dict[str, Any]
    """The contents of `result.json`."""
    origin: Origin | None
    """Absent where the loop was called by itself."""

    @property
    def half_widths(self) -> dict[str, float]:
        """Half-widths; infinite where the file has none; empty without an ensemble."""
        found = self.result.get("certainty") or {}
        return {name: math.inf if value is None else value for name, value in found.items()}

    @property
    def errors(self) -> dict[str, float]:
        """Errors of the parameters in their units; empty where the truth is not known."""
        truth = self.result.get("truth") or {}
        return {name: abs(self.result["unknowns"][name] - value) for name, value in truth.items()}

    @property
    def inside(self) -> list[str]:
        """The parameters whose true value is within their half-width."""
        return [name for name, error in self.errors.items() if error <= self.half_widths.get(name, -1.0)]

    @property
    def front_error_pct(self) -> float | None:
        """Of the MPM at the answer."""
        found: float | None = self.result["error_pct"].get("front")
        return found

    def percent(self, values: dict[str, float]) -> float:
        """The largest of `values` by parameter over the true values [%]."""
        truth = self.result["truth"]
        return max(100.0 * value / abs(truth[name]) if truth[name] else math.inf for name, value in values.items())


def read(problem: Problem, folder: Path) -> Outcome | None:
    """The outcome in `folder`, None where there is none of this problem. Raises InputError for a broken file."""
    result = read_json(folder / RESULT)
    if result is None or result.get("problem") != problem.name:
        return None
    origin = read_json(folder / ORIGIN)
    try:
        known = None if origin is None else from_mapping(Origin, origin)
    except InputError as error:
        raise error.at(str(folder / ORIGIN)) from None
    return Outcome(problem=problem, folder=folder, result=result, origin=known)


def is_current(outcome: Outcome) -> bool:
    """Whether it is of its problem as it is now and, as far as is known, of today's surrogate."""
    if outcome.origin is None:
        return True
    now = Origin.from_problem(outcome.problem, "", outcome.folder)
    return (outcome.origin.problem, outcome.origin.weights) == (now.problem, now.weights)


def write_origin(origin: Origin, folder: Path) -> None:
    """Write it beside the result."""
    write_json(folder / ORIGIN, dataclasses.asdict(origin))


def digest(content: bytes) -> str:
    """The beginning of a SHA-256."""
    return hashlib.sha256(content).hexdigest()[:16]
