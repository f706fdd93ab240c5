"""Why a scene ended before its last frame, and what helps."""

import math

import numpy as np
from numpy.typing import NDArray

from datasets.particles import Particles
from datasets.scene import Scene
from mpm.output.recorder import RUNAWAY


def explain(scene: Scene, particles: Particles, velocities: NDArray[np.floating], frame: int) -> str:
    """One line on a scene that ended after `frame` with `velocities` [m/s], shape [N, D].

    A particle faster than RUNAWAY times the wave speed ends a scene. Where gravity and the initial velocities can make
    it that fast, v^2 <= v_0^2 + 2 sum_k |g_k| L_k in a box of lengths L, that is the flow itself, and the material is
    too soft for it; where they cannot, or where there is no number, the integration was unstable.
    """
    when, speed = f"t = {scene.frame_dt * frame:g} s", _fastest(velocities)
    fall = 2.0 * sum(abs(g) * length for g, length in zip(scene.gravity_vector, scene.domain.size, strict=True))
    possible = math.sqrt(_fastest(particles.velocities) ** 2 + fall)
    # Some slack, for a pile-up hands energy to the few that it throws.
    if not math.isfinite(speed) or speed > 2.0 * possible:
        return f"the simulation blew up at {when}; try a step_fraction below {scene.step_fraction:g}"
    stiffest = max(particles.materials, key=lambda material: material.wave_speed)
    wave_speed = stiffest.wave_speed
    young = _rounded_up(stiffest.young * (speed / (RUNAWAY * wave_speed)) ** 2)
    return (
        f"a particle moves at {speed:.3g} m/s at {when}, more than {RUNAWAY:g} times the wave speed of "
        f"{wave_speed:.3g} m/s: a shorter step does not help; "
        f"a young of at least {young:.2g} Pa or a lower velocity does"
    )


def _fastest(velocities: NDArray[np.floating]) -> float:
    """The largest speed [m/s] of velocities [N, D]; nan where one is."""
    return float(np.linalg.norm(velocities.astype(np.float64), axis=1).max())


def _rounded_up(value: float) -> float:
    """The next larger number of two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(1.001 * value / unit) * unit
