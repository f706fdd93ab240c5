"""`python -m validation.bench surrogate` on flows with a formula: scenes, comparisons, tables, the page."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.definitions.held_out import held_out_column
from datasets.errors import InputError
from datasets.library import read_scene
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from gns.initial import Start, first_frames
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from validation.bench.speed.networks import RolloutCost
from validation.bench.surrogate import bench, comparison, scenes
from validation.bench.surrogate.comparison import Comparison, MpmRuns, compare, compare_all
from validation.bench.surrogate.long_rollouts import bounds
from validation.bench.surrogate.page import Measured, page
from validation.bench.surrogate.rollouts import Rollout, ShippedModel, load, roll_out
from validation.bench.surrogate.scenes import HeldOutColumn
from validation.bench.surrogate.speed import ModelRun, MpmRun, WholeSecond
from validation.bench.surrogate.speed_page import speed_said
from validation.report import plots
from validation.report.timing import spread

STEP = 0.01
BLOCK = Scene(
    domain=Domain(size=(1.0, 0.4), cell=0.01),
    material=Material(friction_deg=30.0),
    masses=(Mass(lower=(0.1, 0.0), size=(0.1, 0.1)),),
    duration=0.2,
    frame_dt=0.005,
)


def sliding(scene: Scene, speed: float) -> Trajectory:
    """The masses of `scene` slide along x at `speed` [m/s], as one."""
    particles = initial_particles(scene)
    time = np.arange(scene.frames, dtype=np.float64) * scene.frame_dt
    along = np.eye(scene.dimension)[0]
    moved = particles.positions + along * speed * time[:, None, None]
    return Trajectory(
        positions=moved.astype(np.float32),
        time=time,
        velocity0=np.full(particles.positions.shape, speed * along, np.float32),
        friction=particles.friction,
        scene=scene,
    )


def rolled(flow: Trajectory, every: int = 1) -> Rollout:
    """The rollout of a perfect surrogate that keeps one of `every` particles."""
    indices = np.arange(0, flow.positions.shape[1], every)
    return Rollout(
        positions=flow.positions[:: round(STEP / flow.scene.frame_dt), indices],
        step=STEP,
        velocity0=flow.velocity0[indices],
        volume=np.full(len(indices), every * flow.scene.particle_volume, np.float32),
        indices=indices,
        seconds=1.0,
    )


def compared(
    rollout: Rollout, flow: Trajectory, fronts: Sequence[float] = (1.0, 1.0), start: Start = Start.FROM_REST
) -> Comparison:
    return compare("model", start, rollout, MpmRuns(flow=flow, fronts=tuple(fronts), mse=1e-5))


def test_no_held_out_scene_is_near_the_training_data() -> None:
    columns = scenes.columns()
    for column in columns:
        (mass,) = column.scene.masses
        assert held_out_column(column.scene)
        assert mass.size[0] * mass.size[1] == pytest.approx(scenes.AREA, rel=1e-2)
    papers = scenes.paper_columns()
    assert len(papers) == 4
    assert all(column in columns and column.scene == read_scene(f"column-{name}") for name, column in papers.items())
    falling, rising, random = scenes.layers().values()
    speeds = [mass.velocity[0] for mass in falling.masses if mass.velocity]
    assert [mass.velocity[0] for mass in rising.masses if mass.velocity] == speeds[::-1]
    drawn = [mass.velocity[0] for mass in random.masses if mass.velocity]
    assert len(set(drawn)) == 10
    assert 0.0 <= min(drawn) <= max(drawn) <= 1.5
    tall = read_scene("column-tall-42")
    assert scenes.on_cells(tall, 200).domain.cell == 0.005
    twice = scenes.scaled(tall, 2.0)
    assert (twice.domain.size, twice.masses[0].size, twice.domain.cell) == ((2.0, 2.0), (0.4, 0.8), 0.01)


def test_errors_are_zero_for_a_perfect_surrogate_and_exact_for_a_slow_one() -> None:
    flow = sliding(BLOCK, 2.0)
    each = compared(rolled(flow), flow)
    errors = (each.front_error, each.runout_error, each.profile_error, each.kinetic_error, each.potential_error)
    assert (*errors, each.mse, each.scatter) == pytest.approx([0.0] * 7)
    # v^2 / 2 beside g h / 2 of a block 0.1 m high.
    kinetic = 2.0 / (2.0 + 9.81 * 0.05)
    np.testing.assert_allclose(each.mpm.kinetic, kinetic, rtol=2e-3)
    np.testing.assert_allclose(each.mpm.potential, 1.0 - kinetic, rtol=1e-2)
    thinned = compared(rolled(flow, every=7), flow)
    assert thinned.same_front_error == pytest.approx(0.0)
    assert 0.0 < abs(thinned.front_error) < 0.02
    # 0.2 s at 0.5 m/s less.
    flow = sliding(BLOCK, 1.0)
    each = compared(rolled(sliding(BLOCK, 0.5)), flow, fronts=(0.39, 0.41))
    assert each.front_error == pytest.approx(-0.1 / each.front, rel=1e-4)
    assert each.rmse == pytest.approx((0.025, 0.05, 0.1), rel=1e-4)
    assert each.scatter == pytest.approx(0.02 / 2**0.5 / each.front)
    assert each.kinetic_error > 0.1


@pytest.fixture
def tiny(tmp_path: Path) -> ShippedModel:
    """An untrained model on disk."""
    torch.manual_seed(0)
    settings = ModelSettings(
        width=8, layers=2, rounds=1, grid_channels=4, grid_layers=1, frames_per_step=2, frame_dt=0.005
    )
    normalisation = Normalisation(displacement=3e-3, acceleration=7e-4, friction_mean=0.6, friction_std=0.2)
    path = tmp_path / "tiny.pt"
    provenance = {"log": {"updates": 3000}, "seed": 7, "datasets": ["none: 0"]}
    checkpoint.save(path, Simulator(settings, normalisation), provenance)
    (model,) = load([path])
    return model


def test_a_rollout_from_rest_and_from_first_frames(tiny: ShippedModel) -> None:
    flow = sliding(BLOCK, 1.0)
    rest = roll_out(tiny.simulator, BLOCK)
    frames = roll_out(tiny.simulator, BLOCK, first_frames(flow))
    assert rest.positions.shape == frames.positions.shape == (21, 100, 2)
    np.testing.assert_array_equal(rest.indices, frames.indices)
    np.testing.assert_array_equal(frames.positions[:6], flow.positions[:11:2, frames.indices])


def test_every_scene_by_every_model_from_both_starts(tiny: ShippedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "simulate_many", lambda them: [sliding(each, 0.1 * each.seed) for each in them])
    found = compare_all({"block": BLOCK}, [tiny], 3, map, "test")
    assert [each.start for each in found["block"]] == [Start.FROM_REST, Start.FROM_MPM_FRAMES]
    # The other seeds end 20 and 40 mm further.
    assert found["block"][0].scatter == pytest.approx(0.02 / found["block"][0].front, rel=0.1)
    assert found["block"][0].mpm_mse == pytest.approx((0.02**2 + 0.04**2) / 2, rel=0.1)


def test_models_have_names_of_their_own(tiny: ShippedModel) -> None:
    with pytest.raises(InputError, match="--models"):
        load([tiny.path, tiny.path])


def with_front_error(error: float, angle: float, start: Start = Start.FROM_REST) -> Comparison:
    """A comparison whose front, of all particles, has this error."""
    flow = sliding(BLOCK.with_friction_deg(angle), 1.0)
    each = compared(rolled(flow), flow, start=start)
    return dataclasses.replace(each, front=float(each.surrogate.front[-1] / (1.0 + error)))


def test_a_deposit_at_rest_is_bounded_and_a_creeping_one_or_one_outside_is_not() -> None:
    scene = dataclasses.replace(BLOCK, duration=1.0)
    flow = sliding(scene, 0.0)
    flow.summary["energy"] = {"kinetic": [0.0, 1.0, *[0.0] * 30]}
    falls = flow.positions.copy()
    falls[:50, :, 1] += np.linspace(0.1, 0.0, 50, dtype=np.float32)[:, None]
    assert bounds("block", scene, "model", rolled(dataclasses.replace(flow, positions=falls)), flow).bounded
    creeping = falls + (0.003 * flow.time[:, None, None] * [1.0, 0.0]).astype(np.float32)
    crept = bounds("block", scene, "model", rolled(dataclasses.replace(flow, positions=creeping)), flow)
    assert crept.creep[0] == pytest.approx(3.0, rel=1e-3)
    assert crept.contained
    assert not crept.bounded
    scene = dataclasses.replace(BLOCK, baffles=(Baffle(lower=(0.3, 0.0), size=(0.1, 0.1)),))
    flow = sliding(scene, 0.6)
    flow.summary["energy"] = {"kinetic": [1.0, 0.0]}
    inside = bounds("block", scene, "model", rolled(flow), flow)
    assert inside.inside > 1.0
    assert not inside.contained
    outside = bounds("block", scene, "model", rolled(sliding(scene, -1.0)), flow)
    assert outside.outside == pytest.approx(10.0, abs=0.5)
    assert not outside.contained


def mpm_series(seconds: float) -> list[MpmRun]:
    """The MPM on three grids, the finest at 0.5 m, beside a model that takes `seconds` and has an error of 4 %."""
    models = {"tiny": ModelRun(nodes=800, seconds=seconds, front=0.52)}
    return [
        MpmRun(series="column", particles=particles, cell=cell, seconds=own, front=front, models=models)
        for particles, cell, own, front in ((1000, 0.02, 0.1, 0.51), (4000, 0.01, 1.0, 0.505), (16000, 0.005, 8.0, 0.5))
    ]


def test_where_the_surrogate_is_faster_and_where_not() -> None:
    (fast,) = speed_said(mpm_series(0.05))
    assert "faster than the MPM from 1,000 particles on (front +2.0 % off that run's)." in fast
    (slow,) = speed_said(mpm_series(10.0))
    assert "slower than the MPM throughout" in slow
    (between,) = speed_said(mpm_series(2.0))
    assert "faster than the MPM from 16,000 particles on (front +4.0 % off that run's)" in between
    assert "but the MPM on cells of 20 mm takes 0.10 s" in between


def test_the_page_has_its_conclusion_from_the_numbers(
    tiny: ShippedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors = {21.0: 0.006, 33.0: -0.05, 48.0: 0.055}
    paper = HeldOutColumn(aspect=2.0, friction_deg=21.0)
    forward, gradient = spread([0.5]), spread([3.5])
    cost = RolloutCost(name="tiny", nodes=100, steps=50, run=True, forward=forward, gradient=gradient)
    second = WholeSecond(cost=cost, mpm=spread([1.0]))
    found = Measured(
        models=[tiny],
        seeds=2,
        columns={
            HeldOutColumn(aspect=1.0, friction_deg=angle): [with_front_error(error, angle)]
            for angle, error in errors.items()
        }
        | {paper: [with_front_error(0.006, 21.0)]},
        layers={"falling": [with_front_error(0.04, 30.0, Start.FROM_MPM_FRAMES)]},
        baffles={},
        long=(),
        seconds=[second],
        runs=mpm_series(2.0),
    )
    monkeypatch.setattr(plots, "DPI", 30)
    bench.draw(tmp_path, found)
    assert {path.name for path in tmp_path.glob("*.png")} == {"gns-front.png", "gns-profiles.png", "gns-energy.png"}
    text = str(page(found, quick=False))
    assert "`model` from rest: front error of held-out columns at trained angles 2.1% on average, worst -5.0 %;" in text
    assert "3 of 4 at all angles meet their criterion." in text
    assert "a rollout takes 0.5 times the MPM's seconds, its gradient 3.5 times (`tiny`)" in text
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["trained", "2 of 3", "`model`", "rest", "2.1 % (**-5.0 %**)"] in [row[:5] for row in cells]
    assert ["33°", "**-5.0 %**", "0.0 %"] in cells
    assert ["falling", "0.00", "0.10", "`model`", "frames"] in [row[:5] for row in cells]
    assert ["updates", "3,000"] in cells
    assert next(row for row in cells if row[0] == "`tiny`")[-1] == "3"
