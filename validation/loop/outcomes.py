"""What a run of `python -m validation.loop` has left in its folder, and where it came from."""

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from datasets.errors import InputError
from datasets.files import write_json
from datasets.records import Record, from_mapping
from gns.inference import shipped
from inverse.problem import Problem
from inverse.result import Purpose
from inverse.settings import ONE_NUMBER
from validation.report.machine import GNS, MPM, machine

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
    def of(problem: Problem, command: str, folder: Path) -> "Origin":
        """The origin of a result that is about to be made in `folder`."""
        return Origin(
            command=command,
            machine=machine(MPM | GNS),
            date=date.today().isoformat(),
            problem=digest(repr(dataclasses.replace(problem, folder=Path())).encode()),
            weights=digest(shipped(problem.scene.dimension).read_bytes()),
            resumed=any((folder / "mpm").glob("*.npz")),
        )

    def same(self, other: "Origin") -> bool:
        """Whether both are of the same problem and the same surrogate."""
        return (self.problem, self.weights) == (other.problem, other.weights)

    def write(self, folder: Path) -> None:
        """Write it beside the result."""
        write_json(folder / ORIGIN, dataclasses.asdict(self))


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A result as its file tells it, with the problem that it belongs to."""

    problem: Problem
    folder: Path
    result: dict[str, Any]
    origin: Origin | None
    """Absent where somebody else called the loop."""

    @property
    def verdict(self) -> str:
        """`inverse.result.Verdict`, as a string."""
        return str(self.result["verdict"])

    @property
    def unknowns(self) -> dict[str, float]:
        """The answer."""
        return dict(self.result["unknowns"])

    @property
    def certainty(self) -> dict[str, float] | None:
        """Half-widths; infinite where the file has none."""
        found = self.result.get("certainty")
        return found and {name: math.inf if value is None else value for name, value in found.items()}

    @property
    def truth(self) -> dict[str, float] | None:
        """True values, where known."""
        return self.result.get("truth") or None

    @property
    def loss(self) -> float | None:
        """Of the MPM at the answer."""
        found: float | None = self.result["loss"]["mpm"]
        return found

    @property
    def front_error_pct(self) -> float | None:
        """Of the MPM at the answer."""
        found: float | None = self.result["error_pct"].get("front")
        return found

    @property
    def seconds(self) -> dict[str, float]:
        """See docs/formats.md."""
        return dict(self.result["seconds"])

    @property
    def checks(self) -> int:
        """MPM runs that counted against the budget."""
        return sum(run["purpose"] == Purpose.CHECK for run in self.result["mpm_runs"])

    @property
    def alone(self) -> dict[str, Any]:
        """The first MPM run: where the surrogate ended before any of them corrected it."""
        return next(run for run in self.result["mpm_runs"] if run["purpose"] == Purpose.CHECK)

    @property
    def ensemble(self) -> int:
        """MPM runs for the certainty."""
        return len(self.result["mpm_runs"]) - self.checks

    @property
    def many(self) -> bool:
        """Whether what was observed is more than a number."""
        return self.problem.observation.kind not in ONE_NUMBER

    @property
    def inside(self) -> list[str]:
        """The unknowns whose true value lies within their half-width."""
        truth, widths = self.truth or {}, self.certainty or {}
        return [name for name, value in self.unknowns.items() if abs(value - truth[name]) <= widths.get(name, -1.0)]

    def error(self, name: str) -> float:
        """Of an unknown, in its unit."""
        return abs(self.unknowns[name] - (self.truth or {})[name])

    def error_pct(self, name: str) -> float:
        """Relative error of an unknown."""
        return self._percent(self.error(name), name)

    def half_width_pct(self, name: str) -> float:
        """Half-width of an unknown over its true value."""
        return self._percent((self.certainty or {}).get(name, math.inf), name)

    def _percent(self, value: float, name: str) -> float:
        scale = abs((self.truth or {})[name])
        return 100.0 * value / scale if scale > 0.0 else math.inf


def read(problem: Problem, folder: Path) -> Outcome | None:
    """The outcome in `folder`, None where there is none of this problem. Raises InputError for a broken file."""
    result = _read_json(folder / RESULT)
    if result is None or result.get("problem") != problem.name:
        return None
    return Outcome(problem=problem, folder=folder, result=result, origin=read_origin(folder))


def read_origin(folder: Path) -> Origin | None:
    """The origin of the result in `folder`. Raises InputError."""
    found = _read_json(folder / ORIGIN)
    try:
        return None if found is None else from_mapping(Origin, found)
    except InputError as error:
        raise error.at(str(folder / ORIGIN)) from None


def digest(content: bytes) -> str:
    """Enough of a SHA-256 to tell two of them apart."""
    return hashlib.sha256(content).hexdigest()[:16]


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"expected readable JSON, {error}", where=str(path)) from None
    if not isinstance(found, dict):
        raise InputError("expected a JSON object", where=str(path))
    return found
