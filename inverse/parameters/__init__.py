"""Parameters: the possible unknowns of a scene, and how each enters the MPM's scene and the surrogate's initial state.

Names and units are those of docs/formats.md. Only the MPM supports parameters that are no inputs of the surrogate. A
height or a thickness changes the particles: a surrogate then starts with new ones, without a gradient.

>>> scene = with_parameters(scene, ["friction_deg", "masses[0].velocity_x"], [32.0, 1.5])

A new one needs a line in `KINDS` (`inverse.parameters.kind`) and, if it is an input of the surrogate, a function.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, cast

import numpy as np
from scipy.stats import qmc

from datasets.errors import InputError, keyed, require
from datasets.scene import Scene
from datasets.scene.material import Material
from datasets.schema import Bounds, Record
from inverse.parameters.kind import KINDS, Draft, Kind, Vector
from inverse.parameters.prior import Marginal, Prior

__all__ = ["Kind", "Parameter", "Vector", "kind", "known_names", "with_parameters"]

LENGTHS = Bounds("positive lengths in m, up to 1e+09", gt=0.0)
FILLING = 32  # number of points that fill the box of the bounds, and of its corners, at which scenes are checked


def kind(name: str) -> Kind:
    """The kind of the parameter `name`. Raises InputError."""
    index = re.search(r"\[(\d{1,6})\]", name)
    form = name if index is None else name[: index.start() + 1] + name[index.end() - 1 :]
    if form not in KINDS or (index is None) == ("[]" in form):
        choices = ", ".join(key.replace("[]", "[0]") for key in KINDS)
        raise InputError(f"expected one of {choices}, got {name!r}")
    return KINDS[form] if index is None else replace(KINDS[form], index=int(index[1]))


def known_names(scene: Scene) -> list[str]:
    """The parameters that `scene` has, the first of each kind."""
    names = []
    for form, candidate in KINDS.items():
        for index in range(len(getattr(scene, candidate.group)) if candidate.group else 1):
            name = form.replace("[]", f"[{index}]")
            try:
                kind(name).check(scene)
            except InputError:
                continue
            names.append(name)
            break
    return names


def with_parameters(scene: Scene, names: Sequence[str], values: Sequence[float] | Vector) -> Scene:
    """`scene` with the parameters `names` set to `values`. Raises InputError for a scene that cannot be simulated."""
    return with_kinds(scene, [kind(name) for name in names], values)


def with_kinds(scene: Scene, kinds: Sequence[Kind], values: Sequence[float] | Vector) -> Scene:
    """Like `with_parameters`, with resolved names."""
    draft = Draft(**vars(scene))
    for index in in_order(kinds):
        kinds[index].put(draft, float(values[index]))
    return replace(scene, **vars(draft))


def in_order(kinds: Sequence[Kind]) -> list[int]:
    """Indices of `kinds` in the order in which they are set."""
    return sorted(range(len(kinds)), key=lambda index: kinds[index].order)


@dataclass(frozen=True, kw_only=True)
class Parameter(Record):
    """A number with a prior between its bounds or, with a `spacing`, a field (`inverse.parameters.field`)."""

    name: str
    """See `inverse.parameters`; for a field `friction_deg`, `velocity_x`, ..., `thickness`, or one of these of
    `masses[I]`, or `solids[I].friction`."""
    lower: float | None = None
    """Smallest value allowed; a velocity field has both bounds or none."""
    upper: float | None = None
    """Largest value allowed."""
    initial: float | None = None
    """For a number: start of the search; default with a prior: its median."""
    prior: Prior | None = None
    """For a number: its prior, truncated at the bounds; default: uniform."""
    spacing: Annotated[tuple[float, ...] | None, LENGTHS] = None
    """For a field: largest distance between nodes along each axis, in plan along x and z [m]; over a shorter body the
    field is constant."""
    zones: str | None = None
    """For the friction of a terrain, instead of nodes: a raster of zone numbers; each zone has one value."""
    mean: Annotated[float | None, Bounds("a finite value")] = None
    """For a field: mean of its prior, the same everywhere [deg, m/s, m or -]."""
    deviation: Annotated[float | None, Bounds("a standard deviation from 1e-06 to 1e+09", ge=1.0e-6)] = None
    """For a field: standard deviation of its prior at every node [deg, m/s, m or -]."""
    length: Annotated[float | tuple[float, ...] | None, LENGTHS] = None
    """For a field: correlation length [m], or one along each axis; at this distance the correlation is 0.14 in 2D."""

    def check(self, scene: Scene) -> None:
        """Raise InputError, which names the key, if `scene` has no such parameter or keys do not go together."""
        of_zones, of_number = ("mean", "deviation"), ("initial", "prior")
        of_field, apart = (*of_zones, "length"), ("spacing", "length")
        needed = of_zones if self.zones is not None else of_field if self.is_field else ("lower", "upper")
        for key in needed:
            require(getattr(self, key) is not None, key, "a value", "none, the key is missing")
        for key in of_number if self.is_field else of_field:
            kind = "number" if self.is_field else "field, which has a spacing or zones"
            require(getattr(self, key) is None, key, f"it of a {kind}, alone", getattr(self, key))
        for key in apart if self.zones is not None else ():
            require(getattr(self, key) is None, key, "none beside zones, which are independent", getattr(self, key))
        if self.is_field:
            return
        try:
            self.kind.check(scene)
        except InputError as error:
            message = error.message
            if message.startswith("expected one of"):
                message = f"expected one of {', '.join(known_names(scene))}, which the scene has, got {self.name!r}"
            raise InputError(message, key="name") from None
        lower, upper = self.bounds
        require(lower < upper, "upper", f"a value above {lower:g}", upper)
        if self.prior is not None:
            with keyed("prior"):
                self.prior.check(lower, upper)
        require(lower <= self.start <= upper, "initial", f"a value in [{lower:g}, {upper:g}]", self.start)

    @property
    def is_field(self) -> bool:
        """Whether it varies over the body or the terrain."""
        return self.spacing is not None or self.zones is not None

    @cached_property
    def kind(self) -> Kind:
        """The kind of a number, by its name. Raises InputError."""
        return kind(self.name)

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value of a number."""
        return cast("tuple[float, float]", (self.lower, self.upper))

    @property
    def start(self) -> float:
        """Start of the search for a number."""
        return float(self.marginal.at(np.array(0.5))) if self.initial is None else self.initial

    @cached_property
    def marginal(self) -> Marginal:
        lower, upper = self.bounds
        return Marginal(law=(self.prior or Prior(kind="uniform")).law(lower, upper), lower=lower, upper=upper)

    @property
    def range(self) -> float:
        """Width of the prior bounds of a number."""
        return self.bounds[1] - self.bounds[0]

    @property
    def quantity(self) -> str:
        """The quantity of a field: one of `datasets.scene.grid_field.Field`, or the `friction` of a terrain."""
        return self.name.split(".")[-1]

    @property
    def mass(self) -> int | None:
        """For a field: the index of its mass; None for all masses."""
        return self._index_of("masses")

    @property
    def solid(self) -> int | None:
        """For a field: the index of its terrain; None for a field over particles."""
        return self._index_of("solids")

    def _index_of(self, group: str) -> int | None:
        match = re.match(rf"{group}\[(\d{{1,6}})\]\.", self.name)
        return None if match is None else int(match[1])


def changed_material(scene: Scene, name: str) -> tuple[str, Material] | None:
    """Key and material of `scene` whose friction angle is the parameter `name`; None for another number."""
    match = re.fullmatch(r"(?:masses\[(\d{1,6})\]\.)?(residual_)?friction(_limit)?_deg", name)
    if match is None:
        return None
    if match[1] is None or scene.masses[int(match[1])].material is None:
        return "material", scene.material
    return f"masses[{match[1]}].material", scene.material_of(scene.masses[int(match[1])])


def check_parameters(scene: Scene, parameters: Mapping[str, Parameter], key: str) -> None:
    """Raise InputError for parameters that the scene does not have, or whose bounds give an invalid scene.
    parameters: key -> parameter; key: that of all together."""
    names = [parameter.name for parameter in parameters.values()]
    for place, parameter in parameters.items():
        with keyed(place):
            require(names.count(parameter.name) == 1, "name", "each number once", f"{parameter.name!r} twice")
            parameter.check(scene)
    numbers = {place: parameter for place, parameter in parameters.items() if not parameter.is_field}
    if not numbers:
        return
    together = [*numbers.values()]
    initial, bounds = [parameter.start for parameter in together], [parameter.bounds for parameter in together]
    check_scene(scene, together, initial, key)
    lower, upper = np.array(bounds).T
    corners = [*itertools.islice(itertools.product(*bounds), FILLING), upper.tolist()]
    inside = lower + (upper - lower) * qmc.Sobol(len(bounds), seed=0).random(FILLING)
    for values in (*corners, *inside.tolist()):
        try:
            check_scene(scene, together, values, key)
        except InputError as error:
            # If a single bound causes the error, name only that one.
            for row, (place, parameter) in enumerate(numbers.items()):
                for name, bound in zip(("lower", "upper"), parameter.bounds, strict=True):
                    alone = [*initial[:row], bound, *initial[row + 1 :]]
                    check_scene(scene, together, alone, f"{place}.{name}")
            where = ", ".join(f"{number.name} = {value:.4g}" for number, value in zip(together, values, strict=True))
            raise InputError(f"{error.message} with {where}, all within their bounds", key=key) from None


def check_scene(scene: Scene, parameters: Sequence[Parameter], values: Sequence[float], key: str) -> None:
    """Raise InputError under `key` unless `scene` can be simulated with these values."""
    try:
        with_kinds(scene, [parameter.kind for parameter in parameters], values)
    except InputError as error:
        raise InputError(f"expected a scene that can be simulated, but {error}", key=key) from None
