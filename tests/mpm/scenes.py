"""Small scenes for the tests of how a run is recorded, ends and goes on."""

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene

SAND = Material(friction_deg=30.0)
COLUMN = Mass(lower=(0.0, 0.0), size=(0.2, 0.2))


def box(*masses: Mass, material: Material = SAND, **changes: object) -> Scene:
    """Masses in a box of 1 m on cells of 2 cm, for 0.1 s in frames of 5 ms unless changed."""
    settings = {"duration": 0.1, "frame_dt": 0.005, "domain": Domain(size=(1.0, 1.0), cell=0.02)} | changes
    return Scene(material=material, masses=masses or (COLUMN,), **settings)  # type: ignore[arg-type]


def room(*masses: Mass, material: Material = SAND, **changes: object) -> Scene:
    """The same in 3D, a box of 0.8 m on cells of 4 cm."""
    settings = {"duration": 0.05, "frame_dt": 0.005, "domain": Domain(size=(0.8, 0.8, 0.8), cell=0.04)} | changes
    return Scene(material=material, masses=masses, **settings)  # type: ignore[arg-type]
