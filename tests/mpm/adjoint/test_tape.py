"""Checkpoints: the run is the solver's own, segments change nothing, a budget is kept or refused."""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from datasets import Scene, read_scene
from datasets.errors import WorkFailed
from mpm import simulate
from mpm.adjoint.gradient import gradient, pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape, steady
from mpm.arrays.layout import Precision
from tests.mpm.adjoint.flows import Weighted, plane, room
from tests.mpm.adjoint.test_gradient import SCENES
from tests.refusals import refused

pytestmark = pytest.mark.double
FLAT = plane(volume_correction=False)


@pytest.mark.parametrize(
    ("scene", "precision"), [(FLAT, "f64"), pytest.param(room(damping=0.05), "f32", marks=pytest.mark.slow)]
)
def test_positions_are_those_of_the_solver(scene: Scene, precision: Precision) -> None:
    """To the bit, at every frame that is observed."""
    frames = [0, 1, scene.frames - 1]
    tape = Tape([scene], frames, precision=precision, threads=1)
    whole = simulate(scene, precision=precision, threads=1)
    np.testing.assert_array_equal(tape.positions().astype(np.float32), whole.positions[frames])


def test_segments_do_not_change_the_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bit: one frame a segment, three, or all frames in one."""
    slopes, last = [], FLAT.frames - 1
    for length in (1, 3, last):
        monkeypatch.setattr(Tape, "plan", lambda *_, length=length: sorted({*range(0, last, length), last}))
        slopes.append(gradient(FLAT, Weighted(FLAT), threads=1)[1])
    for other in slopes[1:]:
        for name in ("positions", "velocities", "properties"):
            np.testing.assert_array_equal(getattr(slopes[0], name), getattr(other, name))
        np.testing.assert_allclose(slopes[0].settings, other.settings, rtol=1e-12)


def test_grids_that_grow_backwards_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in a replay nor between two reverse steps: a reverse step needs more nodes than the run did there."""
    thrown = plane(volume_correction=False, duration=0.01)
    expected = gradient(thrown, Weighted(thrown), threads=1)[1]
    monkeypatch.setattr("mpm.arrays.layout.NODES_PER_PARTICLE", 0)
    monkeypatch.setattr("mpm.arrays.layout.FEWEST_NODES", 1)
    monkeypatch.setattr("mpm.arrays.batch.GROWTH", 1.0)
    rooms, nodes = set(), Tape.nodes

    def counted(tape: Tape) -> dict[str, Any]:
        rooms.add(len(tape.batch.grid))
        return nodes(tape)

    monkeypatch.setattr(Tape, "nodes", counted)
    slope = gradient(thrown, Weighted(thrown), threads=1)[1]
    assert len(rooms) > 1
    for name in ("positions", "velocities", "properties"):
        np.testing.assert_array_equal(getattr(slope, name), getattr(expected, name))


def test_memory_stays_within_the_budget_and_grows_with_the_root_of_the_steps() -> None:
    used = []
    for duration in (0.04, 0.16):
        scene = dataclasses.replace(FLAT, duration=duration)
        tape = Tape([scene], [scene.frames - 1], threads=1, memory_mib=64.0)
        assert tape.bytes() < 64.0 * 2**20
        used.append(tape.bytes() - tape.fixed_bytes)
    # Four times the steps, at most two and a half times the states.
    assert used[1] < 2.5 * used[0]
    said = str(refused(Tape, [FLAT], [8], threads=1, memory_mib=0.5, said="memory for the adjoint of at least"))
    enough = float(re.findall(r"at least ([\d.]+) MiB, got 0.5 MiB", said)[0]) + 0.1
    assert Tape([FLAT], [8], threads=1, memory_mib=enough).bytes() < enough * 2**20


def test_frames_between_are_observed_too() -> None:
    """A sum over frames has the sum of their gradients."""
    tape = Tape([FLAT], [0, 3, 8], threads=1, outputs=4)
    weights = np.random.default_rng(1).normal(size=tape.positions().shape)
    parts = [weights * (np.arange(3) == slot)[:, None, None] for slot in range(3)]
    whole, *by_frame = [slope for (slope,) in pull_back_all(tape, [[FlowAdjoints(w)] for w in (weights, *parts)])]
    np.testing.assert_allclose(sum(part.velocities for part in by_frame), whole.velocities, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(by_frame[0].positions, parts[0][0])
    assert not by_frame[0].velocities.any()
    alone = gradient(dataclasses.replace(FLAT, duration=0.0075), lambda x, v: (0.0, parts[1][1:2], None), threads=1)[1]
    np.testing.assert_allclose(by_frame[1].velocities, alone.velocities, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_scenes_side_by_side_are_as_alone() -> None:
    """Of other seeds and speeds, each with its own steps; to the bit."""
    first, second = plane(volume_correction=True), plane(volume_correction=True, seed=3, gravity=40.0)
    tape = Tape([first, second], [8], threads=2)
    objectives = [Weighted(first), Weighted(second)]
    adjoints = [FlowAdjoints(objective.positions, objective.velocities) for objective in objectives]
    (together,) = pull_back_all(tape, [adjoints])
    for scene, objective, ours in zip((first, second), objectives, together, strict=True):
        _, alone = gradient(scene, objective, threads=1)
        np.testing.assert_array_equal(ours.velocities, alone.velocities)
        np.testing.assert_array_equal(ours.settings, alone.settings)


def test_a_gradient_without_bound_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where more adjoints are cut than may be: here all that are not 0."""
    tape = Tape([dataclasses.replace(FLAT, step_fraction=0.9)], [8], threads=1)
    monkeypatch.setattr("mpm.adjoint.tape.CUT", 0.0)
    with pytest.raises(WorkFailed, match=r"grows without bound.* try a step_fraction below 0.9"):
        pull_back_all(tape, [[FlowAdjoints(np.ones_like(tape.positions()))]])


def test_steady_steps_are_those_of_a_lone_particle() -> None:
    """(lambda + 2 mu) / (3 lambda + 2 mu) at nu = 0.3 is (1 - nu) / (1 + nu); a scene in 2D keeps its steps."""
    scene = room()
    stiff = dataclasses.replace(scene, step_fraction=0.9, material=dataclasses.replace(scene.material, poisson=0.3))
    assert steady(stiff).step_fraction == pytest.approx(np.sqrt(0.7 / 1.3))
    assert steady(dataclasses.replace(stiff, step_fraction=0.4)).step_fraction == 0.4
    assert steady(plane(step_fraction=0.9)).step_fraction == 0.9


@pytest.mark.slow
def test_lone_particles_that_swing_are_cut() -> None:
    """Sand of ten layers without memory of gaps: at 0.9 of the step lone particles swing, at 0.8 none does.

    Exact, the first gradient has no bound; with a few adjoints cut it is that of the same flow in shorter steps."""
    scene = read_scene("layers-10")
    sand = dataclasses.replace(scene.material, cohesion=0.0, tension_cutoff=None)
    scene = dataclasses.replace(scene, material=sand, damping=0.0, volume_correction=False)
    slopes = {}
    for fraction, exact in ((0.9, True), (0.9, False), (0.8, False)):
        tape = Tape([dataclasses.replace(scene, step_fraction=fraction)], [400], threads=1, exact=exact)
        weights = np.zeros_like(tape.positions())
        weights[..., 0] = 1.0 / weights.shape[1]
        ((slopes[fraction, exact],),) = pull_back_all(tape, [[FlowAdjoints(weights)]])
    assert np.abs(slopes[0.9, True].velocities).max() > 1e3
    assert 0.0 < slopes[0.9, False].cut < 1e-4
    assert slopes[0.8, False].cut == 0.0
    speeds = [slopes[fraction, False].of_mass(slopes[fraction, False].velocities)[:, 0] for fraction in (0.9, 0.8)]
    assert speeds[0].sum() == pytest.approx(speeds[1].sum(), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [plane(damping=0.05), SCENES["baffle"], room()], ids=["2D", "baffle", "3D"])
def test_one_scene_on_two_threads(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run and its gradient are those of one thread but for rounding, and repeat to the bit without solids."""
    alone = gradient(scene, Weighted(scene), threads=1)[1]
    monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 100)
    runs = [gradient(scene, Weighted(scene), threads=2)[1] for _ in range(2)]
    for name in ("positions", "velocities", "stress", "properties", "settings", "faces", "holds"):
        expected, threaded, again = (getattr(slope, name) for slope in (alone, *runs))
        np.testing.assert_allclose(threaded, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max(initial=1e-300))
        if not scene.baffles:
            np.testing.assert_array_equal(threaded, again)
