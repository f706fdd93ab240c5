"""How far down a valley must a row of baffles stand, so that none takes more than it bears, whatever the friction?"""

import dataclasses
from itertools import product

import numpy as np

from datasets import Scene, read_scene
from datasets.forces import forces_of
from datasets.scene import Baffle
from mpm import simulate_many

LIMIT = 8.0  # of the force on a baffle [N], a mean over WINDOW
MARGIN = 1.25  # grains that lie otherwise push otherwise
WINDOW = 0.02  # [s]
FRICTION = (29.0, 32.0, 35.0)  # of the grains [deg]: as far as it is known
valley = read_scene("valley-3d")
# Softer grains take fewer steps.
valley = dataclasses.replace(valley, material=dataclasses.replace(valley.material, young=5.0e5), duration=1.2)


def with_row(x: float, friction_deg: float, seed: int) -> Scene:
    """The valley with a row of three baffles across it, x [m] from its head, and grains of an angle of friction."""
    row = tuple(Baffle(lower=(x, 0.0, z - 0.04), size=(0.08, 0.5, 0.08)) for z in (0.24, 0.4, 0.56))
    return dataclasses.replace(valley, baffles=row, seed=seed).with_friction_deg(friction_deg)


def largest_force(places: list[float], seeds: tuple[int, ...]) -> np.ndarray:
    """The largest force on any baffle of rows at `places` [N], at the worst friction and packing of grains."""
    flows = simulate_many([with_row(*each) for each in product(places, FRICTION, seeds)])
    largest = [max(peak for peak, _ in forces_of(flow, window=WINDOW).peaks[:3]) for flow in flows]
    return np.array(largest).reshape(len(places), -1).max(axis=1)


places = [0.6, 0.68, 0.76, 0.84, 0.92]
forces = largest_force(places, seeds=(0, 1))
for x, force in zip(places, forces, strict=True):
    print(f"a row at {x:.2f} m: at most {force:.1f} N on a baffle")
chosen = places[int(np.argmax(MARGIN * forces < LIMIT))]
(again,) = largest_force([chosen], seeds=(2,))  # other grains
print(f"{chosen:.2f} m is far enough; with other grains the force is {again:.1f} N")
assert forces[0] > LIMIT > MARGIN * forces[-1]
assert again < LIMIT
