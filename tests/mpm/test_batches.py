"""Scenes that run side by side: each as it would alone, and one that fails fails alone."""

import dataclasses
import math
from functools import partial
from typing import Any

import numpy as np
import pytest

from datasets import Mass, Material, Scene, Trajectory, read_scene
from datasets.errors import WorkFailed
from datasets.scene.particles import Particles, initial_particles, particle_count
from mpm import WITH_FIELDS, Recording, ScenesFailed, simulate, simulate_each, simulate_many
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Offset, Worker
from mpm.kernel import SUMMED, compute
from mpm.runtime import parts_for, start, workers_for
from mpm.simulation import LARGE, Crew
from tests.refusals import refused
from tests.scenes import COLUMN, SAND, box, room

TOO_FAST = dataclasses.replace(COLUMN, velocity=(500.0, 0.0))  # thirteen times the wave speed of SOFT
SOFT = dataclasses.replace(SAND, young=2.0e6)


@pytest.mark.slow
def test_scenes_of_different_features_run_as_alone_and_come_back_in_order() -> None:
    clay = dataclasses.replace(SAND, cohesion=500.0, tension_cutoff=200.0)
    deep = room(Mass(lower=(0.0, 0.0, 0.2), size=(0.16, 0.2, 0.16)))
    scenes = [box(seed=1), box(material=clay), box(seed=2, duration=0.05), deep]
    together = simulate_many(scenes, record=WITH_FIELDS)
    assert [flow.scene for flow in together] == scenes
    for scene, beside in zip(scenes, together, strict=True):
        alone = simulate(scene, threads=1, record=WITH_FIELDS)
        np.testing.assert_array_equal(alone.positions, beside.positions)
        assert alone.summary["energy"] == beside.summary["energy"]
        assert alone.summary["steps"] == beside.summary["steps"]
    assert len({flow.summary["wall_s"] for flow in together}) == 1


def test_one_that_fails_fails_alone() -> None:
    scenes = [box(seed=1), box(TOO_FAST, material=SOFT), box(seed=2)]
    outcomes = simulate_each(scenes)
    assert [*map(type, outcomes)] == [Trajectory, WorkFailed, Trajectory]
    np.testing.assert_array_equal(outcomes[2].positions, simulate(scenes[2], threads=1).positions)
    with pytest.raises(ScenesFailed, match=r"^scene 1 of 3 failed: a particle moves at 500 m/s at t = 0 s") as caught:
        simulate_many(scenes)
    assert [*map(type, caught.value.outcomes)] == [Trajectory, WorkFailed, Trajectory]
    with pytest.raises(ScenesFailed, match=r"^scene 0 \(and 1 more of 2\) failed: "):
        simulate_many([box(TOO_FAST, material=SOFT, seed=1), box(TOO_FAST, material=SOFT, seed=2)])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"presision": "f64"}, "presision: expected a known key, did you mean 'precision'?"),
        ({"foo": 1}, "foo: expected a known key: precision or threads or arch or record or progress or file"),
        ({"precision": "f16"}, "precision: expected one of f32, f64, got 'f16'"),
        ({"arch": "gpu"}, "arch: expected one of cpu, cuda, got 'gpu'"),
        ({"record": "all"}, "record: expected a Recording, got 'all'"),
        ({"threads": 0}, "threads: expected a whole number from 1 on, got 0"),
    ],
)
def test_an_option_that_is_none_is_named(options: dict[str, Any], said: str) -> None:
    refused(simulate, box(), **options, said=said)
    refused(simulate_each, [box(), box()], **options, said=said)


def test_scenes_by_name() -> None:
    refused(simulate, "column-tal-42", said="did you mean 'column-tall-42'?")
    refused(simulate_many, [box(), "column-tal-42"], said="did you mean 'column-tall-42'?")
    refused(simulate_many, [], said="scenes: expected one scene at least, got none")
    flow = simulate("column-tall-42", record=Recording(frames="last"), threads=1)
    assert flow.scene == read_scene("column-tall-42")


def one_is_broken(scene: Scene, name: str) -> Particles:
    """The particles of a scene, of which the last of seed 1 has no number in one of their arrays."""
    particles = initial_particles(scene)
    values = getattr(particles, name).copy()
    values[-1] *= math.nan if scene.seed == 1 else 1.0
    return dataclasses.replace(particles, **{name: values})


@pytest.mark.slow
@pytest.mark.usefixtures("gpu")
def test_on_a_gpu_a_scene_beside_one_without_numbers_keeps_its_energies(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = partial(one_is_broken, name="velocity_gradients")
    monkeypatch.setattr("mpm.arrays.batch.initial_particles", broken)
    # Particles that are no multiple of those that a thread sums over: one of the threads has both scenes.
    small = Mass(lower=(0.1, 0.0), size=(0.14, 0.22))
    failed, beside = simulate_each([box(small, seed=1), box(small, seed=2)], arch="cuda")
    assert isinstance(failed, WorkFailed)
    assert isinstance(beside, Trajectory)
    assert len(beside.positions[0]) % SUMMED != 0
    alone = simulate(box(small, seed=2))
    for kind, series in alone.summary["energy"].items():
        np.testing.assert_allclose(beside.summary["energy"][kind], series, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(("particles", "parts"), [(19_999, 1), (20_000, 2), (39_999, 2), (40_000, 4), (10**6, 4)])
def test_a_large_scene_has_the_same_parts_on_one_two_and_four_threads(particles: int, parts: int) -> None:
    assert [parts_for(particles, threads) for threads in (1, 2, 4)] == [parts] * 3
    assert parts_for(particles, 3) == workers_for(particles, 3)


def test_sand_faster_than_its_waves_wants_a_stiffer_material_and_gets_by_with_it() -> None:
    with pytest.raises(WorkFailed, match=r"a shorter step does not help; a young of at least (\S+) Pa or") as caught:
        simulate(box(TOO_FAST, material=SOFT))
    assert "step_fraction" not in str(caught.value)
    young = float(str(caught.value).split("a young of at least ")[1].split(" Pa")[0])
    assert young > SOFT.modulus * (500.0 / (10.0 * SOFT.wave_speed)) ** 2
    firm = Material(friction_deg=30.0, young=young)
    # One frame is enough: it sets off.
    assert simulate(box(TOO_FAST, material=firm, duration=0.005)).summary["steps"] > 0


def test_what_is_no_number_wants_a_shorter_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mpm.arrays.batch.initial_particles", partial(one_is_broken, name="velocities"))
    with pytest.raises(WorkFailed, match=r"^the simulation blew up at t = 0 s; try a step_fraction below 0.4$"):
        simulate(box(seed=1))


def wide(workers: int) -> list[Scene]:
    """Scenes whose flows spread: two beside each other, or one for several threads."""
    slide = Mass(lower=(0.0, 0.1), size=(0.2, 0.2), velocity=(3.0, 0.0))
    return [box(slide, seed=1, cell=0.02 / workers)] + [box(slide, seed=2, duration=0.05)] * (workers == 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_grid_without_room_grows_and_the_run_goes_on(workers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes, outputs = wide(workers), []
    for fewest in (1, 2**20):
        monkeypatch.setattr("mpm.arrays.layout.FEWEST_NODES", fewest)
        monkeypatch.setattr("mpm.arrays.layout.NODES_PER_PARTICLE", 0)
        batch = Batch(scenes, precision="f32", workers=workers)
        first = batch.workers[:, Worker.ROOM].copy()
        start("f32", 2)
        for last in (3, 8):
            compute(batch, last)
        assert (batch.workers[:, Worker.USED] <= batch.workers[:, Worker.ROOM]).all()
        assert (batch.workers[:, Worker.ROOM] > first).all() == (fewest == 1)
        outputs.append([batch.recorded(0).copy(), batch.energies(0).copy(), batch.offsets[:, Offset.STEPS].copy()])
    for grown, at_once in zip(*outputs, strict=True):
        np.testing.assert_array_equal(grown, at_once)


def test_a_thread_computes_the_parts_of_several_to_the_bit() -> None:
    """As a large scene does while other processes need the processors."""
    start("f32", 2)
    batches = [Batch(wide(2), precision="f32", workers=3) for _ in range(3)]
    for batch, threads in zip(batches, ((2, 2), (1, 2), (1, 1)), strict=True):
        for last, count in zip((4, 7), threads, strict=True):
            compute(batch, last, count)
        np.testing.assert_array_equal(batch.positions, batches[0].positions)
        np.testing.assert_array_equal(batch.energies(0), batches[0].energies(0))


def test_a_large_scene_is_the_same_to_the_bit_on_one_thread_and_on_two() -> None:
    """Whose particles are sorted and whose calls end at other frames."""
    sand = Mass(lower=(0.0, 0.0), size=(0.45, 0.9), velocity=(1.0, 0.0))
    scene = box(sand, size=(1.0, 1.0), cell=0.008, duration=0.03)
    assert particle_count(scene) >= LARGE
    one, two = (simulate(scene, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one.positions, two.positions)
    assert one.summary["energy"] == two.summary["energy"]


def test_a_large_scene_takes_fewer_threads_while_processors_are_missing() -> None:
    crew = Crew(Batch(wide(2), precision="f32", workers=2))
    threads = []
    for missing in (0.1, 0.4, 0.8, 0.0, 0.8, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8):
        threads.append(crew.threads)
        crew.choose(1.0, crew.threads - missing)
    # A second with one thread after the first call that lacks a processor, then two seconds, then four.
    assert threads == [2, 2, 2, 1, 2, 1, 1, 2, 1, 1, 1, 1, 2, 2]


def test_time_and_memory_follow_the_material_not_the_box() -> None:
    """A box 90 times as high has the same nodes in use, and the same flow."""
    low, high = (Batch([box(size=(1.0, height))], precision="f32") for height in (1.0, 90.0))
    start("f32")
    for batch in (low, high):
        compute(batch, 21)
    assert low.workers[0, Worker.USED] == high.workers[0, Worker.USED] < 1000
    assert high.grid.nbytes <= 2 * low.grid.nbytes
    np.testing.assert_array_equal(low.positions, high.positions)
