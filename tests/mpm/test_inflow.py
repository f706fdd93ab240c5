"""Material that flows in: exact plugs, the uniform depth of a steady flow, runs broken off, and who leaves it out."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Domain, Mass, Material, Scene, Solid, Trajectory, read_trajectory, write_scene
from datasets.compare import compare
from datasets.exchange.page import write_view
from datasets.exchange.vtk import Meshes
from datasets.flow.fields import FlowFields
from datasets.flow.trajectory import open_trajectory
from datasets.maps import maps_of
from gns.settings import ModelSettings
from gns.surroundings.initial import check
from inverse.problem import read_problem
from mpm import AT_REST, WITH_FIELDS, Recording, simulate
from mpm.adjoint.tape import Tape
from mpm.output.checkpoint import Checkpoint
from tests.mpm.test_run import broken_off, same
from tests.refusals import refused
from tests.scenes import scene_of

SAND = Material(friction_deg=30.0, young=1.0e6)
PULSE = ((0.05, 0.2, 1.0), (0.3, 0.2, 1.0))
SECTIONS: dict[str, dict[str, Any]] = {
    "on the floor": {"section": ((0.25,),)},
    "inclined": {"section": ((0.25, 0.1),), "direction": (2.0, 1.0)},
    "at a side": {"section": ((0.0,),)},
    "in 3D": {"section": ((0.2, 0.1, 0.5), (0.3, 0.1, 0.7)), "direction": (2.0, 0.0, -1.0), "discharge_factor": 0.2},
}


def entering(**changes: Any) -> Scene:
    """Free of gravity, a plug of 0.2 m^2 a second at 1 m/s for a quarter of a second."""
    mass = {"kind": "inflow", "hydrograph": PULSE, **SECTIONS["on the floor"]}
    mass |= {key: changes.pop(key) for key in ("hydrograph", *SECTIONS["in 3D"]) if key in changes}
    size = (1.5, 0.8, 0.9)[: 3 if len(mass["section"]) == 2 else 2]
    settings: dict[str, Any] = {"duration": 0.5, "frame_dt": 0.02, "gravity": 0.0} | changes
    return Scene(domain=Domain(size=size, cell=0.05), material=SAND, masses=(Mass(**mass),), **settings)


@pytest.mark.parametrize("section", SECTIONS)
def test_a_plug_moves_on_as_it_entered_without_any_stress(section: str) -> None:
    """At v (t - t_i) from its place, and before that at it."""
    scene = entering(**SECTIONS[section])
    flow = simulate(scene, threads=1, record=WITH_FIELDS)
    entry = flow.entry_time
    for frame, time in enumerate(flow.time):
        moved = np.maximum(time - entry, 0.0)[:, None] * flow.velocity0
        assert np.abs(flow.positions[frame] - flow.positions[0] - moved).max() < 3e-5
        inside = flow.entered(float(time))
        np.testing.assert_allclose(flow.velocities[frame][inside], flow.velocity0[inside], atol=1e-5)
        assert not flow.velocities[frame][~inside].any()
        # Mass to a particle: energy of those that have entered, the hydrograph's volume.
        volume = 0.2 * (scene.masses[0].discharge_factor or 1.0) * float(np.clip(time - 0.05, 0.0, 0.25))
        moving = flow.summary["energy"]["kinetic"][frame] / (0.5 * SAND.density)
        assert moving == pytest.approx(volume, abs=0.51 * flow.volumes[0])
    assert np.abs(flow.stress).max() < 1e-5 * SAND.modulus


def test_a_steady_inflow_on_a_smooth_incline_thins_as_it_speeds_up() -> None:
    """v^2 = v_0^2 + 2 g sin(slope) x and v h = q; its own pressure adds 4 % of that acceleration at most."""
    speed, depth, end = 4.0, 0.075, 0.5
    enters = {"section": ((0.1,),), "hydrograph": tuple((t, speed * depth, speed) for t in (0.0, end))}
    settings = {"gravity": 9.81, "slope_deg": 30.0, "open_sides": ("x+",), "volume_correction": False}
    scene = dataclasses.replace(entering(**enters, **settings), domain=Domain(size=(1.5, 0.4), cell=0.025))
    flow = simulate(scene, threads=1, record=WITH_FIELDS)
    for x in np.arange(0.3, 1.2, 0.2):
        here = np.abs(flow.positions[-5:, :, 0] - x) < 0.1
        mean_speed = flow.velocities[-5:][here][:, 0].mean()
        assert mean_speed == pytest.approx(math.sqrt(speed**2 + 9.81 * (x - 0.1)), rel=0.015)
        assert here.sum() / 5 * flow.volumes[0] / 0.2 * mean_speed == pytest.approx(speed * depth, rel=0.03)


@pytest.mark.slow
def test_a_steady_inflow_on_voellmys_incline_reaches_the_uniform_depth() -> None:
    """v^2 = xi h (sin - mu cos) at v h = q, from 0.8 of this speed; the stress is that of the weight."""
    steep, xi, mu, depth, bed, end = math.radians(30.0), 20.0, 0.2, 0.1, 0.1, 2.0
    speed = math.sqrt(xi * depth * (math.sin(steep) - mu * math.cos(steep)))
    mass = {"section": ((0.1,),), "hydrograph": tuple((t, speed * depth, 0.8 * speed) for t in (0.0, end))}
    ground = Solid(kind="terrain", points=((0.0, bed), (1.1, bed)), friction=mu, turbulence=xi)
    settings = {"slope_deg": 30.0, "open_sides": ("x+",), "duration": end, "frame_dt": 0.05, "solids": (ground,)}
    soil = Material(friction_deg=40.0, young=2.0e5)
    scene = scene_of(Mass(kind="inflow", **mass), size=(1.1, 0.4), cell=0.025, material=soil, **settings)
    flow = simulate(scene, threads=1, record=Recording(fields=True))
    here = (flow.positions[-5:, :, 0] > 0.4) & (flow.positions[-5:, :, 0] < 0.7)
    assert here.sum() / 5 * flow.volumes[0] / 0.3 == pytest.approx(depth, rel=0.04)
    assert flow.velocities[-5:][here][:, 0].mean() == pytest.approx(speed, rel=0.04)
    weight = 0.5 * scene.material.density * 9.81 * math.cos(steep) * depth
    assert flow.stress[-5:][here][:, 1].mean() == pytest.approx(-weight, rel=0.1)


def test_a_run_that_is_broken_off_is_the_whole_run(tmp_path: Path) -> None:
    scene = entering(gravity=9.81, duration=0.6, volume_correction=False)
    record = dataclasses.replace(WITH_FIELDS, frames=3)
    whole = simulate(scene, threads=1, record=record)
    # On a level smooth floor nothing flows back while there is inflow.
    assert whole.positions[whole.time < 0.3][..., 0].min() > 0.25 - 1e-5
    broken_off(scene, 1, threads=1, record=record).save(tmp_path / "checkpoint.npz")
    same(simulate(scene, threads=1, record=record, resume=Checkpoint.load(tmp_path / "checkpoint.npz")), whole)


@pytest.mark.slow
def test_a_scene_in_sorted_parts_is_the_same_flow(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = entering(gravity=9.81, duration=0.6)
    whole = simulate(scene, threads=1)
    monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 10)
    monkeypatch.setattr("mpm.simulation.LARGE", 10)
    shared = [simulate(scene, threads=threads) for threads in (1, 2)]
    np.testing.assert_array_equal(shared[0].positions, shared[1].positions)
    np.testing.assert_array_equal(shared[0].entry_time, whole.entry_time)
    np.testing.assert_allclose(shared[0].positions[-1].mean(axis=0), whole.positions[-1].mean(axis=0), atol=2e-3)


@pytest.mark.slow
def test_it_is_not_at_rest_before_all_has_entered() -> None:
    """Two pulses with a pause in which nothing moves, and the deposit then."""
    pulses = ((0.0, 0.1, 0.5), (0.1, 0.1, 0.5), (0.11, 0.0, 0.0), (1.4, 0.0, 0.0), (1.41, 0.1, 0.5), (1.5, 0.1, 0.5))
    scene = entering(hydrograph=pulses, gravity=9.81, duration=3.0, floor_friction=0.6)
    flow = simulate(scene, threads=1, record=dataclasses.replace(AT_REST, frames=5))
    assert flow.summary["rest_time"] > 1.4
    assert flow.summary["particles"] == len(flow.positions[-1])


@pytest.mark.slow
@pytest.mark.usefixtures("gpu")
def test_on_a_gpu_it_enters_at_the_same_times() -> None:
    scene = entering()
    one, other = (simulate(scene, threads=1, arch=arch, record=Recording(frames=5)) for arch in ("cpu", "cuda"))
    np.testing.assert_allclose(other.positions, one.positions, atol=1e-5)
    np.testing.assert_allclose(other.summary["energy"]["kinetic"], one.summary["energy"]["kinetic"], rtol=1e-5)


@pytest.fixture(scope="module")
def flow(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    """In 3D, of which at 0.1 s a fifth has entered; its positions as they are read again."""
    path = tmp_path_factory.mktemp("flow") / "trajectory.npz"
    whole = simulate(entering(**SECTIONS["in 3D"]), threads=1, record=dataclasses.replace(WITH_FIELDS, frames=5))
    fields = dict.fromkeys(("velocities", "stress", "pressure", "plastic_strain"))
    dataclasses.replace(whole, **fields).save(path)
    np.testing.assert_array_equal(open_trajectory(path).entry_time, read_trajectory(path).entry_time)
    return read_trajectory(path)


def test_who_reads_a_flow_leaves_out_what_has_not_entered(flow: Trajectory, tmp_path: Path) -> None:
    begun = [int(flow.entered(float(time)).sum()) for time in flow.time]
    assert begun[0] == 0
    assert 0 < begun[1] < begun[2] < begun[-1] == flow.positions.shape[1]
    meshes = Meshes(flow)
    assert [meshes.part("particles", frame, 0).n_points for frame in (0, 1, 5)] == [0, begun[1], begun[5]]
    early = dataclasses.replace(flow, positions=flow.positions[:2], time=flow.time[:2])
    assert maps_of(early, 0.1).volume == pytest.approx(begun[1] * flow.volumes[0], rel=1e-5)
    maps = maps_of(flow, 0.1)
    assert not maps.start.any()
    assert np.nanmin(maps.arrival) > 0.05
    comparison = compare(flow, flow)
    assert np.isnan(comparison.figures[0]["front"][0])
    energy = comparison.figures[0]["kinetic"][1]
    assert energy == pytest.approx(0.5 * SAND.density * begun[1] * flow.volumes[0], rel=0.02)
    assert comparison.apart["transport"][-1] == 0.0
    np.testing.assert_allclose(FlowFields(flow).velocity(1), flow.velocity0, atol=0.02)
    write_view(tmp_path / "flow.html", flow)
    text = (tmp_path / "flow.html").read_text()
    (run,) = json.loads(text[text.index('{"dimension"') :].split("</script>")[0])["runs"]
    assert run["front"][0] is None
    np.testing.assert_allclose(run["entry"], flow.entry_time)


PROBLEM = """
scene = "scene.toml"
unknowns = [{ name = "masses[0].discharge_factor", initial = 1.0, lower = 0.5, upper = 2.0 }]
observations = [{ kind = "front" }]
target = { twin = true }
"""


def test_a_problem_may_ask_for_the_discharge_by_the_deposit_alone(tmp_path: Path) -> None:
    write_scene(entering(discharge_factor=1.0, gravity=9.81), tmp_path / "scene.toml")
    (tmp_path / "problem.toml").write_text(PROBLEM)
    problem = read_problem(str(tmp_path / "problem.toml"))
    assert len(problem.operators) == 1
    assert problem.scene_at(np.array([1.5])).masses[0].discharge_factor == 1.5
    (tmp_path / "problem.toml").write_text(PROBLEM.replace('"front"', '"front", times = [0.2]'))
    timed = read_problem(str(tmp_path / "problem.toml"))
    refused(lambda: timed.operators, said="observations[0]: expected the deposit or forces, where material flows in")


def test_adjoint_and_surrogate_refuse_it_in_a_line() -> None:
    scene = entering()
    refused(Tape, [scene], [5], said="masses: expected masses present from the start")
    refused(check, scene, ModelSettings(dimension=2), said="masses: expected masses present from the start")
