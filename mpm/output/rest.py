"""When a deposit has come to rest: it neither moves nor accelerates, over a whole window of time.

In every frame of the window the kinetic energy is below a thousandth of the largest so far
(`REST`), and the mean over the window of the unbalanced force

    R = sum_p m_p |a_p| / (M g),   a_p = (v_p(t) - v_p(t - dt_frame)) / dt_frame

is below a hundredth (`BALANCED`): Cundall's average ratio of unbalanced to applied forces, as the
manuals of Itasca's PFC call it (there over contact forces, here over the weight). Either alone misses: sand thrown
up has no kinetic energy at the top of its path, but R = 1; an oscillating bed has neither energy at full compression
nor, at another moment, acceleration. So the window spans a period of the slowest oscillation of a layer as thick as the
material at the start, 4 H / c_s with the speed c_s of the elastic shear wave, and a time of flow, sqrt(H / g), in which
sand left in the air would have fallen by H / 2. A mass that was let go in equilibrium never moves: kinetic energy below
REST_ENERGY of M g H counts as none.
"""

import math
from collections.abc import Sequence

from datasets.material import Material
from datasets.scene import Scene

REST = 1.0e-3
"""Kinetic energy of a deposit at rest, as a fraction of the largest so far."""
BALANCED = 0.01
"""Unbalanced force of a deposit at rest, as a fraction of its weight."""
MIN_FRAMES = 3
"""Frames of the window where they are far apart."""
REST_ENERGY = 5.0e-7
"""Kinetic energy that counts as none, over M g H [-]: a root mean square speed of a thousandth of sqrt(g H)."""


def height(scene: Scene) -> float:
    """Extent H of the material along the second axis at the start [m]."""
    return max(mass.lower[1] + mass.size[1] for mass in scene.masses) - min(mass.lower[1] for mass in scene.masses)


def window_frames(scene: Scene, materials: Sequence[Material]) -> int:
    """Frames of the window over which `scene` must have been at rest."""
    slowest = min(math.sqrt(material.shear_modulus / material.density) for material in materials)
    period = 4.0 * height(scene) / slowest
    flow = math.sqrt(height(scene) / scene.gravity) if scene.gravity > 0.0 else 0.0
    return max(MIN_FRAMES, math.ceil(max(period, flow) / scene.frame_dt) + 1)
