"""Small scenes for all tests: masses in a box."""

from typing import Any

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene

SAND = Material(friction_deg=30.0)
COLUMN = Mass(lower=(0.0, 0.0), size=(0.2, 0.2))


def scene_of(
    *masses: Mass, size: tuple[float, ...] = (1.0, 1.0), cell: float = 0.02, material: Material = SAND, **changes: Any
) -> Scene:
    """Masses in a box of `size` [m] on cells of `cell` [m]."""
    return Scene(domain=Domain(size=size, cell=cell), material=material, masses=masses or (COLUMN,), **changes)


def box(*masses: Mass, **changes: Any) -> Scene:
    """Masses in a box of 1 m on cells of 2 cm, for 0.1 s in frames of 5 ms unless changed."""
    return scene_of(*masses, **{"duration": 0.1, "frame_dt": 0.005} | changes)


def room(*masses: Mass, **changes: Any) -> Scene:
    """The same in 3D, a box of 0.8 m on cells of 4 cm, for 0.05 s."""
    return box(*masses, **{"duration": 0.05, "size": (0.8, 0.8, 0.8), "cell": 0.04} | changes)
