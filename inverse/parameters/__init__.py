"""Parameters: what of a scene can be unknown, and how each enters the MPM's scene and the surrogate's initial state.

| name | unit | what it is |
|---|---|---|
| `friction_deg`, `cohesion` | deg, Pa | of the scene's shared material |
| `masses[I].friction_deg`, `masses[I].cohesion` | deg, Pa | of mass I, counted from 0, whose material is its own then |
| `masses[I].velocity_x`, `_y`, `_z` | m/s | initial velocity of mass I |
| `baffles[I].x`, `.z` | m | centre of baffle I |
| `baffles[I].length`, `.width` | m | its extent along x and z, about the centre |
| `baffles[I].height` | m | its extent along y, from its foot |
| `floor_friction`, `wall_friction`, `baffle_friction`, `damping` | - | of the scene |
| `solids[I].friction` | - | Coulomb coefficient of solid I |
| `young`, `residual_friction_deg`, `residual_cohesion` | Pa, deg, Pa | of the material, shared or of `masses[I]` |
| `masses[I].k0` | - | ratio of the initial stresses of mass I |
| `masses[I].height`, `.thickness` | m | extent of a box along y from its foot; thickness of a layer |

The last three rows are the MPM's alone: no surrogate has them among its inputs, the loop then runs without one.

>>> scene = with_parameters(scene, ["friction_deg", "masses[0].velocity_x"], [32.0, 1.5])
"""

import re
from collections.abc import Callable, Sequence

from datasets.errors import InputError
from datasets.scene import Scene
from inverse.parameters.baffles import Centre, Extent
from inverse.parameters.boundaries import SceneConstant, SolidFriction
from inverse.parameters.kind import UP, Kind, Parts, Vector
from inverse.parameters.masses import Height, MassNumber, Velocity
from inverse.parameters.material import Cohesion, Constant, Friction, Residual

__all__ = ["Kind", "Vector", "kind", "known_names", "with_parameters"]

_MATERIAL: dict[str, Callable[[int | None], Kind]] = {
    "friction_deg": lambda mass: Friction(mass, "friction_deg", "deg", 2, 0.05),  # the paper's step
    "cohesion": lambda mass: Cohesion(mass, "cohesion", "Pa", 1, 1.0),
    "young": lambda mass: Constant(mass, "young", "Pa", 0, 1.0e5),
    "residual_friction_deg": lambda mass: Residual(mass, "residual_friction_deg", "deg", 2, 0.5),
    "residual_cohesion": lambda mass: Residual(mass, "residual_cohesion", "Pa", 1, 10.0),
}
_SHARED: dict[str, Kind] = {
    **{name: make(None) for name, make in _MATERIAL.items()},
    **{name: SceneConstant(name) for name in ("floor_friction", "wall_friction", "baffle_friction", "damping")},
}
_INDEXED: dict[str, Callable[[int], Kind]] = {
    **{f"masses[].{name}": make for name, make in _MATERIAL.items()},
    "masses[].velocity_x": lambda mass: Velocity(mass, 0),
    "masses[].velocity_y": lambda mass: Velocity(mass, UP),
    "masses[].velocity_z": lambda mass: Velocity(mass, 2),
    "baffles[].x": lambda baffle: Centre(baffle, 0),
    "baffles[].z": lambda baffle: Centre(baffle, 2),
    "baffles[].length": lambda baffle: Extent(baffle, 0),
    "baffles[].height": lambda baffle: Extent(baffle, UP),
    "baffles[].width": lambda baffle: Extent(baffle, 2),
    "masses[].k0": lambda mass: MassNumber(mass, "k0", "-", 3, 0.05),
    "masses[].height": lambda mass: Height(mass, "height", "m", 4, 0.01, changes_volume=True),
    "masses[].thickness": lambda mass: MassNumber(mass, "thickness", "m", 4, 0.01, changes_volume=True),
    "solids[].friction": SolidFriction,
}


def kind(name: str) -> Kind:
    """What the parameter `name` is. Raises InputError."""
    if name in _SHARED:
        return _SHARED[name]
    index = re.search(r"\[(\d{1,6})\]", name)
    form = name if index is None else name[: index.start() + 1] + name[index.end() - 1 :]
    if index is None or form not in _INDEXED:
        known = ", ".join(each.replace("[]", "[0]") for each in (*_SHARED, *_INDEXED))
        raise InputError(f"expected one of {known}, got {name!r}")
    return _INDEXED[form](int(index[1]))


def known_names(scene: Scene) -> list[str]:
    """The parameters that `scene` has, of each kind the first."""
    names = []
    for form in (*_SHARED, *_INDEXED):
        group = getattr(scene, form.split("[")[0]) if "[]" in form else (None,)
        for index in range(len(group)):
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
    """As `with_parameters`, of names that are resolved."""
    parts = Parts.split(scene)
    for index in in_order(kinds):
        kinds[index].put(parts, float(values[index]))
    return parts.joined(scene)


def in_order(kinds: Sequence[Kind]) -> list[int]:
    """Indices of `kinds` in the order in which they are set."""
    return sorted(range(len(kinds)), key=lambda index: kinds[index].order)
