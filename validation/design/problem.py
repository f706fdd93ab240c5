"""A design problem: what may be chosen, what is uncertain, and below which limit a flow has to stay, how often.

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
"""Standard deviation of a peak force from flow to flow over the limit, before runs have measured it."""
ASSURANCE = 0.9  # probability with which a design passes its check where the emulator is right


@dataclass(frozen=True, kw_only=True)
class Limit(Record):
    """What has to stay below which value, and how often."""

    quantity: Literal["front", "runout", "impact_force"]
    """Of the deposit [m]; the largest mean force between two frames [N, in 2D N per metre of width]."""
    below: float
    """[m, N or N/m]; of a front or runout on the map where the box of the scene has an origin."""
    probability: Annotated[float, Bounds("a probability in [0.5, 1)", ge=0.5, lt=1.0)] = 0.95
    solid: str | None = None
    """Of a force: on which baffle or solid, by its name; the largest on any where absent."""
    window: float = 0.0
    """Time [s] over which a force is averaged besides."""

    @property
    def force(self) -> bool:
        return self.quantity == "impact_force"

    @property
    def folder(self) -> str:
        """Where runs are kept: those of other forces have other ones in their summaries."""
        return f"{self.quantity}-{zlib.crc32(repr((self.solid, self.window)).encode()):08x}"

    def kept(self, flow: Trajectory) -> Trajectory:
        """The deposit of a run, with the force in its summary where that is limited."""
        if not self.force:
            return flow
        largest = forces_of(flow, window=self.window).largest
        solids = [self.solid] if self.solid else solid_names(flow.scene)
        return flow.ending({self.quantity: max(largest[name] for name in solids)})

    def scatter(self, scene: Scene) -> float:
        """Expected standard deviation from flow to flow before repeated runs show it."""
        return FORCE_SCATTER * self.below if self.force else SCATTER_CELLS * scene.domain.cell

    def check(self, scene: Scene) -> None:
        """Raise InputError for a limit that flows of `scene` cannot have."""
        low, length, place = float(scene.domain.corner[0]), scene.domain.size[0], ""
        if self.force:
            low, length = 0.0, np.inf
        elif scene.domain.origin is not None:
            place = ", an x on the map, as the origin of the box"
        expected = f"a number in ({low:.10g}, {low + length:.10g}){place}"
        require(low < self.below < low + length, "limit.below", expected, self.below)
        plain = self.solid is None and self.window == 0.0
        require(plain or self.force, "limit.quantity", "impact_force beside solid or window", self.quantity)
        require(0.0 <= self.window <= scene.duration, "limit.window", f"up to {scene.duration:g} s", self.window)
        if self.force:
            names = solid_names(scene)
            valid = len(names) > 0 and self.solid in (None, *names)
            expected = f"one of {', '.join(names)}" if names else "a scene with solids"
            require(valid, "limit.solid", expected, repr(self.solid))


@dataclass(frozen=True, kw_only=True)
class Budget(Record):
    """What the MPM may spend."""

    runs: Annotated[int | None, counted(1)] = None
    """Runs for the emulator, at most; 20 and 20 for each number, chosen or uncertain, where absent."""
    checks: Annotated[int, counted(20)] = 100
    """Runs at the design, each of a fresh draw."""
    seed: Annotated[int, counted(0, 2**62)] = 0
    """Of random numbers."""
    predictions: Annotated[int, counted(1000)] = 10_000
    """Of a surrogate, where one predicts."""
    pairs: Annotated[int, counted(4)] = 8
    """Runs of the MPM that show the errors of a surrogate before its predictions."""


@dataclass(frozen=True, kw_only=True)
class _Keys(Record):
    """What a design problem and its file have in common."""

    variables: tuple[Parameter, ...]
    """What is chosen: d, K numbers."""
    uncertain: tuple[Parameter, ...] = ()
    """What is not known when the barriers are built: u, Q numbers."""
    correlations: tuple[Correlation, ...] = ()
    """Of the priors of pairs of them."""
    limit: Limit
    surrogate: Literal["none", "gns", "coarse"] = "none"
    """What predicts flows in thousands (`validation.design.race`): the learned surrogate, or the MPM on cells twice as
    large; without, an emulator of runs."""
    cost: dict[str, float] = field(default_factory=dict)
    """Variable -> the price of a unit of it; without any the most reliable design is looked for."""
    budget: Budget = field(default_factory=Budget)


@dataclass(frozen=True, kw_only=True)
class FieldFile(Record):
    """Unknown fields by draws of their posterior."""

    problem: str
    """The inverse problem that they are the unknowns of: a path or a shipped name."""
    draws: str
    """`field.npz` of its result."""


@dataclass(frozen=True, kw_only=True)
class DesignFile(_Keys):
    """A design problem as it stands in its file."""

    scene: str | dict[str, Any]
    posterior: str | None = None
    fields: FieldFile | None = None


@dataclass(frozen=True, kw_only=True)
class DesignProblem(_Keys):
    """A design problem, checked. Raises InputError, which names the key."""

    name: str
    scene: Scene
    samples: Matrix | None = None
    """Of the posterior of the last of the uncertain numbers, of equal weight, shape [S, Q']."""
    fields: tuple[tuple[UnknownField, Matrix], ...] = ()
    """Unknown fields, each with draws of its posterior, shape [S, K]; of one draw all are together."""
    remarks: Sequence[str] = ()
    """What is to be said of the posterior, a sentence each."""

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
        fewest = 4 * len(self.numbers)
        require(self.runs >= fewest, "budget.runs", f"an integer of at least {fewest}", self.runs)
        predicted = self.surrogate != "none" or not self.fields
        require(predicted, "surrogate", "gns or coarse beside fields, which no emulator of runs knows", "none")

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """Chosen, then uncertain: K + Q."""
        return (*self.variables, *self.uncertain)

    @cached_property
    def kinds(self) -> list[Kind]:
        return [number.kind for number in self.numbers]

    @cached_property
    def box(self) -> Box:
        """Of all of them and, where there are fields, of which draw of them: a share of these."""
        return Box(*np.array([*(number.bounds for number in self.numbers), *([(0.0, 1.0)] if self.fields else [])]).T)

    @property
    def joint(self) -> int:
        """Q', how many of the numbers are of a posterior."""
        return 0 if self.samples is None else self.samples.shape[1]

    @cached_property
    def prior(self) -> JointPrior | None:
        """Of the uncertain numbers but those of a posterior. Raises InputError, which names the key."""
        alone = self.uncertain[: len(self.uncertain) - self.joint]
        return JointPrior({number.name: number.marginal for number in alone}, self.correlations) if alone else None

    @property
    def unit(self) -> str:
        """Of what is limited."""
        force = "N/m" if self.scene.dimension == 2 else "N"
        return force if self.limit.force else "m"

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
        both = zip(self.variables, self.values(design), strict=True)
        return {variable.name: float(value) for variable, value in both}

    def values(self, designs: Matrix) -> Matrix:
        """The variables of designs [..., K] in fractions of their ranges, in their own units, shape [..., K]."""
        known = len(self.variables)
        return np.asarray(self.box.lower[:known] + self.box.range[:known] * designs)

    def price(self, designs: Matrix) -> Row:
        """c . d of designs [..., K] in fractions of their ranges, shape [...]; 0 without a cost."""
        prices = np.array([self.cost.get(variable.name, 0.0) for variable in self.variables])
        return np.asarray(self.values(designs) @ prices)

    def draws(self, count: int, rng: np.random.Generator) -> Matrix:
        """Draws of what is uncertain, in fractions of the ranges: one in each of `count` parts, shape [count, Q].

        The parts are as likely, of every number (McKay, Beckman & Conover, A comparison of three methods for selecting
        values of input variables, Technometrics 21 (1979) 239-245); those of a posterior, of the first of its numbers.
        """
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
        """The scenes at points [n, K + Q] in fractions of the ranges, to a millionth: a run is found again by them.

        first: number of the first flow, of which its jitter seed follows.
        """
        values = enumerate(self.box.at(np.round(points, 6)), first)
        return [self.scene_at(row, jitter_seed(self.scene.seed, number)) for number, row in values]


def with_draws(design: Row, draws: Matrix) -> Matrix:
    """All numbers [n, K + Q] of a design [K] with each of the draws [n, Q] of what is uncertain."""
    return np.hstack([np.tile(design, (len(draws), 1)), draws])


def read_design(name: str | Path) -> DesignProblem:
    """Read the design problem at a path or of a shipped name. Raises InputError, which names the file and the key."""
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
            names, keys["samples"], keys["remarks"] = known_of(path.parent / posterior, keys["scene"])
            lower, upper = (end.tolist() for end in (keys["samples"].min(axis=0), keys["samples"].max(axis=0)))
            ranges = zip(names, lower, upper, strict=True)
            keys["uncertain"] += tuple(Parameter(name=name, lower=low, upper=high) for name, low, high in ranges)
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
