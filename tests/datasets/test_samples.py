"""Trajectories at a model's step, stretches cut from them, their statistics against NumPy; thinning keeps volumes."""

import dataclasses
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.particles import initial_particles
from datasets.scene import Baffle, Mass, Scene, Solid
from datasets.training.samples import Flow, Sample, Surroundings, cut, load_flows, particle_cohesion, reflected, thin
from datasets.training.statistics import MOVING_SPEED, MotionStatistics, motion_statistics
from datasets.trajectory import Trajectory, open_trajectory
from tests.scenes import scene_of


@pytest.fixture
def flow(trajectory: Trajectory) -> Flow:
    """Five points that move by 1 mm a step in x, then rest."""
    steps = np.minimum(np.arange(10), 6)[:, None, None] * np.array([1e-3, 0.0])
    positions = (np.linspace(0.0, 0.04, 5)[:, None] * np.array([1.0, 0.0]) + steps).astype(np.float32)
    time = np.arange(10) * 0.0025
    return Flow.from_trajectory(dataclasses.replace(trajectory, positions=positions, time=time), 0.0025, "a")


def test_a_flow_takes_every_so_many_frames(trajectory: Trajectory) -> None:
    flow = Flow.from_trajectory(trajectory, 0.005, "a")
    assert np.array_equal(flow.positions, trajectory.positions[[0, 2]])
    for step in (0.004, 0.001):
        with pytest.raises(InputError, match=r"a: expected frames 0\.00"):
            Flow.from_trajectory(trajectory, step, "a")


@pytest.mark.parametrize(("now", "given"), [(0, [0]), (2, [0, 1, 2]), (6, [3, 4, 5, 6])])
def test_a_cut_gives_the_past_that_there_is(flow: Flow, now: int, given: list[int]) -> None:
    sample = cut(flow, now=now, steps=3, history=3, cell=0.01, kept=4, rng=np.random.default_rng(0))
    assert np.array_equal(sample.frames, flow.positions[given])
    assert np.array_equal(sample.targets, flow.positions[now + 1 : now + 4])
    assert sample.volume.sum() == pytest.approx(flow.volume.sum())


def test_a_flow_over_terrain_has_its_ground_and_other_solids_are_refused(trajectory: Trajectory) -> None:
    def over(solid: Solid) -> Trajectory:
        return dataclasses.replace(trajectory, scene=dataclasses.replace(trajectory.scene, solids=(solid,)))

    ramp = Solid(kind="terrain", points=((0.0, 0.0), (0.1, 0.0), (0.2, 0.05)), friction=0.5)
    around = Flow.from_trajectory(over(ramp), 0.0025, "a", spacing=0.05).surroundings
    assert around.ground is not None
    np.testing.assert_allclose(around.ground, [[0.0, 0.0, 0.0, 0.025, 0.05], [0.5] * 5], atol=1e-7)
    with pytest.raises(InputError, match=r"a: solids\[0\].kind: expected baffles and terrain"):
        Flow.from_trajectory(over(Solid(lower=(0.15, 0.0), size=(0.02, 0.05))), 0.0025, "a")


def test_cohesion_goes_with_the_particles_of_the_masses(scene: Scene) -> None:
    stiff = dataclasses.replace(scene.material, cohesion=500.0)
    masses = (*scene.masses, Mass(lower=(0.12, 0.0), size=(0.03, 0.03), material=stiff))
    two = dataclasses.replace(scene, masses=masses)
    points = initial_particles(two)
    found = particle_cohesion(two, len(points.positions), None, "a")
    assert np.array_equal(found, [points.materials[index].cohesion for index in points.material])
    assert set(found) == {0.0, 500.0}
    with pytest.raises(
        InputError, match="a: positions: expected the 68 particles of masses that differ in cohesion, got"
    ):
        particle_cohesion(two, 60, None, "a")
    # A part of the particles, as it is stored: each says its mass.
    assert particle_cohesion(two, 3, np.array([1, 0, 1], np.int32), "a").tolist() == [500.0, 0.0, 500.0]
    # Where all are alike, any number of points will do: an imported trajectory has its own.
    assert particle_cohesion(dataclasses.replace(scene, material=stiff), 3, None, "a").tolist() == [500.0] * 3


BAFFLES = (
    Baffle(lower=(0.5, 0.0, 0.1), size=(0.1, 0.3, 0.2)),
    Baffle(lower=(0.2, 0.0, 0.6), size=(0.05, 0.4, 0.1), turned_deg=30.0),
)


@pytest.fixture
def stretch() -> Sample:
    """A sample in a box of 0.8 x 0.6 x 0.8 m, points and corners at random, but for two baffles."""
    rng = np.random.default_rng(0)
    scene = scene_of(
        Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.1, 0.1)),
        size=(0.8, 0.6, 0.8),
        cell=0.1,
        baffles=BAFFLES,
        slope_deg=20.0,
        baffle_friction=0.3,
    )
    ground = rng.random((9, 9), np.float32), rng.random((9, 9), np.float32)
    return Sample(
        frames=rng.random((3, 7, 3), np.float32),
        velocity0=rng.random((7, 3), np.float32),
        targets=rng.random((2, 7, 3), np.float32),
        friction=rng.random(7, np.float32),
        cohesion=rng.random(7, np.float32),
        volume=rng.random(7, np.float32),
        surroundings=dataclasses.replace(Surroundings.of_scene(scene, 0.1), ground=ground),
    )


def same(one: Sample, other: Sample) -> bool:
    """Whether two samples are equal but for round-off."""
    pairs = [
        (getattr(a, field.name), getattr(b, field.name))
        for a, b in ((one, other), (one.surroundings, other.surroundings))
        for field in dataclasses.fields(a)
        if field.name != "surroundings"
    ]
    return all(np.allclose(a, b, rtol=0.0, atol=1e-6) for a, b in pairs)


@pytest.mark.parametrize("axis", [0, 2, None])
def test_a_mirror_turns_its_axes_and_twice_changes_nothing(stretch: Sample, axis: int | None) -> None:
    """All lengths are those of one body: in the mirror distances to baffles, walls and ground are what they were."""
    once = reflected(stretch, axis, 0.1)
    order, sign = ([2, 1, 0], 1.0) if axis is None else ([0, 1, 2], -1.0)
    turned = 0 if axis is None else axis
    np.testing.assert_allclose(once.velocity0[:, turned], sign * stretch.velocity0[:, order[turned]])
    before, after = stretch.surroundings, once.surroundings
    assert after.gravity[turned] == sign * before.gravity[order[turned]]
    np.testing.assert_array_equal(after.baffle_turn, -before.baffle_turn)
    for name in ("frames", "targets"):
        mine, theirs = getattr(stretch, name)[..., order], getattr(once, name)
        np.testing.assert_allclose(theirs[..., turned], mine[..., turned] if sign > 0 else 0.8 - mine[..., turned])
        np.testing.assert_array_equal(theirs[..., 1], mine[..., 1])
        gaps = [
            np.sort(abs(points[..., None, None, :] - around.baffles), axis=-2)[..., axes]
            for points, around, axes in ((getattr(stretch, name), before, order), (theirs, after, [0, 1, 2]))
        ]
        np.testing.assert_allclose(*gaps, atol=1e-6)
    assert before.ground is not None
    assert after.ground is not None
    for there, here in zip(after.ground, before.ground, strict=True):
        np.testing.assert_allclose(there, here.T if axis is None else np.flip(here, min(axis, 1)), atol=1e-6)
    assert not same(once, stretch)
    assert same(reflected(once, axis, 0.1), stretch)


def test_flows_are_opened_when_they_are_asked_for(trajectory: Trajectory, tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        trajectory.save(tmp_path / "train" / f"{name}.npz")

    def opened(path: Path) -> Flow:
        return Flow.from_trajectory(open_trajectory(path), 0.0025, str(path))

    flows = load_flows(tmp_path, "train", opened)
    assert np.array_equal(flows[1].positions, trajectory.positions)
    assert not flows[1].positions.flags.owndata
    assert [Path(flow.name).stem for flow in flows] == ["a", "b", "c"]
    (tmp_path / "train" / "b.npz").write_bytes(b"none")
    assert Path(flows[2].name).stem == "c"
    with pytest.raises(InputError, match=r"b\.npz: expected a whole NPZ"):
        flows[1]
    with pytest.raises(InputError, match=r"b\.npz: expected a whole NPZ"):
        load_flows(tmp_path, "train", opened)


FRAME_DT = 0.0025


def test_moments_of_parts_are_those_of_the_whole() -> None:
    # A mean far above the spread: the sum of squares alone would lose every digit.
    samples = np.random.default_rng(0).normal([1.0e6, -3.0], [0.01, 2.0], (1000, 2))
    parts = np.split(samples, [1, 1, 300, 999])
    joint = reduce(add, (MotionStatistics.from_samples(part, part[:0]) for part in parts))
    assert joint.count.tolist() == [[1000], [0]]
    np.testing.assert_allclose(joint.mean, [samples.mean(axis=0), [0.0, 0.0]], rtol=1e-14)
    np.testing.assert_allclose(joint.std, [samples.std(axis=0), [0.0, 0.0]], rtol=1e-7)


def walk(seed: int, frames: int, points: int) -> np.ndarray:
    """Points that always move faster than the threshold; positions [m], shape [T, N, 2]."""
    steps = np.random.default_rng(seed).uniform(0.001, 0.01, (frames, points, 2))
    return np.cumsum(steps, axis=0)


def test_statistics_of_moving_points_are_numpys() -> None:
    sequences = [walk(0, 6, 40), walk(1, 9, 10)]
    joint = reduce(add, (motion_statistics(sequence, FRAME_DT) for sequence in sequences))
    velocities = np.concatenate([np.diff(sequence, axis=0).reshape(-1, 2) for sequence in sequences])
    accelerations = np.concatenate([np.diff(sequence, 2, axis=0).reshape(-1, 2) for sequence in sequences])
    for index, samples in enumerate((velocities, accelerations)):
        assert joint.count[index] == len(samples)
        np.testing.assert_allclose(joint.mean[index], samples.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(joint.std[index], samples.std(axis=0), rtol=1e-12)


def test_points_at_rest_do_not_count() -> None:
    moving = walk(0, 6, 40)
    resting = np.broadcast_to([0.5, 0.1], (6, 1000, 2)).copy()
    resting[1:, :, 0] += 0.9 * MOVING_SPEED * FRAME_DT  # one step just below the threshold
    both = motion_statistics(np.concatenate([moving, resting], axis=1), FRAME_DT)
    alone = motion_statistics(moving, FRAME_DT)
    assert both.count.tolist() == [[5 * 40], [4 * 40]]
    np.testing.assert_array_equal([both.mean, both.std], [alone.mean, alone.std])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kept", [1, 2, 5])
def test_every_cell_keeps_its_volume(dimension: int, kept: int) -> None:
    positions = np.random.default_rng(0).uniform(-0.1, 0.3, (500, dimension))
    thinned = thin(positions, 2.0, cell=0.1, kept=kept, rng=np.random.default_rng(1))
    cells = np.floor(positions / 0.1).astype(int)
    stays = cells[thinned.indices]
    assert len(np.unique(thinned.indices)) == len(thinned.indices)
    for cell, count in zip(*np.unique(cells, axis=0, return_counts=True), strict=True):
        chosen = (stays == cell).all(axis=1)
        assert chosen.sum() == min(count, kept)
        assert thinned.volumes[chosen].sum() == pytest.approx(2.0 * count)


def test_a_cell_keeps_its_particles_in_proportion_to_their_volume() -> None:
    # Three quarters of the volume of each cell are at its right end, in a quarter of the particles.
    positions = np.tile([[0.01, 0.05], [0.02, 0.05], [0.03, 0.05], [0.09, 0.05]], (2000, 1))
    positions[:, 1] += np.repeat(np.arange(2000), 4) * 0.1
    volume = np.tile([1.0, 1.0, 1.0, 9.0], 2000)
    thinned = thin(positions, volume, cell=0.1, kept=1, rng=np.random.default_rng(0))
    assert np.mean(positions[thinned.indices, 0] > 0.05) == pytest.approx(0.75, abs=0.04)
    assert thinned.volumes.sum() == pytest.approx(volume.sum())
