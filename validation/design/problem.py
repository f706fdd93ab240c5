"""A design problem: what may be chosen, what is uncertain, and below which limit a flow has to stay, how often.

minimise c . d    subject to    P(y(d, u, e) < L) >= p,    u ~ prior or posterior, e the jitter of the particles
"""

import dataclasses
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.stats import qmc

from datasets.arrays import read_arrays
from datasets.errors import InputError, naming, require
from datasets.files import reading
from datasets.forces import forces_of
from datasets.library import SCENES, find, read_scene, scene_from
from datasets.records import Record, from_mapping, read_toml
from datasets.scene import Scene
from datasets.trajectory import Trajectory, solid_names
from inverse.checks import check_bounds, check_number
from inverse.observations import KINDS, build
from inverse.parameters import Kind, Parameter, with_kinds
from inverse.posterior import Matrix, Row
from inverse.posterior.sampling import systematic
from inverse.problem import Bounds
from inverse.settings import ObservationSettings
from mpm import ALL, LAST, Recording

DESIGNS = Path(__file__).parent / "problems"
FORCE = "impact_force"
QUANTITIES = (*(name for name, each in KINDS.items() if each.scalar), FORCE)
FORCE_SCATTER = 0.1
"""Standard deviation of a peak force from flow to flow over its mean, before runs have measured it."""
ASSURANCE = 0.9
"""Probability with which a design passes its check for which the emulator is right."""


class Distribution(StrEnum):
    """Of an uncertain number, between its bounds."""

    UNIFORM = "uniform"
    NORMAL = "normal"
    LOGNORMAL = "lognormal"


@dataclass(frozen=True, kw_only=True)
class Prior(Record):
    """How an uncertain number is distributed."""

    kind: Distribution = Distribution.UNIFORM
    mean: float | None = None
    """Of the number itself, before it is cut off at the bounds; of a uniform one there is none."""
    deviation: float | None = None
    """Its standard deviation, likewise."""

    @property
    def frozen(self) -> Any:
        """The distribution of SciPy, before it is cut off."""
        mean, deviation = self.mean or 0.0, self.deviation or 1.0
        if self.kind == Distribution.NORMAL:
            return stats.norm(mean, deviation)
        # Of the logarithm: variance log(1 + (deviation / mean)^2), mean log(mean) less half of that.
        width = np.sqrt(np.log1p((deviation / mean) ** 2))
        return stats.lognorm(width, scale=mean * np.exp(-0.5 * width**2))

    def check(self, key: str) -> None:
        """Raise InputError for a distribution that is none."""
        for name in ("mean", "deviation"):
            value, uniform = getattr(self, name), self.kind == Distribution.UNIFORM
            expected = "none of a uniform prior" if uniform else f"a {name} of a {self.kind} prior"
            require((value is None) == uniform, f"{key}.{name}", expected, value)
            positive = name == "deviation" or self.kind == Distribution.LOGNORMAL
            require(value is None or value > 0.0 or not positive, f"{key}.{name}", "a positive number", value)


@dataclass(frozen=True, kw_only=True)
class Variable(Record):
    """A number that is chosen, one of `inverse.parameters`."""

    name: str
    lower: float
    upper: float

    @property
    def parameter(self) -> Parameter:
        """The same of an inversion."""
        return Parameter(name=self.name, lower=self.lower, upper=self.upper, initial=0.5 * (self.lower + self.upper))


@dataclass(frozen=True, kw_only=True)
class Uncertain(Variable):
    """A number that is not known when the barriers are built."""

    prior: Prior = field(default_factory=Prior)

    def at(self, levels: Row) -> Row:
        """Its quantiles at `levels` in [0, 1], shape as `levels`."""
        if self.prior.kind == Distribution.UNIFORM:
            return self.lower + (self.upper - self.lower) * levels
        frozen = self.prior.frozen
        low, high = frozen.cdf([self.lower, self.upper])
        return np.clip(frozen.ppf(low + (high - low) * levels), self.lower, self.upper)


@dataclass(frozen=True, kw_only=True)
class Limit(Record):
    """What has to stay below which value, and how often."""

    quantity: str
    """`front`, `runout`, `passed` (the share beyond `line`) or `impact_force`."""
    below: float
    """[m], [-], of a force [N, in 2D N per metre of width]."""
    probability: float = 0.95
    line: float | None = None
    """x [m], of `passed`."""
    solid: str | None = None
    """Of a force: on which baffle or solid, by its name; the largest on any where absent."""
    window: float = 0.0
    """Time [s] over which a force is averaged besides a frame."""

    @property
    def force(self) -> bool:
        """Whether it is a force, which is the peak of its magnitude."""
        return self.quantity == FORCE

    @property
    def record(self) -> Recording:
        """What it requires of a run."""
        return ALL if self.force else LAST

    @property
    def unit(self) -> str:
        """Of the quantity; in 2D that of a force is meant per metre of width."""
        return "N" if self.force else KINDS[self.quantity].unit

    @property
    def settings(self) -> ObservationSettings:
        """Of what is no force, as an observation."""
        return ObservationSettings(kind=self.quantity, line=self.line)

    def response(self, flow: Trajectory) -> float:
        """Of a run."""
        if not self.force:
            return float(build(self.settings, flow.scene).observe(flow)[0])
        forces = forces_of(flow, window=self.window)
        names = [self.solid] if self.solid is not None else solid_names(flow.scene)
        return max(forces.peaks[forces.names.index(each)][0] for each in names)

    def scatter(self, scene: Scene, responses: Row) -> float:
        """Expected standard deviation from flow to flow before repeated runs show it."""
        if self.force:
            return FORCE_SCATTER * max(float(np.mean(responses)), self.below)
        return float(build(self.settings, scene).prior_scatter(responses[:1])[0])

    def check(self, scene: Scene) -> None:
        """Raise InputError for a limit that flows of `scene` cannot have."""
        require(self.quantity in QUANTITIES, "limit.quantity", f"one of {', '.join(QUANTITIES)}", repr(self.quantity))
        top = {"front": scene.domain.size[0], "runout": scene.domain.size[0], "passed": 1.0}.get(self.quantity, np.inf)
        require(0.0 < self.below < top, "limit.below", f"a number in (0, {top:g})", self.below)
        require(0.5 <= self.probability < 1.0, "limit.probability", "a probability in [0.5, 1)", self.probability)
        for key in ("line", "solid", "window"):
            owner = "passed" if key == "line" else FORCE
            default = getattr(Limit, key) == getattr(self, key)
            require(default or self.quantity == owner, f"limit.{key}", f"it with {owner} alone", self.quantity)
        require(0.0 <= self.window <= scene.duration, "limit.window", f"up to {scene.duration:g} s", self.window)
        names = solid_names(scene)
        named = self.solid is None or self.solid in names
        require(named, "limit.solid", f"one of {', '.join(names) or 'none, the scene has no solids'}", self.solid)
        require(not self.force or len(names) > 0, "limit.quantity", "a scene with solids", "none")
        if not self.force:
            try:
                build(self.settings, scene)
            except InputError as error:
                raise InputError(error.message, key=f"limit.{error.key}") from None


@dataclass(frozen=True, kw_only=True)
class Budget(Record):
    """What the MPM may spend."""

    runs: int | None = None
    """Runs for the emulator, at most; 20 and 20 for each number, chosen or uncertain, where absent."""
    checks: int = 100
    """Runs at the design, each of a fresh draw."""
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class _File(Record):
    """A design problem as it stands in its file."""

    scene: str | dict[str, Any]
    variables: tuple[Variable, ...]
    uncertain: tuple[Uncertain, ...] = ()
    posterior: str | None = None
    limit: Limit
    cost: dict[str, float] = field(default_factory=dict)
    budget: Budget = field(default_factory=Budget)


@dataclass(frozen=True, kw_only=True)
class DesignProblem:
    """A design problem, checked. Raises InputError, which names the key."""

    name: str
    scene: Scene
    variables: tuple[Variable, ...]
    """What is chosen: d, K numbers."""
    uncertain: tuple[Uncertain, ...]
    """What is not known: u, Q numbers."""
    samples: Matrix | None = None
    """Of the posterior of the last of these, of equal weight, shape [S, Q']."""
    limit: Limit
    cost: dict[str, float] = field(default_factory=dict)
    """Variable -> the price of a unit of it; without any the most reliable design is looked for."""
    budget: Budget = field(default_factory=Budget)

    def __post_init__(self) -> None:
        keyed: dict[str, Variable] = {f"variables[{index}]": each for index, each in enumerate(self.variables)}
        keyed |= {f"uncertain[{index}]": each for index, each in enumerate(self.uncertain)}
        require(len(self.variables) > 0, "variables", "at least one variable", "none")
        require(len(self.uncertain) > 0, "uncertain", "at least one uncertain number, or a posterior", "none")
        names = [each.name for each in self.numbers]
        for key, each in keyed.items():
            require(names.count(each.name) == 1, f"{key}.name", "each number once", f"{each.name!r} twice")
            check_number(self.scene, each.parameter, key)
            if isinstance(each, Uncertain):
                each.prior.check(f"{key}.prior")
        check_bounds(self.scene, {key: each.parameter for key, each in keyed.items()}, "variables")
        self.limit.check(self.scene)
        for name in self.cost:
            known = names[: len(self.variables)]
            require(name in known, f"cost.{name}", f"one of the variables {', '.join(known)}", name)
        for key, number, least in (
            ("runs", self.runs, 4 * len(names)),
            ("checks", self.budget.checks, 20),
            ("seed", self.budget.seed, 0),
        ):
            require(number >= least, f"budget.{key}", f"an integer of at least {least}", number)

    @property
    def numbers(self) -> tuple[Variable, ...]:
        """Chosen, then uncertain: K + Q."""
        return (*self.variables, *self.uncertain)

    @cached_property
    def kinds(self) -> list[Kind]:
        """What they are."""
        return [each.parameter.kind for each in self.numbers]

    @cached_property
    def box(self) -> Bounds:
        """Of all of them."""
        return Bounds(*np.array([(each.lower, each.upper) for each in self.numbers]).T)

    @property
    def runs(self) -> int:
        """Runs for the emulator, at most."""
        return 20 + 20 * len(self.numbers) if self.budget.runs is None else self.budget.runs

    @property
    def allowed(self) -> int:
        """Flows of the check that may exceed the limit: a share of 1 - p."""
        return int((1.0 - self.limit.probability) * self.budget.checks + 1e-9)

    @property
    def required(self) -> float:
        """The probability that a design is to have: so far above p that it passes the check by `ASSURANCE`."""
        return 1.0 - float(stats.beta.ppf(1.0 - ASSURANCE, self.allowed + 1, self.budget.checks - self.allowed))

    def named(self, design: Row) -> dict[str, float]:
        """The variables by name of a design [K] in fractions of the ranges."""
        values = self.box.lower[: len(design)] + self.box.range[: len(design)] * design
        return {each.name: float(value) for each, value in zip(self.variables, values, strict=True)}

    def price(self, designs: Matrix) -> Row:
        """c . d of designs [S, K] in fractions of their ranges, shape [S]; 0 without a cost."""
        known = len(self.variables)
        values = self.box.lower[:known] + self.box.range[:known] * designs
        return np.asarray(values @ np.array([self.cost.get(each.name, 0.0) for each in self.variables]))

    def draws(self, count: int, rng: np.random.Generator) -> Matrix:
        """Draws of what is uncertain, in fractions of the ranges: one in each of `count` parts, shape [count, Q].

        The parts are as likely, of every number (McKay, Beckman & Conover, A comparison of three methods for selecting
        values of input variables, Technometrics 21 (1979) 239-245); those of a posterior, of the first of its numbers.
        """
        joint = 0 if self.samples is None else self.samples.shape[1]
        alone = self.uncertain[: len(self.uncertain) - joint]
        levels = qmc.LatinHypercube(len(alone) + (joint > 0), rng=rng).random(count)
        values = [each.at(level) for each, level in zip(alone, levels.T, strict=False)]
        if self.samples is not None:
            ordered = self.samples[np.argsort(self.samples[:, 0])]
            values += [*ordered[(levels[:, -1] * len(ordered)).astype(int)].T]
        known = len(self.variables)
        return np.asarray((np.stack(values, axis=1) - self.box.lower[known:]) / self.box.range[known:])

    def scene_at(self, values: Row, seed: int) -> Scene:
        """The scene with all numbers [K + Q] and a jitter seed."""
        return dataclasses.replace(with_kinds(self.scene, self.kinds, values), seed=seed)


def read_design(name: str | Path) -> DesignProblem:
    """Read the design problem at a path or of a shipped name. Raises InputError, which names the file and the key."""
    path = find(str(name), DESIGNS, "design problem")
    with naming(path):
        file = from_mapping(_File, read_toml(path))
        own = {each.name: getattr(file, each.name) for each in dataclasses.fields(file)}
        if (posterior := own.pop("posterior")) is not None:
            own["samples"], learned = read_posterior(path.parent / posterior)
            own["uncertain"] += learned
        if isinstance(file.scene, dict):
            with naming(path, "scene"):
                own["scene"] = scene_from(file.scene, path.parent)
        else:
            beside = str(path.parent / file.scene)
            own["scene"] = read_scene(
                beside if file.scene.endswith(".toml") else str(find(file.scene, SCENES, "scene"))
            )
        return DesignProblem(name=path.stem, **own)


def read_posterior(path: Path) -> tuple[Matrix, tuple[Uncertain, ...]]:
    """Samples [S, Q'] of a posterior of `validation.loop`, drawn again to equal weights, and their numbers."""
    found = read_arrays(path, "names", "samples", "weights", what="the posterior of validation.loop")
    with reading(path, "the posterior of validation.loop"):
        samples, weights = found["samples"].astype(float), found["weights"].astype(float)
        samples = samples[systematic(weights / weights.sum(), len(weights), np.random.default_rng(0))]
        ranges = zip(map(str, found["names"]), samples.min(axis=0), samples.max(axis=0), strict=True)
        return samples, tuple(Uncertain(name=name, lower=float(low), upper=float(high)) for name, low, high in ranges)
