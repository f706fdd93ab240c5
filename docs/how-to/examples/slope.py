"""A slope 10 m high stands in equilibrium; once it is known to stand, it loses its cohesion, and slides."""

from pathlib import Path

import numpy as np

from datasets import read_scene
from mpm import simulate

scene = read_scene(str(Path(__file__).with_name("slope.toml")))
flow = simulate(scene)
(failed,) = flow.summary["stage_time"]  # [s]
moved = np.linalg.norm(flow.positions - flow.positions[0], axis=2).max(axis=1)  # [m], of the particle that moved most
standing, sliding = moved[flow.time <= failed].max(), moved[-1]
print(f"until {failed:.2f} s it stands: nothing moves by more than {1000.0 * standing:.2g} mm")
print(f"at {flow.time[-1]:.0f} s a particle has slid {sliding:.1f} m; the front is at {flow.summary['front']:.1f} m")
assert 0.0 < failed < scene.duration
assert standing < 0.05
assert sliding > 1.0
