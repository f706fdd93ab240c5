"""What sets the time step: the elastic waves of the stiffest material, or the speed of the flow.

    dt = min( f dx / c,  s dx / (c + v) ),    f: `step_fraction`,  s: `STABILITY`

with the wave speed c and the largest speed v of a particle at the start of a frame. The flow takes over where it is
faster than (s / f - 1) c, 1.5 c as it comes: a stiffer material then shortens the step by less than it would elsewhere.
"""

from datasets.scene import Scene
from datasets.scene.stiffness import greatest_speed, specific_stress
from mpm.arrays.properties import substeps_per_frame

STABILITY = 1.0
"""Largest (wave speed + particle speed) dt / dx. Measured clean up to 1.1 in 2D and 1.2 in 3D."""
MUCH = 10.0
"""Young's modulus over what the flow needs, from which on a softer material is worth a word."""


def spoken(scene: Scene) -> str:
    """Which step a run begins with and what sets it, before it runs; that the material may be softer, where it may."""
    materials = [scene.material_of(mass) for mass in scene.masses]
    stiffest = max(materials, key=lambda material: material.wave_speed)
    wave, speed = stiffest.wave_speed, greatest_speed(scene)
    slow = (STABILITY / scene.step_fraction - 1.0) * wave
    step = scene.frame_dt / substeps_per_frame(scene, materials)
    line = f"time step {step:.2g} s, set by elastic waves of {wave:.3g} m/s"
    if speed > slow:
        line += f", by the flow where it is faster than {slow:.3g} m/s: it may reach {speed:.3g} m/s"
    enough = specific_stress(scene) * stiffest.density
    if stiffest.modulus > MUCH * enough > 0.0:
        shares = f"{(enough / stiffest.modulus) ** 0.5:.2g} of the steps"
        line += f" (young = {stiffest.modulus:.2g} Pa; {float(f'{enough:.1e}'):g} Pa would do, in {shares})"
    return line


def limit(steps: int, substeps: int, frames: int) -> str:
    """What set the steps of a run: `waves`, or `flow` where some of its frames took more than their `substeps`."""
    return "flow" if steps > substeps * frames else "waves"
