"""Scenes of solids alone, for the tests of their geometry."""

from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene, Solid


def scene_of(
    *solids: Solid, size: tuple[float, ...] = (2.0, 1.0), cell: float = 0.02, baffles: tuple[Baffle, ...] = ()
) -> Scene:
    """A scene with `solids` and a small body under the top of the box, at its far end."""
    body = tuple(0.99 * length for length in size), tuple(0.01 * length for length in size)
    return Scene(
        domain=Domain(size=size, cell=cell),
        material=Material(friction_deg=30.0),
        masses=(Mass(lower=body[0], size=body[1]),),
        solids=solids,
        baffles=baffles,
    )
