"""Problem: what is unknown, what was observed and how hard to look for it. Read from TOML, strictly."""

import dataclasses
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from datasets.errors import InputError
from datasets.library import SCENES, find, read_scene
from datasets.scene import Scene
from datasets.strict import Strict, from_mapping, read_toml
from inverse.unknowns import KINDS

PROBLEMS = Path(__file__).parent / "problems"


class Observable(StrEnum):
    """What of the deposit was measured."""

    FRONT = "front"
    """The x that 99.5 % of the points are behind."""
    RUNOUT = "runout"
    """The largest x."""
    PROFILE = "profile"
    """The height at stations along x."""


class Method(StrEnum):
    """How the loss is minimised."""

    GRADIENT_DESCENT = "gradient-descent"
    """The paper's: a fixed learning rate on the loss in m^2 with the angle in degrees."""
    LBFGSB = "lbfgs-b"
    """Bounded quasi-Newton (SciPy)."""


@dataclass(frozen=True, kw_only=True)
class Unknown(Strict):
    """A number to be found, in the units of its name."""

    name: str
    """One of `inverse.unknowns.KINDS`."""
    initial: float
    """Where the search starts."""
    lower: float
    """Smallest value allowed."""
    upper: float
    """Largest value allowed."""
    step: float = 0.05
    """Step of a finite difference; the default is the paper's 0.05 degrees."""


@dataclass(frozen=True, kw_only=True)
class ObservationSettings(Strict):
    """Which part of the deposit is compared."""

    kind: Observable
    spacing: float = 0.02
    """Distance between the stations of a profile [m]."""


@dataclass(frozen=True, kw_only=True)
class TargetSettings(Strict):
    """What was observed: exactly one of `value`, `trajectory`, `csv` and `hidden`."""

    value: float | None = None
    """The observed number [m], for a front or a runout."""
    trajectory: str | None = None
    """A trajectory (NPZ) whose last frame is the observed deposit."""
    csv: str | None = None
    """A measured profile: columns `x` and `height` [m], one header line."""
    hidden: bool = False
    """A twin experiment: the MPM makes the target, the inversion gets to see the observation alone."""
    seed: int = 1
    """Seed of the hidden scene's initial jitter; another one than the inversion's."""
    truth: dict[str, float] = field(default_factory=dict)
    """Unknown -> hidden value; the scene's own where absent."""
    noise: float = 0.0
    """Standard deviation of the measurement itself [m], besides the flow's own chance."""


@dataclass(frozen=True, kw_only=True)
class OptimiserSettings(Strict):
    """How the surrogate is inverted."""

    method: Method = Method.LBFGSB
    max_iterations: int = 20
    """Most evaluations of the loss and its gradient."""
    stop_below: float = 1.0e-7
    """Loss [m^2] at which the surrogate has done its part: (0.3 mm)^2; the paper stops at 5e-4, (22 mm)^2."""
    learning_rate: float = 500.0
    """Of gradient descent [deg^2/m^2]; the paper's."""


@dataclass(frozen=True, kw_only=True)
class LoopSettings(Strict):
    """How the MPM confirms or corrects (`validation.loop`)."""

    confirm_within: float = 0.005
    """Relative error of the front within which the MPM confirms."""
    profile_within: float = 0.01
    """Mean distance between equal shares of two profiles, over the target's mean, within which one is confirmed."""
    mpm_runs: int = 8
    """Most MPM runs that the loop may spend."""
    seeds: int = 16
    """Jitter seeds of the ensemble that says how certain the answer is."""
    trust: float = 0.15
    """Longest step between two MPM runs, as a fraction of an unknown's range."""


@dataclass(frozen=True, kw_only=True)
class _File(Strict):
    """A problem as it stands in its file."""

    scene: str
    unknowns: tuple[Unknown, ...]
    observation: ObservationSettings
    target: TargetSettings
    optimiser: OptimiserSettings = OptimiserSettings()
    loop: LoopSettings = LoopSettings()


@dataclass(frozen=True, kw_only=True)
class Problem:
    """An inverse problem, checked."""

    name: str
    """Stem of its file."""
    folder: Path
    """Relative paths in it start here."""
    scene: Scene
    """The flow; its own values of the unknowns are never shown to the inversion."""
    unknowns: tuple[Unknown, ...]
    """What to find, in the order of every vector of unknowns."""
    observation: ObservationSettings
    target: TargetSettings
    optimiser: OptimiserSettings = OptimiserSettings()
    loop: LoopSettings = LoopSettings()

    def __post_init__(self) -> None:
        check(self)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """(lower, upper) of each unknown."""
        return [(unknown.lower, unknown.upper) for unknown in self.unknowns]


def read_problem(name: str) -> Problem:
    """Read the problem at a path or of a shipped name. Raises InputError, which names the file and the key."""
    path = find(name, PROBLEMS, "problem")
    try:
        file = from_mapping(_File, read_toml(path))
        # A scene named by path lies beside the problem; a shipped one goes by its name.
        beside = path.parent / file.scene
        scene = read_scene(str(beside) if file.scene.endswith(".toml") else str(find(file.scene, SCENES, "scene")))
        parts: dict[str, Any] = {part.name: getattr(file, part.name) for part in dataclasses.fields(file)}
        return Problem(name=path.stem, folder=path.parent, **(parts | {"scene": scene}))
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None


def check(problem: Problem) -> None:
    """Raise InputError for a problem that cannot be solved: each key with what was expected of it."""

    def require(ok: bool, key: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=key)

    require(len(problem.unknowns) > 0, "unknowns", "at least one unknown", "none")
    names = [unknown.name for unknown in problem.unknowns]
    for index, unknown in enumerate(problem.unknowns):
        key = f"unknowns[{index}]"
        require(unknown.name in KINDS, f"{key}.name", f"one of {', '.join(KINDS)}", repr(unknown.name))
        require(names.count(unknown.name) == 1, f"{key}.name", "each unknown once", f"{unknown.name!r} twice")
        least, most = KINDS[unknown.name].limits
        require(least < unknown.lower, f"{key}.lower", f"a value above {least:g}", unknown.lower)
        require(unknown.upper < most, f"{key}.upper", f"a value below {most:g}", unknown.upper)
        require(unknown.lower < unknown.upper, f"{key}.upper", f"a value above {unknown.lower:g}", unknown.upper)
        require(
            unknown.lower <= unknown.initial <= unknown.upper,
            f"{key}.initial",
            f"a value in [{unknown.lower:g}, {unknown.upper:g}]",
            unknown.initial,
        )
        require(unknown.step > 0.0, f"{key}.step", "a positive step", unknown.step)
    length = problem.scene.domain.size[0]
    spacing = problem.observation.spacing
    require(0.0 < spacing <= length / 2, "observation.spacing", f"a length in (0, {length / 2:g}] m", spacing)
    _check_target(problem)
    optimiser, loop = problem.optimiser, problem.loop
    for key, number, least in (
        ("optimiser.max_iterations", optimiser.max_iterations, 1),
        ("loop.mpm_runs", loop.mpm_runs, 1),
        ("loop.seeds", loop.seeds, 2),
    ):
        require(number >= least, key, f"an integer of at least {least}", number)
    for key, value, most in (
        ("optimiser.stop_below", optimiser.stop_below, 1.0),
        ("optimiser.learning_rate", optimiser.learning_rate, 1e9),
        ("loop.confirm_within", loop.confirm_within, 1.0),
        ("loop.profile_within", loop.profile_within, 1.0),
        ("loop.trust", loop.trust, 1.0),
    ):
        require(0.0 < value <= most, key, f"a number in (0, {most:g}]", value)


def _check_target(problem: Problem) -> None:
    target = problem.target
    given = [name for name in ("value", "trajectory", "csv") if getattr(target, name) is not None]
    given += ["hidden"] if target.hidden else []
    if len(given) != 1:
        got = " and ".join(given) or "none"
        raise InputError(f"expected exactly one of value, trajectory, csv and hidden = true, got {got}", key="target")
    profile = problem.observation.kind is Observable.PROFILE
    if target.value is not None and profile:
        raise InputError("expected a trajectory, a csv or hidden = true for a profile", key="target.value")
    if target.value is not None and not 0.0 < target.value <= problem.scene.domain.size[0]:
        raise InputError(f"expected a length in (0, {problem.scene.domain.size[0]:g}] m", key="target.value")
    if target.csv is not None and not profile:
        raise InputError(f"expected value or trajectory for a {problem.observation.kind}", key="target.csv")
    if target.noise < 0.0:
        raise InputError(f"expected a standard deviation of at least 0 m, got {target.noise:g}", key="target.noise")
    if not target.hidden:
        if target.truth:
            raise InputError("expected hidden = true beside a truth", key="target.truth")
        return
    if target.seed < 0 or target.seed == problem.scene.seed:
        raise InputError(
            f"expected a seed of at least 0 and other than the scene's {problem.scene.seed}", key="target.seed"
        )
    names = [unknown.name for unknown in problem.unknowns]
    for name, value in target.truth.items():
        if name not in names:
            raise InputError(f"expected one of the unknowns {', '.join(names)}", key=f"target.truth.{name}")
        least, most = KINDS[name].limits
        if not least < value < most:
            raise InputError(f"expected a value in ({least:g}, {most:g}), got {value:g}", key=f"target.truth.{name}")
