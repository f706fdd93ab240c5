"""The learned simulator beside the MPM: scenes, courses, tables and the command, on flows with a formula."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.command_line import run
from datasets.definitions.releases2d import held_out
from datasets.library import read_scene
from datasets.material import Material
from datasets.particles import initial_particles
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from validation.bench.surrogate import columns, layers, models, scenes
from validation.bench.surrogate import held_out as shown
from validation.bench.surrogate.__main__ import command
from validation.bench.surrogate.bounded import judged
from validation.bench.surrogate.courses import Comparison, Truth, compare
from validation.bench.surrogate.races import Lap, Race
from validation.bench.surrogate.rollouts import Rollout, Start, Task, first_frames, roll, roller
from validation.bench.surrogate.scenes import Column
from validation.bench.surrogate.speed import worth

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
    points = initial_particles(scene)
    time = np.arange(scene.frames) * scene.frame_dt
    moved = points.positions + np.array([1.0, 0.0])[: scene.dimension] * speed * time[:, None, None]
    return Trajectory(
        positions=moved.astype(np.float32),
        time=time,
        velocity0=np.full((len(points.positions), scene.dimension), [speed, 0.0], np.float32),
        friction=points.friction,
        scene=scene,
    )


def rolled(flow: Trajectory, every: int = 1) -> Rollout:
    """What a perfect surrogate that keeps every so many points would make of a flow."""
    stride = round(STEP / flow.scene.frame_dt)
    indices = np.arange(0, flow.positions.shape[1], every)
    return Rollout(
        positions=flow.positions[::stride, indices],
        step=STEP,
        velocity0=flow.velocity0[indices],
        volume=np.full(len(indices), every * flow.scene.particle_volume, np.float32),
        indices=indices,
        seconds=1.0,
    )


def beside(
    rollout: Rollout, flow: Trajectory, fronts: Sequence[float] = (1.0, 1.0), start: Start = Start.REST
) -> Comparison:
    return compare("model", start, rollout, Truth(flow=flow, fronts=tuple(fronts), mse=1e-5))


def test_the_papers_columns_are_among_the_held_out_ones() -> None:
    found = scenes.paper_columns()
    assert len(found) == 4
    for name, column in found.items():
        assert column in scenes.columns()
        assert column.scene == read_scene(f"column-{name}")


def test_no_column_is_near_a_training_scene() -> None:
    for column in scenes.columns():
        (mass,) = column.scene.masses
        assert held_out(*mass.size)
        assert mass.size[0] * mass.size[1] == pytest.approx(scenes.AREA, rel=1e-2)
    assert [column.friction_deg for column in scenes.columns(aspects=(1.0,)) if not column.trained] == [12.0, 48.0]


def test_layers_keep_their_masses_and_change_their_velocities() -> None:
    falling, rising, random = scenes.layers().values()
    speeds = [mass.velocity[0] for mass in falling.masses if mass.velocity]
    assert [mass.velocity[0] for mass in rising.masses if mass.velocity] == speeds[::-1]
    drawn = [mass.velocity[0] for mass in random.masses if mass.velocity]
    assert len(set(drawn)) == 10
    assert 0.0 <= min(drawn) <= max(drawn) <= 1.5
    assert [mass.size for mass in random.masses] == [mass.size for mass in falling.masses]


def test_scenes_on_other_cells_and_of_other_sizes() -> None:
    tall = read_scene("column-tall-42")
    assert scenes.on_cells(tall, 200).domain.cell == 0.005
    twice = scenes.scaled(tall, 2.0)
    assert (twice.domain.size, twice.masses[0].size, twice.domain.cell) == ((2.0, 2.0), (0.4, 0.8), 0.01)


def test_a_perfect_surrogate_has_no_error() -> None:
    flow = sliding(BLOCK, 1.0)
    each = beside(rolled(flow), flow)
    assert (each.front_error, each.runout_error, each.profile_error) == pytest.approx((0.0, 0.0, 0.0))
    assert (each.kinetic_error, each.potential_error, each.mse) == pytest.approx((0.0, 0.0, 0.0))
    assert each.scatter == 0.0


def test_energies_are_shares_of_that_at_the_start() -> None:
    flow = sliding(BLOCK, 2.0)
    each = beside(rolled(flow), flow)
    # v^2 / 2 beside g h / 2 of a block 0.1 m high.
    kinetic = 2.0 / (2.0 + 9.81 * 0.05)
    np.testing.assert_allclose(each.mpm.kinetic, kinetic, rtol=2e-3)
    np.testing.assert_allclose(each.mpm.potential, 1.0 - kinetic, rtol=1e-2)


def test_a_surrogate_that_is_too_slow() -> None:
    flow, slow = sliding(BLOCK, 1.0), sliding(BLOCK, 0.5)
    each = beside(rolled(slow), flow, fronts=(0.39, 0.41))
    # 0.2 s at 0.5 m/s less, of a front at about 0.4 m.
    assert each.front_error == pytest.approx(-0.1 / each.front, rel=1e-4)
    assert each.rmse == pytest.approx((0.025, 0.05, 0.1), rel=1e-4)
    assert each.mse == pytest.approx(0.01, rel=1e-3)
    assert each.scatter == pytest.approx(0.02 / 2**0.5 / each.front)
    # A quarter of the kinetic energy, seen in its own share of the whole.
    assert each.kinetic_error > 0.1


def test_the_front_is_compared_on_all_points_and_on_the_same_ones() -> None:
    flow = sliding(BLOCK, 1.0)
    each = beside(rolled(flow, every=7), flow)
    assert each.thinned_front_error == pytest.approx(0.0)
    assert 0.0 < abs(each.front_error) < 0.02


@pytest.fixture
def tiny(tmp_path: Path) -> models.Model:
    """An untrained model, which lets everything fall, on disk."""
    torch.manual_seed(0)
    settings = ModelSettings(
        width=8, layers=2, rounds=1, grid_channels=4, grid_layers=1, frames_per_step=2, frame_dt=0.005
    )
    normalisation = Normalisation(displacement=3e-3, acceleration=7e-4, friction_mean=0.6, friction_std=0.2)
    path = tmp_path / "tiny.pt"
    checkpoint.save(
        path, Simulator(settings, normalisation), {"log": {"updates": 3000}, "seed": 7, "datasets": ["none: 0"]}
    )
    ((model,), missing) = models.load((path,))
    assert missing == []
    return model


def test_a_rollout_from_rest_and_from_first_frames(tiny: models.Model) -> None:
    flow = sliding(BLOCK, 1.0)
    rest = roll(tiny.simulator, BLOCK)
    frames = roll(tiny.simulator, BLOCK, first_frames(flow))
    assert rest.positions.shape == frames.positions.shape == (21, 100, 2)
    np.testing.assert_array_equal(rest.indices, frames.indices)
    # Frames are known up to 0.05 s.
    np.testing.assert_array_equal(frames.positions[:6], flow.positions[:11:2, frames.indices])
    with roller(1) as roll_all:
        (again,) = roll_all([Task(model=tiny.path, scene=BLOCK)])
    np.testing.assert_array_equal(again.positions, rest.positions)


def test_every_scene_by_every_model_from_both_starts(tiny: models.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown, "simulate_many", lambda wanted: [sliding(scene, 0.1 * scene.seed) for scene in wanted])
    with roller(1) as roll_all:
        found = shown.against_mpm({"block": BLOCK}, [tiny], 3, roll_all, "test")
    assert [each.start for each in found["block"]] == [Start.REST, Start.FRAMES]
    # The other seeds end 20 and 40 mm further.
    assert found["block"][0].scatter == pytest.approx(0.02 / found["block"][0].front, rel=0.1)
    assert found["block"][0].mpm_mse == pytest.approx((0.02**2 + 0.04**2) / 2, rel=0.1)


def test_a_model_is_described(tiny: models.Model) -> None:
    text = "\n".join(models.facts([tiny]))
    assert "| training | 3,000 updates |" in text
    assert "| cell, points per cell | 10 mm, 1 |" in text
    assert "none: 0" in text


def off_by(error: float, angle: float, start: Start) -> Comparison:
    """A comparison whose front, on all points, is off by `error`."""
    flow = sliding(BLOCK.with_friction_deg(angle), 1.0)
    each = beside(rolled(flow), flow, start=start)
    return dataclasses.replace(each, front=float(each.surrogate.front[-1] / (1.0 + error)))


def test_bars_are_told_as_they_are() -> None:
    errors = {21.0: 0.006, 33.0: -0.05, 48.0: 0.055}
    found = {
        Column(aspect=1.0, friction_deg=angle): [off_by(error, angle, Start.REST)] for angle, error in errors.items()
    }
    text = "\n".join(columns.text(found, seeds=2))
    assert "`model` from rest, inside (3 %): mean holds, rms **does not hold**, worst **does not hold**." in text
    assert "`model` from rest, outside (6 %): mean holds, rms holds, worst holds." in text
    assert "| 33° | **5.0 %** (**-5.0 %**) |" in text
    assert "| `model` | from rest | inside | 2.8 % | **3.6 %** | **-5.0 %** | 1 of 2 |" in text
    assert "**-5.0 %**" in "\n".join(columns.everything(found))


def test_layers_are_told_with_the_papers_error() -> None:
    text = "\n".join(layers.text({"falling": [off_by(0.04, 30.0, Start.FRAMES)]}, seeds=2))
    assert "| falling | `model` | from first frames | 0.00 | 0.10 | **+4.0 %** |" in text
    assert "3.41" in text


def test_a_deposit_at_rest_is_bounded_and_a_creeping_one_is_not() -> None:
    scene = dataclasses.replace(BLOCK, duration=1.0)
    flow = sliding(scene, 0.0)
    flow.summary["energy"] = {"kinetic": [0.0, 1.0, *[0.0] * 30]}
    falls = flow.positions.copy()
    falls[:50, :, 1] += np.linspace(0.1, 0.0, 50, dtype=np.float32)[:, None]
    rest = judged("block", scene, "model", rolled(dataclasses.replace(flow, positions=falls)), flow)
    assert rest.bounded
    creeping = falls + (0.003 * flow.time[:, None, None] * [1.0, 0.0]).astype(np.float32)
    crept = judged("block", scene, "model", rolled(dataclasses.replace(flow, positions=creeping)), flow)
    assert crept.creep == pytest.approx(3.0, rel=1e-3)
    assert not crept.bounded


def test_a_point_in_a_baffle_or_outside_is_not_bounded() -> None:
    scene = dataclasses.replace(BLOCK, baffles=(Baffle(lower=(0.3, 0.0), size=(0.1, 0.1)),))
    flow = sliding(scene, 0.6)
    flow.summary["energy"] = {"kinetic": [1.0, 0.0]}
    inside = judged("block", scene, "model", rolled(flow), flow)
    assert inside.inside is not None
    assert inside.inside > 1.0
    assert not inside.clear
    outside = judged("block", scene, "model", rolled(sliding(scene, -1.0)), flow)
    assert outside.outside == pytest.approx(10.0, abs=0.5)
    assert not outside.clear


def races(seconds: float) -> list[Race]:
    """The MPM on three grids, the finest at 0.5 m, beside a model that takes `seconds` and is 4 % off."""
    laps = {"model": Lap(points=800, seconds=seconds, front=0.52)}
    return [
        Race(series="column", points=points, cell=cell, seconds=took, front=front, laps=laps)
        for points, cell, took, front in ((1000, 0.02, 0.1, 0.51), (4000, 0.01, 1.0, 0.505), (16000, 0.005, 8.0, 0.5))
    ]


def test_where_the_surrogate_is_faster_and_where_not() -> None:
    (fast,) = worth(races(0.05), races(0.05)[-1])
    assert "faster than the MPM from 1,000 points on (front +2.0 % off that run's)." in fast
    (slow,) = worth(races(10.0), races(10.0)[-1])
    assert "slower than the MPM throughout" in slow
    (middling,) = worth(races(2.0), races(2.0)[-1])
    assert "faster than the MPM from 16,000 points on (front +4.0 % off that run's)" in middling
    assert "but the MPM on cells of 20 mm takes 0.10 s" in middling


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--models", "nowhere.pt"], "nowhere.pt"),
        (["--seeds", "0"], "--seeds"),
        (["--long", "-1"], "--long"),
        (["--jobs", "0"], "--jobs"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(command, "python -m validation.bench.surrogate", ["--out", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_two_models_of_one_name_are_refused(
    tiny: models.Model, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--out", str(tmp_path), "--models", str(tiny.path), "--models", str(tiny.path)]
    assert run(command, "python -m validation.bench.surrogate", arguments) == 2
    assert "--models" in capsys.readouterr().err


@pytest.mark.slow
def test_the_whole_command(tiny: models.Model, tmp_path: Path) -> None:
    arguments = ["--out", str(tmp_path), "--models", str(tiny.path), "--quick", "--jobs", "1"]
    assert run(command, "python -m validation.bench.surrogate", arguments) == 0
    text = (tmp_path / "gns.md").read_text()
    for section in ("The models", "Columns in 2D", "Layers", "Speed against the MPM", "Every column"):
        assert f"## {section}" in text
    for name in ("gns-front.png", "gns-profiles.png", "gns-energy.png"):
        assert f"({name})" in text
        assert (tmp_path / name).stat().st_size < 200_000
