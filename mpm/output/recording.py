"""Requests to a simulation: what it records, in which frames, and whether it runs until a given time or until rest.

**Rest.** A deposit has come to rest when it neither moves nor accelerates over a whole window of time.

In every frame of the window the kinetic energy, per mass in the box, is below a thousandth of the largest so far
(`REST`), and the mean over the window of the unbalanced force

    R = sum_p m_p |a_p| / (M g),   a_p = (v_p(t) - v_p(t - dt_frame)) / dt_frame

of the mass M that is in the box is below a hundredth (`BALANCED`): Cundall's average ratio of unbalanced to applied
forces, as the manuals of Itasca's PFC call it (there over contact forces, here over the weight). Either criterion alone
fails: sand thrown up has no kinetic energy at the top of its path, but R = 1; an oscillating bed has no energy at full
compression and, at another moment, no acceleration. So the window spans both a period of the slowest oscillation of a
layer as thick as the initial material, 4 H / c_s with the shear-wave speed c_s, and a flow time, sqrt(H / g), in which
airborne sand would fall by H / 2. A mass released in equilibrium never moves: kinetic energy below REST_ENERGY of
M g H counts as none.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from datasets.geometry.bodies import scene_height
from datasets.scene import Scene
from datasets.scene.material import Material
from datasets.schema import Bounds, Record

REST = 1.0e-3  # kinetic energy of a deposit at rest, as a fraction of the largest so far
BALANCED = 0.01  # unbalanced force of a deposit at rest, as a fraction of its weight
MIN_FRAMES = 3  # least number of frames in the window, if frames are far apart
REST_ENERGY = 5.0e-7  # kinetic energy that counts as none, over M g H [-]: an rms speed of a thousandth of sqrt(g H)
PRESENT = 1.0e-6  # share of the mass, at least, by which the energy and the force of what is in an open box are divided


@dataclass(frozen=True, kw_only=True)
class Recording(Record):
    """A request for records: memory is allocated, and code compiled, only for these.

        simulate(scene, record=Recording(frames=10, fields=True, wall_forces=True))

    The series of the summary (energies, impulse on the walls) have a value at every `frame_dt` of the scene, whichever
    frames are kept; the impulse on solids, if there are any, is recorded in the kept frames. Raises InputError for what
    cannot be recorded."""

    frames: Annotated[
        Literal["all", "last"] | int, Bounds("all, last or every how many, from 1 on", ge=1, words=("all", "last"))
    ] = "all"
    """Which frames keep positions and fields: all, only the last, or every k-th from the first on and the last."""
    fields: bool = False
    """Whether velocity, stress, pressure and plastic strain of every particle are recorded besides its position; stress
    and pressure are smoothed through the grid (`mpm.output.smoothing`)."""
    pore_pressure: bool = False
    """Whether pore pressure is recorded without the other fields; with them it always is."""
    wall_forces: bool = False
    """Whether the momentum that each side of the box has taken is recorded."""
    until_rest: bool = False
    """End a scene when its deposit is at rest (above), and fill the remaining frames with the last one; the summary
    gives the time of rest, `rest_time` [s], and the end of the computation, `end_time` [s]."""

    @property
    def state(self) -> bool:
        """Whether more than the positions of the particles is recorded."""
        return self.fields or self.pore_pressure

    @property
    def every(self) -> int:
        """Number of frames from one that is kept to the next; 0 if only the last is kept."""
        return {"all": 1, "last": 0}[self.frames] if isinstance(self.frames, str) else self.frames

    def kept(self, frames: int) -> list[int]:
        """The numbers of the kept frames out of `frames`, ascending."""
        if self.every == 0:
            return [frames - 1]
        return [*range(0, frames - 1, self.every), frames - 1]


ALL = Recording()
"""The positions in all frames."""
LAST = Recording(frames="last")
"""Only the deposit."""
AT_REST = Recording(frames="last", until_rest=True)
"""Only the deposit, of a run that ends at rest."""
WITH_FIELDS = Recording(fields=True, wall_forces=True)
"""All frames with all fields, and the forces on the walls."""


def window_frames(scene: Scene, materials: Sequence[Material]) -> int:
    """Frames of the window over which `scene` must have been at rest."""
    slowest = min(math.sqrt(material.shear_modulus / material.density) for material in materials)
    period = 4.0 * scene_height(scene) / slowest
    flow = math.sqrt(scene_height(scene) / scene.gravity) if scene.gravity > 0.0 else 0.0
    return max(MIN_FRAMES, math.ceil(max(period, flow) / scene.frame_dt) + 1)
