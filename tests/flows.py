"""Trajectories by positions that a test knows."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from datasets import Scene, Trajectory


def flow_of(scene: Scene, positions: ArrayLike, **others: Any) -> Trajectory:
    """The trajectory of `scene` with these positions [m], shape [T, N, D], frame by frame; it begins at rest.

    others: further arrays of a trajectory, or in place of its own.
    """
    frames = np.asarray(positions, np.float32)
    own = {
        "time": np.arange(len(frames)) * scene.frame_dt,
        "velocity0": np.zeros(frames.shape[1:], np.float32),
        "friction": np.full(frames.shape[1], scene.material.friction, np.float32),
    }
    return Trajectory(positions=frames, scene=scene, **{**own, **others})
