"""What a simulation is asked to record, in which frames, and until when it runs: until a time, or until rest.

**Rest.** A deposit has come to rest when it neither moves nor accelerates over a whole window of time.

In every frame of the window the kinetic energy, per mass in the box, is below a thousandth of the largest so far
(`REST`), and the mean over the window of the unbalanced force

    R = sum_p m_p |a_p| / (M g),   a_p = (v_p(t) - v_p(t - dt_frame)) / dt_frame

of the mass M that is in the box is below a hundredth (`BALANCED`): Cundall's average ratio of unbalanced to applied
forces, as the manuals of Itasca's PFC call it (there over contact forces, here over the weight). Either alone misses:
sand thrown up has no kinetic energy at the top of its path, but R = 1; an oscillating bed has neither energy at full
compression nor, at another moment, acceleration. So the window spans a period of the slowest oscillation of a layer as
thick as the material at the start, 4 H / c_s with the speed c_s of the elastic shear wave, and a time of flow,
sqrt(H / g), in which sand left in the air would have fallen by H / 2. A mass that was let go in equilibrium never
moves: kinetic energy below REST_ENERGY of M g H counts as none.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from datasets.geometry.bodies import scene_height
from datasets.scene import Scene
from datasets.scene.material import Material
from datasets.schema import Bounds, Record

REST = 1.0e-3
"""Kinetic energy of a deposit at rest, as a fraction of the largest so far."""
BALANCED = 0.01
"""Unbalanced force of a deposit at rest, as a fraction of its weight."""
MIN_FRAMES = 3
"""Frames of the window where they are far apart."""
REST_ENERGY = 5.0e-7
"""Kinetic energy that counts as none, over M g H [-]: a root mean square speed of a thousandth of sqrt(g H)."""

PRESENT = 1.0e-6
"""Share of the mass, at least, by which the energy and the force of what is in an open box are divided."""


@dataclass(frozen=True, kw_only=True)
class Recording(Record):
    """A request: memory is allocated, and code compiled, for this alone.

        simulate(scene, record=Recording(frames=10, fields=True, wall_forces=True))

    The series of the summary (energies, impulse on the walls) have a value at every `frame_dt` of the scene, whichever
    frames keep their positions; the impulse on solids is recorded in the frames that are kept wherever there are
    solids. Raises InputError for what cannot be recorded.
    """

    frames: Annotated[
        Literal["all", "last"] | int, Bounds("all, last or every how many, from 1 on", ge=1, words=("all", "last"))
    ] = "all"
    """Which frames keep positions and fields: all, the last alone, or every k-th from the first on and the last."""
    fields: bool = False
    """Whether velocity, stress, pressure and plastic strain of every particle are recorded besides its position; stress
    and pressure are smoothed through the grid (`mpm.output.smoothing`)."""
    pore_pressure: bool = False
    """Whether the pressure of water in pores is recorded without the other fields, as with them."""
    wall_forces: bool = False
    """Whether the momentum that each side of the box has taken is recorded."""
    until_rest: bool = False
    """End a scene when its deposit has come to rest (above), and fill the frames that are left with the
    last one; the summary says when it came to rest, `rest_time` [s], and until when it was computed, `end_time` [s]."""

    @property
    def state(self) -> bool:
        """Whether more of the particles is recorded than their positions."""
        return self.fields or self.pore_pressure

    @property
    def every(self) -> int:
        """Frames from one that is kept to the next; 0 where the last is kept alone."""
        return {"all": 1, "last": 0}[self.frames] if isinstance(self.frames, str) else self.frames

    def kept(self, frames: int) -> list[int]:
        """The numbers of the frames that are kept of `frames`, ascending."""
        if self.every == 0:
            return [frames - 1]
        return [*range(0, frames - 1, self.every), frames - 1]


ALL = Recording()
"""The positions in all frames."""
LAST = Recording(frames="last")
"""The deposit alone."""
AT_REST = Recording(frames="last", until_rest=True)
"""The deposit alone, of a run that ends when it rests."""
WITH_FIELDS = Recording(fields=True, wall_forces=True)
"""All frames with all fields, and the forces on the walls."""


def window_frames(scene: Scene, materials: Sequence[Material]) -> int:
    """Frames of the window over which `scene` must have been at rest."""
    slowest = min(math.sqrt(material.shear_modulus / material.density) for material in materials)
    period = 4.0 * scene_height(scene) / slowest
    flow = math.sqrt(scene_height(scene) / scene.gravity) if scene.gravity > 0.0 else 0.0
    return max(MIN_FRAMES, math.ceil(max(period, flow) / scene.frame_dt) + 1)
