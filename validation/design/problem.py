"""A design problem: its design variables, its uncertain numbers, and the limit that flows keep with a probability.

minimise c . d    subject to    P(y(d, u, e) < L) >= p,    u ~ prior or posterior, e the jitter of the particles
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from scipy import stats
from scipy.stats import qmc

from datasets.errors import keyed, naming, require
from datasets.files import read_toml
from datasets.flow.array_files import read_arrays
from datasets.flow.trajectory import Trajectory, solid_names
from datasets.forces import forces_of
from datasets.scene import Scene
from datasets.scene.library import find, read_scene, scene_from
from datasets.schema import Bounds, Record, from_mapping
from inverse.observations.observation import SCATTER_CELLS
from inverse.parameters import Kind, Parameter, check_parameters, with_kinds
from inverse.parameters.field import UnknownField
from inverse.parameters.prior import Correlation, JointPrior
from inverse.posterior import Matrix, Row
from inverse.problem import Box, read_problem
from inverse.saving import known_of
from inverse.search.waves import jitter_seed
from inverse.settings import counted

DESIGNS = Path(__file__).parent / "problems"
FORCE_SCATTER = 0.1
"""Standard deviation of a peak force from flow to flow, over the limit, before runs have measured it."""
ASSURANCE = 0.9  # probability that a design passes its check if the emulator is right


@dataclass(frozen=True, kw_only=True)
class Limit(Record):
    """A limit: a quantity, the value that it stays below, and with which probability."""

    quantity: Literal["front", "runout", "impact_force"]
    """Front or runout of the deposit [m]; or the largest mean force between two frames [N, in 2D N/m of width]."""
    below: float
    """[m, N or N/m]; a front or runout in map coordinates if the box of the scene has an origin."""
    probability: Annotated[float, Bounds("a probability in [0.5, 1)", ge=0.5, lt=1.0)] = 0.95
    solid: str | None = None
    """For a force: the name of the baffle or solid that it acts on; by default, the one with the largest force."""
    window: float = 0.0
    """Time [s] over which a force is averaged in addition."""

    @property
    def force(self) -> bool:
        return self.quantity == "impact_force"

    @property
    def folder(self) -> str:
        """Folder of the runs, one for each limited quantity: the summaries of runs hold only that quantity."""
        return f"{self.quantity}-{zlib.crc32(repr((self.solid, self.window)).encode()):08x}"

    def kept(self, flow: Trajectory) -> Trajectory:
        """The deposit of a run; if a force is limited, with the force in its summary."""
        if not self.force:
            return flow
        largest = forces_of(flow, window=self.window).largest
        solids = [self.solid] if self.solid else solid_names(flow.scene)
        return flow.ending({self.quantity: max(largest[name] for name in solids)})

    def scatter(self, scene: Scene) -> float:
        """Expected standard deviation from flow to flow, before repeated runs have measured it."""
        return FORCE_SCATTER * self.below if self.force else SCATTER_CELLS * scene.domain.cell

    def check(self, scene: Scene) -> None:
        """Raise InputError for a limit that flows of `scene` cannot have."""
        low, length = (0.0, np.inf) if self.force else (float(scene.domain.corner[0]), scene.domain.size[0])
        on_map = not self.force and scene.domain.origin is not None
        place = ", an x on the map, as the origin of the box" if on_map else ""
        expected = f"a number in ({low:.10g}, {low + length:.10g}){place}"
        require(low < self.below < low + length, "limit.below", expected, self.below)
        plain = self.solid is None and self.window == 0.0
        require(plain or self.force, "limit.quantity", "impact_force beside solid or window", self.quantity)
        require(0.0 <= self.window <= scene.duration, "limit.window", f"up to {scene.duration:g} s", self.window)
        if self.force:
            names = solid_names(scene)
            expected = f"one of {', '.join(names)}" if names else "a scene with solids"
            require(bool(names) and self.solid in (None, *names), "limit.solid", expected, repr(self.solid))


@dataclass(frozen=True, kw_only=True)
class Budget(Record):
    """The budget of MPM runs."""

    runs: Annotated[int | None, counted(1)] = None
    """Largest number of runs for the emulator; by default 20 plus 20 for each variable and uncertain number."""
    checks: Annotated[int, counted(20)] = 100
    """Runs at the design, each with a fresh draw."""
    seed: Annotated[int, counted(0, 2**62)] = 0
    """Seed of the random numbers."""
    predictions: Annotated[int, counted(1000)] = 10_000
    """Number of predictions by a surrogate, if one is used."""
    pairs: Annotated[int, counted(4)] = 8
    """MPM runs that measure the errors of a surrogate before it predicts."""


@dataclass(frozen=True, kw_only=True)
class _Keys(Record):
    """The keys that a design problem and its file have in common."""

    variables: tuple[Parameter, ...]
    """Design variables: d, K numbers."""
    uncertain: tuple[Parameter, ...] = ()
    """Numbers that are unknown when the barriers are built: u, Q numbers."""
    correlations: tuple[Correlation, ...] = ()
    """Correlations of pairs of their priors."""
    limit: Limit
    surrogate: Literal["none", "gns", "coarse"] = "none"
    """The predictor of thousands of flows (`validation.design.race`): the learned surrogate, or the MPM on cells twice
    as large; "none": an emulator of MPM runs instead."""
    cost: dict[str, float] = field(default_factory=dict)
    """Variable -> price per unit; without any price, the most reliable design is sought."""
    budget: Budget = field(default_factory=Budget)


@dataclass(frozen=True, kw_only=True)
class FieldFile(Record):
    """Unknown fields, given by draws from their posterior."""

    problem: str
    """The inverse problem whose unknowns they are: a path or a shipped name."""
    draws: str
    """`field.npz` of its result."""


@dataclass(frozen=True, kw_only=True)
class DesignFile(_Keys):
    """A design problem as its file states it."""

    scene: str | dict[str, Any]
    posterior: str | None = None
    fields: FieldFile | None = None


@dataclass(frozen=True, kw_only=True)
class DesignProblem(_Keys):
    """A design problem, checked. Raises InputError, which names the key."""

    name: str
    scene: Scene
    samples: Matrix | None = None
    """Samples of equal weight from a posterior of the last Q' uncertain numbers, shape [S, Q']."""
    fields: tuple[tuple[UnknownField, Matrix], ...] = ()
    """Unknown fields, each with S draws from its posterior, shape [S, K]; draws of the same index belong together."""
    remarks: Sequence[str] = ()
    """Remarks on the posterior, a sentence each."""

    def __post_init__(self) -> None:
        by_key = dict[str, Parameter]()
        for group, members in {"variables": self.variables, "uncertain": self.uncertain}.items():
            some = len(members) > 0 or (group == "uncertain" and bool(self.fields))
            require(some, group, "at least one number", "none")
            by_key |= {f"{group}[{index}]": parameter for index, parameter in enumerate(members)}
        for key, parameter in by_key.items():
            require(parameter.initial is None, f"{key}.initial", "no start of a search", parameter.initial)
            require(not parameter.is_field, f"{key}.spacing", "a number", "a field")
        for index, variable in enumerate(self.variables):
            require(variable.prior is None, f"variables[{index}].prior", "no prior of what is chosen", "one")
        check_parameters(self.scene, by_key, "variables")
        _ = self.prior
        self.limit.check(self.scene)
        names = [variable.name for variable in self.variables]
        for name in self.cost:
            require(name in names, f"cost.{name}", f"one of the variables {', '.join(names)}", name)
        fewest, predicted = 4 * len(self.numbers), self.surrogate != "none" or not self.fields
        require(self.runs >= fewest, "budget.runs", f"an integer of at least {fewest}", self.runs)
        require(predicted, "surrogate", "gns or coarse beside fields, which no emulator of runs knows", "none")

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """The variables, then the uncertain numbers: K + Q."""
        return (*self.variables, *self.uncertain)

    @cached_property
    def kinds(self) -> list[Kind]:
        return [number.kind for number in self.numbers]

    @cached_property
    def box(self) -> Box:
        """The ranges of all numbers and, if there are fields, of the index of their draw as a share in [0, 1]."""
        return Box(*np.array([*(number.bounds for number in self.numbers), *([(0.0, 1.0)] if self.fields else [])]).T)

    @property
    def joint(self) -> int:
        """Q', the number of uncertain numbers that come from a posterior."""
        return 0 if self.samples is None else self.samples.shape[1]

    @cached_property
    def prior(self) -> JointPrior | None:
        """The prior of the uncertain numbers that come from no posterior. Raises InputError, which names the key."""
        alone = self.uncertain[: len(self.uncertain) - self.joint]
        return JointPrior({number.name: number.marginal for number in alone}, self.correlations) if alone else None

    @property
    def unit(self) -> str:
        """Unit of the limited quantity."""
        return ("N/m" if self.scene.dimension == 2 else "N") if self.limit.force else "m"

    @property
    def runs(self) -> int:
        """Largest number of runs for the emulator."""
        return 20 + 20 * len(self.numbers) if self.budget.runs is None else self.budget.runs

    @property
    def allowed(self) -> int:
        """Number of flows in the check that may exceed the limit: a share of 1 - p."""
        return int((1.0 - self.limit.probability) * self.budget.checks + 1e-9)

    @property
    def required(self) -> float:
        """The required probability of a design: above p, so that it passes the check with probability `ASSURANCE`."""
        return 1.0 - float(stats.beta.ppf(1.0 - ASSURANCE, self.allowed + 1, self.budget.checks - self.allowed))

    def named(self, design: Row) -> dict[str, float]:
        """Variable name -> value, for a design [K] in fractions of the ranges."""
        names = (variable.name for variable in self.variables)
        return dict(zip(names, self.values(design).tolist(), strict=True))

    def values(self, designs: Matrix) -> Matrix:
        """The variables in their own units, shape [..., K], of designs [..., K] in fractions of the ranges."""
        count = len(self.variables)
        return np.asarray(self.box.lower[:count] + self.box.range[:count] * designs)

    def price(self, designs: Matrix) -> Row:
        """The cost c . d, shape [...], of designs [..., K] in fractions of the ranges; 0 without prices."""
        prices = np.array([self.cost.get(variable.name, 0.0) for variable in self.variables])
        return np.asarray(self.values(designs) @ prices)

    def draws(self, count: int, rng: np.random.Generator) -> Matrix:
        """Stratified draws of the uncertain numbers, in fractions of the ranges, shape [count, Q]. Each number, of a
        posterior only the first, has one draw in each of `count` equally likely strata (McKay et al., A comparison of
        three methods for selecting values of input variables, Technometrics 21 (1979) 239-245)."""
        alone, offset = len(self.uncertain) - self.joint, len(self.variables)
        levels = qmc.LatinHypercube(alone + (self.joint > 0) + bool(self.fields), rng=rng).random(count)
        parts = [] if self.prior is None else [self.prior.at(levels[:, :alone])]
        if self.samples is not None:
            ordered = (self.samples - self.box.lower[offset + alone :]) / self.box.range[offset + alone :]
            parts.append(ordered[np.argsort(ordered[:, 0])][(levels[:, alone] * len(ordered)).astype(int)])
        if self.fields:
            parts.append(levels[:, -1:])
        return np.concatenate(parts, axis=1)

    def scene_at(self, values: Row, seed: int) -> Scene:
        """The scene with all numbers [K + Q] and a jitter seed."""
        scene = with_kinds(self.scene, self.kinds, values[: len(self.numbers)])
        for unknown, draws in self.fields:
            scene = unknown.put(scene, draws[min(int(values[-1] * len(draws)), len(draws) - 1)])
        return replace(scene, seed=seed)

    def scenes_at(self, points: Matrix, first: int) -> list[Scene]:
        """The scenes at points [n, K + Q] in fractions of the ranges, rounded to a millionth: they identify a run.
        first: number of the first flow, which determines its jitter seed."""
        rows = enumerate(self.box.at(np.round(points, 6)), first)
        return [self.scene_at(row, jitter_seed(self.scene.seed, number)) for number, row in rows]


def with_draws(designs: Matrix, draws: Matrix) -> Matrix:
    """All numbers [S n, K + Q]: each design [S, K], or one [K], with each of draws [n, Q] of the uncertain numbers."""
    designs = np.atleast_2d(designs)
    return np.hstack([np.repeat(designs, len(draws), axis=0), np.tile(draws, (len(designs), 1))])


def read_design(name: str | Path) -> DesignProblem:
    """Read a design problem from a path or by a shipped name. Raises InputError, which names the file and the key."""
    path = find(name, DESIGNS, "design problem")
    with naming(path):
        file = from_mapping(DesignFile, read_toml(path))
        keys = dict(vars(file))
        keys["fields"] = () if file.fields is None else read_fields(file.fields, path.parent)
        if isinstance(file.scene, str):
            keys["scene"] = read_scene(path.parent / file.scene if file.scene.endswith(".toml") else file.scene)
        else:
            keys["scene"] = scene_from(file.scene, path.parent)
        if (posterior := keys.pop("posterior")) is not None:
            names, samples, keys["remarks"] = known_of(path.parent / posterior, keys["scene"])
            ranges = zip(names, samples.min(axis=0).tolist(), samples.max(axis=0).tolist(), strict=True)
            keys["uncertain"] += tuple(Parameter(name=name, lower=low, upper=high) for name, low, high in ranges)
            keys["samples"] = samples
        return DesignProblem(name=path.stem, **keys)


def read_fields(file: FieldFile, folder: Path) -> tuple[tuple[UnknownField, Matrix], ...]:
    """The unknown fields of an inverse problem with their draws. Raises InputError."""
    path = folder / file.problem
    with keyed("fields"):
        unknowns = read_problem(str(path) if file.problem.endswith(".toml") else file.problem).fields
        require(len(unknowns) > 0, "problem", "an inverse problem with unknown fields", "one without")
        names = [f"{number}_draws" for number in range(len(unknowns))]
        arrays = read_arrays(folder / file.draws, *names, what="the fields of validation.loop")
        draws = [arrays[name].astype(np.float64) for name in names]
        for unknown, values in zip(unknowns, draws, strict=True):
            fits = values.ndim == 2 and values.shape[1] == unknown.grid.count and len(values) == len(draws[0]) > 0
            require(fits, "draws", f"draws of the {unknown.grid.count} values of {unknown.settings.name}", values.shape)
    return tuple(zip(unknowns, draws, strict=True))
