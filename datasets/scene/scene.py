"""Scene: the complete definition of a simulation, as one frozen value."""

import dataclasses
import json
import math
from dataclasses import dataclass

from datasets.files import json_object
from datasets.scene.checks import checked
from datasets.scene.parts import SceneLayout
from datasets.scene.stiffness import with_stiffness
from datasets.schema import from_mapping

ROUNDING = 1.0e-6  # part of a cell, or of a height, that counts as none


@dataclass(frozen=True, kw_only=True)
class Scene(SceneLayout):
    """Domain, material, masses, baffles and the simulated time. Raises InputError if it cannot be simulated.

    Masses that are no boxes get the box around them; materials without a Young's modulus get the default one.

    For example:

        scene = Scene(domain=Domain(size=(1.0, 0.5), cell=0.01), material=Material(friction_deg=30.0),
                      masses=(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)),), floor_friction=0.4)
        looser = dataclasses.replace(scene, material=Material(friction_deg=25.0))
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        complete = checked(self)
        for key, value in {"masses": complete.masses, **with_stiffness(complete)}.items():
            object.__setattr__(self, key, value)

    def with_cell(self, cell: float) -> "Scene":
        """The scene on cells of another size [m], in a box whose height rounds up to whole cells: there it holds air.
        Raises InputError unless its other sides are whole numbers of cells."""
        length, height, *width = self.domain.size
        whole = math.ceil(height / cell - ROUNDING) * cell if cell > 0.0 else height
        size = (length, whole if whole > height * (1.0 + ROUNDING) else height, *width)
        return dataclasses.replace(self, domain=dataclasses.replace(self.domain, size=size, cell=cell))

    def with_friction_deg(self, friction_deg: float) -> "Scene":
        """The same scene with another friction angle [deg] of its shared material."""
        return dataclasses.replace(self, material=dataclasses.replace(self.material, friction_deg=friction_deg))

    def to_json(self) -> str:
        """The scene as a JSON string; `Scene.from_json` reads it back."""
        return json.dumps(dataclasses.asdict(self))

    @staticmethod
    def from_json(text: str) -> "Scene":
        """Read what `to_json` wrote. Raises InputError."""
        return from_mapping(Scene, json_object(text, "scene"))
