"""Material that changes at a time, or once all has settled: it stands first, then it loses its strength."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Mass, Material, Scene, Stage
from datasets.scene.grid_field import Field
from datasets.scene.particles import initial_particles
from mpm import AT_REST, LAST, Recording, simulate, simulate_many
from mpm.adjoint.gradient import gradient
from mpm.initial.stages import particles_after
from mpm.output.checkpoint import Checkpoint
from mpm.simulation import Options
from tests.mpm.test_resume import broken_off
from tests.refusals import refused
from tests.scenes import box, room

CLAY = Material(friction_deg=20.0, cohesion=2.0e4, tension_cutoff=1.0e4)
COLUMN = Mass(lower=(0.4, 0.0), size=(0.2, 0.2), k0="elastic")
LOST = {"cohesion": 0.0, "tension_cutoff": 0.0}


def staged(*stages: Stage, **changes: Any) -> Scene:
    settings = {"material": CLAY, "floor_friction": 0.5, "duration": 0.6, "stages": stages} | changes
    return box(COLUMN, **settings)


def widths(scene: Scene, **options: Any) -> tuple[list[float], list[float | None]]:
    """Extent of the deposit in each frame [m], and when stages began [s]."""
    flow = simulate(scene, threads=1, **options)
    return np.ptp(flow.positions[:, :, 0], axis=1).tolist(), flow.summary["stage_time"]


def test_a_column_stands_until_its_cohesion_is_lost() -> None:
    width, times = widths(staged(Stage(time=0.2, **LOST)))
    assert times == [pytest.approx(0.2)]
    assert width[40] == pytest.approx(width[0], abs=1.0e-4)
    assert width[-1] > width[0] + 0.1


def test_until_settled_and_at_rest_after_the_last_stage() -> None:
    """The run does not end at rest before the second stage, nor while what that let go still speeds up."""
    scene = staged(Stage(time=0.1, friction_deg=19.0), Stage(time="settled", **LOST), duration=2.0)
    width, (first, second) = widths(scene, record=dataclasses.replace(AT_REST, frames="all"))
    assert first == pytest.approx(0.1)
    assert 0.1 < second < 0.5
    assert width[-1] > width[0] + 0.1
    # What never settles is remarked.
    flow = simulate(staged(Stage(time="settled", **LOST), duration=0.05), threads=1)
    assert flow.summary["stage_time"] == [None]
    assert any(line.startswith("stages[0] did not begin: by t = 0.05 s") for line in flow.summary["remarks"])


def test_the_material_is_that_of_the_stage_alone() -> None:
    """Free of stress at the start, a stage in the first frame differs from the material itself by that frame alone."""
    body = Mass(lower=(0.4, 0.0), size=(0.2, 0.2))
    loose = Material(friction_deg=30.0)
    late, early = (
        box(body, material=material, duration=0.1, frame_dt=1.0e-4, stages=stages)
        for material, stages in ((CLAY, (Stage(time=1.0e-4, friction_deg=30.0, **LOST),)), (loose, ()))
    )
    one, other = (simulate(scene, threads=1, record=LAST).positions[-1] for scene in (late, early))
    np.testing.assert_allclose(one, other, atol=1.0e-3)


def test_only_what_began_in_the_region_changes() -> None:
    bodies = (Mass(lower=(0.0, 0.0), size=(0.2, 0.2)), Mass(lower=(0.4, 0.0), size=(0.2, 0.2)))
    angles = Field(quantity="friction_deg", origin=(0.0, 0.0), spacing=(1.0, 1.0), nodes=(1, 1), values=(25.0,))
    stages = (
        Stage(time=0.01, mass=1, cohesion=100.0),
        Stage(time=0.02, lower=(0.1, 0.0), size=(0.4, 0.1), friction_deg=10.0),
        Stage(time=0.03, outline=((0.0,), (0.05,)), cohesion=7.0),
    )
    scene = box(*bodies, material=CLAY, stages=stages, fields=(angles,))
    particles = initial_particles(scene)
    x, y = particles.positions.T
    after = particles_after(scene, particles, 3)
    cohesion = np.where(x < 0.05, 7.0, np.where(particles.mass == 1, 100.0, CLAY.cohesion))
    np.testing.assert_array_equal(after.cohesion, cohesion.astype(np.float32))
    np.testing.assert_array_equal(after.friction_deg, np.where((x >= 0.1) & (x <= 0.5) & (y <= 0.1), 10.0, 25.0))
    # In 3D an outline is one in plan.
    corner = Stage(time=0.01, outline=((0.0, 0.0), (0.2, 0.0), (0.0, 0.2)), cohesion=1.0)
    scene = room(Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.2, 0.2)), material=CLAY, stages=(corner,))
    particles = initial_particles(scene)
    weak = particles_after(scene, particles, 1).cohesion == 1.0
    np.testing.assert_array_equal(weak, particles.positions[:, [0, 2]].sum(axis=1) < 0.2)


@pytest.mark.parametrize("time", [0.2, "settled"])
def test_a_run_goes_on_across_a_stage(tmp_path: Path, time: float | str) -> None:
    scene = staged(Stage(time=time, **LOST), duration=0.6)
    options: Options = {"threads": 1, "record": Recording(frames=3)}
    whole, start = simulate(scene, **options), None
    for calls in (12, 23):
        broken_off(scene, calls, resume=start, **options).save(tmp_path / "checkpoint.npz")
        start = Checkpoint.load(tmp_path / "checkpoint.npz")
    again = simulate(scene, resume=start, **options)
    np.testing.assert_array_equal(again.positions, whole.positions)
    assert again.summary["stage_time"] == whole.summary["stage_time"]


@pytest.mark.slow
@pytest.mark.usefixtures("gpu")
def test_side_by_side_on_one_thread_and_on_a_gpu() -> None:
    scenes = [staged(Stage(time=time, **LOST), duration=0.4, seed=seed) for seed, time in enumerate((0.1, "settled"))]
    together = simulate_many([*scenes, staged(duration=0.1)], threads=2, record=LAST)
    for scene, beside in zip(scenes, together, strict=False):
        np.testing.assert_array_equal(simulate(scene, threads=1, record=LAST).positions, beside.positions)
    cpu, gpu = (simulate_many(scenes, precision="f64", record=AT_REST, arch=arch) for arch in ("cpu", "cuda"))
    for one, other in zip(cpu, gpu, strict=True):
        assert one.summary["stage_time"] == other.summary["stage_time"]
        np.testing.assert_allclose(one.summary["front"], other.summary["front"], atol=2.0e-3)


@pytest.mark.parametrize(
    ("stage", "said"),
    [
        ({"time": 0.6}, "stages[0].time: expected a time before the end at 0.6 s, got 0.6"),
        ({"time": "soon"}, "time: expected a time in s or 'settled', got 'soon'"),
        ({"mass": 1}, "stages[0].mass: expected one of 0 to 0, got 1"),
        ({"lower": (0.0, 0.0)}, "stages[0].size: expected lower and size together, lower is given, got none"),
        ({"outline": ((0.1,),)}, "stages[0].outline: expected at least 2 rows of 1 numbers, got 1"),
        ({"cohesion": None}, "stages[0]: expected a constant of the material that changes, got none"),
        ({"dilation_deg": 50.0}, "stages[0].dilation_deg: expected an angle in [0, friction_deg], got 50"),
    ],
)
def test_a_stage_that_is_none_is_refused_with_its_key(stage: dict[str, Any], said: str) -> None:
    assert str(refused(lambda: staged(Stage(**{"time": 0.2, "cohesion": 1.0} | stage)))) == said


def test_times_ascend_and_the_adjoint_says_no() -> None:
    settled, first = Stage(time="settled", cohesion=1.0), Stage(time=0.2, cohesion=0.5)
    refused(staged, settled, first, said="stages[1].time: expected times in ascending order, then 'settled'")
    said = "stages: expected a scene without stages, of which the adjoint has no reverse"
    refused(gradient, staged(first), lambda x, v: (0.0, 0.0 * x, None), said=said)
