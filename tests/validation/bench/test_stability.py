"""Hard cases: every check passes on sand at rest and finds what is wrong where something is; the rows hold."""

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Baffle, Mass, Scene, Trajectory
from datasets.errors import WorkFailed
from datasets.scene.particles import initial_particles
from tests import scenes
from tests.refusals import refused
from tests.scenes import flow_of
from validation.bench.__main__ import main
from validation.bench.accuracy.flows import MeasuredFlow
from validation.bench.stability import bench, invariants
from validation.bench.stability.bench import FOLDER, ROWS, HardCase, front_changes, fronts, read_rows, run, verdict
from validation.bench.stability.invariants import ALWAYS, Finding

BED = Mass(lower=(0.0, 0.0), size=(0.4, 0.2))
BAFFLE = Baffle(lower=(0.5, 0.0), size=(0.1, 0.2))
CUBE = Mass(lower=(0.0, 0.0, 0.0), size=(0.1, 0.1, 0.1))


def scene_of(mass: Mass = BED, **changes: Any) -> Scene:
    """A mass in a box, watched for five frames of 0.1 s."""
    settings = {"size": (0.8, 0.4), "duration": 0.4, "frame_dt": 0.1, "jitter": 0.0}
    return scenes.scene_of(mass, **settings | changes)


def at_rest(scene: Scene | None = None) -> Trajectory:
    """Nothing moves: the floor takes the weight, energies stay."""
    scene = scene or scene_of()
    points = initial_particles(scene)
    count, dimension = points.positions.shape
    mass = points.density * points.volume
    time = np.arange(scene.frames) * scene.frame_dt
    weight = mass.sum() * np.array(scene.gravity_vector)
    potential = -float(mass @ (points.positions @ np.array(scene.gravity_vector)))
    return flow_of(
        scene,
        np.repeat(points.positions[None], scene.frames, axis=0),
        velocities=np.zeros((scene.frames, count, dimension), np.float32),
        pressure=np.ones((scene.frames, count), np.float32),
        solid_impulse=np.zeros((scene.frames, len(scene.baffles), dimension)) if scene.baffles else None,
        summary={
            "precision": "f64",
            "steps": 1000,
            "energy": {
                "kinetic": [1.0] + [0.0] * (scene.frames - 1),
                "potential": [potential] * scene.frames,
                "elastic": [0.0] * scene.frames,
            },
            "wall_impulse": (time[:, None] * weight).tolist(),
        },
    )


def changed(flow: Trajectory, name: str, index: Any, value: Any) -> Trajectory:
    """The flow with `value` at `index` of one of its arrays."""
    array = getattr(flow, name).copy()
    array[index] = value
    return replace(flow, **{name: array})


def gains(flow: Trajectory) -> Trajectory:
    """The flow with energy from nowhere."""
    summary = copy.deepcopy(flow.summary)
    summary["energy"]["elastic"][3] = 3.0e-4 * summary["energy"]["potential"][0]
    return replace(flow, summary=summary)


def presses(flow: Trajectory) -> Trajectory:
    """The flow with a floor that takes 1 % more than the weight."""
    impulse = (1.01 * np.array(flow.summary["wall_impulse"])).tolist()
    return replace(flow, summary=flow.summary | {"wall_impulse": impulse})


def steep(flow: Trajectory) -> Trajectory:
    """The bed's particles as a pile of 45 degrees at the end."""
    x = np.sort(flow.positions[-1, :, 0])
    return changed(flow, "positions", -1, np.stack([x, np.clip(0.4 - x, 0.0, None)], axis=1))


SCENES = (
    scene_of(),
    scene_of(baffles=(BAFFLE,)),
    scene_of(gravity=0.0),
    scene_of(CUBE, size=(0.4, 0.2, 0.2)),
    scene_of(slope_deg=60.0, floor_friction=2.0),
)


@pytest.mark.parametrize("scene", SCENES, ids=["bed", "baffle", "weightless", "3D", "slope"])
def test_sand_at_rest_passes(scene: Scene) -> None:
    for check in ALWAYS:
        finding = check(at_rest(scene))
        assert finding is None or finding.ok, finding


@pytest.mark.parametrize(
    ("check", "wrong"),
    [
        (invariants.finite, lambda flow: changed(flow, "pressure", (2, 0), np.nan)),
        (invariants.inside_box, lambda flow: changed(flow, "positions", (2, 7), (-1e-4, 0.1))),
        (invariants.outside_baffles, lambda flow: changed(flow, "positions", (3, 0), (0.501, 0.1))),
        (invariants.mass, lambda flow: replace(flow, positions=flow.positions[:, 1:])),
        (invariants.momentum, lambda flow: changed(flow, "velocities", (3, slice(None), 0), 1e-3)),
        (invariants.momentum, presses),
        (invariants.momentum, lambda flow: changed(flow, "solid_impulse", (slice(2, None), 0, 0), 1.0)),
        (invariants.energy, gains),
        (invariants.slope, steep),
        (invariants.volume, lambda flow: changed(flow, "positions", -1, 0.9 * flow.positions[-1])),
    ],
)
def test_faults_are_found(check: Callable[[Trajectory], Finding], wrong: Callable[[Trajectory], Trajectory]) -> None:
    good = at_rest(scene_of(baffles=(BAFFLE,)))
    assert check is invariants.slope or check(good).ok
    assert not check(wrong(good)).ok


def test_every_row_has_a_scene_and_every_scene_a_row() -> None:
    rows = read_rows()
    assert sorted(row.name for row in rows) == sorted(path.stem for path in (FOLDER / "hard_cases").glob("*.toml"))
    assert {check["quantity"] for row in rows for check in row.checks} == ROWS["quantities"].keys()
    assert all(row.checks or row.over or row.what for row in rows)
    assert [row.name for row in read_rows(["long-step"])] == ["column", "long-step"]
    refused(read_rows, ["thin-layers"], said="did you mean 'thin-layer'?")


def test_a_verdict_says_what_is_wrong() -> None:
    check = {"quantity": "creeps", "maximum": 0.01}
    row = HardCase(name="rest", what="it rests", checks=(check,), over="other", within=0.1)
    flow = at_rest()
    assert verdict(row, flow, flow).failures == []
    crept = changed(flow, "positions", (-1, slice(None), 0), flow.positions[-1, :, 0] + 1e-3)
    assert verdict(row, crept, flow).failures == ["creep 0.05 cells (required ≤ 0.01)"]
    assert verdict(row, WorkFailed("it blew up")).failures == ["it blew up"]
    lost = verdict(row, changed(flow, "positions", 2, np.nan))
    assert lost.failures == ["not finite 1600 (required ≤ 0)"]


def test_fronts_over_stiffness_and_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "RELEASED", {2: (MeasuredFlow(aspect=1.0, friction_deg=30.0, box=3.0, duration=0.5), 4)})
    monkeypatch.setattr(bench, "STIFFNESSES", (1.0,))
    computed = fronts()
    assert computed.keys() == {(2, 1.0, 0.9), (2, 1.0, 0.3)}
    assert all(0.09 < x < 0.15 for by in computed.values() for x in by.values())
    example = {(2, 1.0, 0.9): {"AFLIP": 0.98, "APIC": 0.8}, (2, 1.0, 0.3): {"AFLIP": 1.02, "APIC": 1.2}}
    assert front_changes(example) == "4 % in 2D (with APIC by 40 %)"


def test_a_short_row_holds() -> None:
    (row,) = read_rows(["far-slow"])
    assert verdict(row, run([row], "f32")["far-slow"]).failures == []


@pytest.mark.filterwarnings("ignore::UserWarning")  # some rows are thin, or out of balance, on purpose
@pytest.mark.slow
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_every_row_holds(precision: str, tmp_path: Path) -> None:
    assert main(["stability", "--out", str(tmp_path), "--precision", precision]) == 0
    assert "**red**" not in (tmp_path / "stability.md").read_text()
