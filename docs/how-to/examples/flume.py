"""Predict the fronts of a series of flume experiments from the beads' measured angle of repose; nothing is fitted."""

from pathlib import Path

import numpy as np

from datasets import Scene
from datasets.exchange.spreadsheet import read_columns
from datasets.scene import Domain, Mass
from datasets.scene.material import Material
from mpm import AT_REST, simulate_many

beads = {"friction_deg": 22.0, "friction_limit_deg": 33.6, "angle": "slope", "inertial_number": 0.279}
beads |= {"grain_diameter": 0.00115, "grain_density": 2500.0, "density": 1500.0}
table = read_columns(Path(__file__).with_name("flume.csv"), ("height", "length", "front", "spread"))


def scene(height: float, length: float) -> Scene:
    """A column against the left wall, on a floor of glued beads, for long enough to come to rest."""
    cell, fall = length / 12.0, (height / 9.81) ** 0.5
    return Scene(
        domain=Domain(size=(192 * cell, 60 * cell), cell=cell),
        material=Material(**beads, young=150.0 * 1500.0 * 9.81 * height),
        masses=(Mass(lower=(0.0, 0.0), size=(length, height)),),
        floor_friction="rough",
        duration=15.0 * fall,
        frame_dt=0.05 * fall,
        step_fraction=0.9,
    )


scenes = [scene(*row) for row in zip(table["height"].tolist(), table["length"].tolist(), strict=True)]
fronts = np.array([flow.summary["front"] for flow in simulate_many(scenes, record=AT_REST)])
errors = (fronts - table["front"]) / table["spread"]
for height, measured, front, error in zip(table["height"], table["front"], fronts, errors, strict=True):
    print(f"height {height:.2f} m: front {front:.3f} m, measured {measured:.3f} m, {error:+.1f} spreads")
print(f"rms error {np.sqrt(np.mean(errors**2)):.1f} spreads")
assert np.abs(errors).max() < 2.5
assert np.sqrt(np.mean(errors**2)) < 1.8
