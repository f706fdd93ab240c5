"""A problem whose unknowns are fields: scene, fields with their priors, what was observed. Read from TOML, strictly."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.field import FRICTION, Field
from datasets.library import SCENES, find, read_scene
from datasets.particles import released_volume
from datasets.records import Record, from_mapping, read_toml
from datasets.scene import Scene
from inverse.checks import check_joined
from inverse.fields.unknown import FieldSettings, Unknown
from inverse.observations.reading import read_joined
from inverse.settings import ObservationSettings

Floats = NDArray[np.float64]

PROBLEMS = Path(__file__).parent / "problems"


@dataclass(frozen=True, kw_only=True)
class FieldTarget(Record):
    """Where the observed numbers come from: the observations themselves, a twin or a trajectory."""

    twin: bool = False
    """A twin experiment: the MPM makes the numbers from the scene's own fields, and noise is drawn on them."""
    draw: int | None = None
    """Seed of a truth that is drawn from the prior, in place of the scene's own fields."""
    seed: int = 1000
    """Seed of the twin's jitter and noise; another one than the scene's."""
    trajectory: str | None = None
    """A trajectory (NPZ) that was observed."""

    @property
    def measured(self) -> bool:
        """Whether the observations bring their own numbers."""
        return not self.twin and self.trajectory is None


@dataclass(frozen=True, kw_only=True)
class SearchSettings(Record):
    """How the fields are looked for."""

    seeds: int = 4
    """Jitter seeds over which predictions and their derivatives are averaged."""
    ensemble: int = 24
    """Runs that measure the scatter from jitter seed to jitter seed, and as many draws of the prior."""
    iterations: int = 8
    """Gauss-Newton steps, at most."""


@dataclass(frozen=True, kw_only=True)
class _File(Record):
    """A problem as it stands in its file."""

    scene: str
    fields: tuple[FieldSettings, ...]
    observations: tuple[ObservationSettings, ...]
    target: FieldTarget = field(default_factory=FieldTarget)
    search: SearchSettings = field(default_factory=SearchSettings)


@dataclass(frozen=True, kw_only=True)
class FieldProblem:
    """An inverse problem for fields, checked. Raises InputError, which names the key, for one that has no answer."""

    name: str
    """Stem of its file."""
    folder: Path = Path()
    """Relative paths in it start here."""
    scene: Scene
    """The flow; the fields that it has of the unknown kinds are a twin's truth and nothing else."""
    fields: tuple[FieldSettings, ...]
    """What is unknown."""
    observations: tuple[ObservationSettings, ...]
    """What was observed, compared together."""
    target: FieldTarget = field(default_factory=FieldTarget)
    search: SearchSettings = field(default_factory=SearchSettings)

    def __post_init__(self) -> None:
        if not self.fields:
            raise InputError("expected at least one field", key="fields")
        if not self.observations:
            raise InputError("expected at least one observation", key="observations")
        check_joined(self.observations)
        for index, each in enumerate(self.unknowns):
            for bound in ("lower", "upper"):
                self.check_bound(index, each, bound)
        for index, (settings, read) in enumerate(zip(self.observations, read_joined(self), strict=True)):
            if not read.observation.of_positions:
                message = f"expected an observation of positions, got {settings.kind}"
                raise InputError(message, key=f"observations[{index}].kind")
        for index, mass in enumerate(self.scene.masses):
            if mass.k0 is not None and any(each.quantity == FRICTION for each in self.fields):
                message = "expected a body without initial stress, whose yield depends on an unknown friction"
                raise InputError(message, key=f"scene.masses[{index}].k0")
        self.check_target()
        for key, smallest in (("seeds", 1), ("ensemble", 4), ("iterations", 1)):
            if getattr(self.search, key) < smallest:
                message = f"expected an integer of at least {smallest}, got {getattr(self.search, key)}"
                raise InputError(message, key=f"search.{key}")

    def check_bound(self, index: int, unknown: Unknown, bound: str) -> None:
        """Raise InputError where the scene cannot have field `index` at one of its bounds."""
        value = getattr(unknown.settings, bound)
        if value is None:
            return
        # The bound itself is never reached.
        value += 1e-6 * (unknown.settings.mean - value)
        uniform = [each.field(np.zeros(each.grid.count)) for each in self.unknowns]
        uniform[index] = dataclasses.replace(uniform[index], values=(value,) * unknown.grid.count)
        try:
            self.with_fields(uniform)
        except InputError as error:
            message = f"expected a bound at which the scene can be simulated, but {error}"
            raise InputError(message, key=f"fields[{index}].{bound}") from None

    def check_target(self) -> None:
        """Raise InputError for a twin without a truth, or for two sources of the observed numbers."""
        target = self.target
        if target.twin and target.trajectory is not None:
            raise InputError("expected twin = true or a trajectory, got both", key="target")
        if not target.twin:
            if target.draw is not None:
                raise InputError("expected twin = true beside a draw", key="target.draw")
            return
        if target.seed < 0 or target.seed in self.seeds:
            expected = f"a seed of at least 0 and none of the {len(self.seeds)} from {self.seeds[0]} on"
            raise InputError(f"expected {expected}, which the search has, got {target.seed}", key="target.seed")
        kinds = {(each.quantity, each.mass) for each in self.scene.fields}
        for index, each in enumerate(self.fields):
            if target.draw is None and (each.quantity, each.mass) not in kinds:
                message = f"expected a scene with a field of {each.quantity} as the truth, or a draw"
                raise InputError(message, key=f"fields[{index}].quantity")

    @cached_property
    def unknowns(self) -> list[Unknown]:
        """The fields with their grids and priors. Raises InputError, which names the key."""
        found = []
        for index, each in enumerate(self.fields):
            try:
                found.append(Unknown(each, self.scene))
            except InputError as error:
                raise InputError(error.message, key=f"fields[{index}].{error.key}") from None
        return found

    @property
    def seeds(self) -> range:
        """Jitter seeds of the search; those that measure the scatter come after them."""
        return range(self.scene.seed, self.scene.seed + self.search.seeds)

    @property
    def scatter_seeds(self) -> range:
        """Jitter seeds of the runs that measure the scatter, and confirm: none of the search's, nor the twin's."""
        first = max(self.seeds[-1], self.target.seed) + 1
        return range(first, first + self.search.ensemble)

    @property
    def released(self) -> float:
        """Volume of the masses over the width [m^2], in 2D their area."""
        return released_volume(self.scene) / math.prod(self.scene.domain.size[2:])

    def with_fields(self, fields: Sequence[Field], seed: int | None = None) -> Scene:
        """The scene with `fields` in place of those of the unknown kinds, with another jitter `seed` if so asked."""
        unknown = {each.quantity for each in self.fields}
        kept = tuple(each for each in self.scene.fields if each.quantity not in unknown)
        return dataclasses.replace(
            self.scene, fields=kept + tuple(fields), seed=self.scene.seed if seed is None else seed
        )

    def scene_at(self, latents: Sequence[Floats], seed: int | None = None) -> Scene:
        """The scene where unknown k is `latents[k]` [K], u of `inverse.fields.unknown`."""
        fields = [unknown.field(latent) for unknown, latent in zip(self.unknowns, latents, strict=True)]
        return self.with_fields(fields, seed)

    @cached_property
    def truth(self) -> list[Field] | None:
        """The fields of a twin: drawn from the prior, or the scene's own; None where there is no twin."""
        if not self.target.twin:
            return None
        if self.target.draw is None:
            own = {(each.quantity, each.mass): each for each in self.scene.fields}
            return [own[each.quantity, each.mass] for each in self.fields]
        rng = np.random.default_rng(self.target.draw)
        return [each.field(each.prior.field(rng.standard_normal(each.prior.size))) for each in self.unknowns]


def read_problem(name: str) -> FieldProblem:
    """Read the problem at a path or of a shipped name. Raises InputError, which names the file and the key.

    >>> problem = read_problem("slope-friction")
    """
    path = find(name, PROBLEMS, "problem")
    try:
        file = from_mapping(_File, read_toml(path))
        beside = path.parent / file.scene
        scene = read_scene(str(beside) if file.scene.endswith(".toml") else str(find(file.scene, SCENES, "scene")))
        return FieldProblem(
            name=path.stem,
            folder=path.parent,
            scene=scene,
            fields=file.fields,
            observations=file.observations,
            target=file.target,
            search=file.search,
        )
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None
