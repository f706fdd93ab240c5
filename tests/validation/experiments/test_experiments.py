"""Experiments that ship can be run, wrong ones are refused by name; quantities of known deposits are exact."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets import Mass, Material, Trajectory, write_scene
from datasets.scene.particles import initial_particles, particle_count
from tests.refusals import refused
from tests.scenes import flow_of, scene_of
from validation.bench.experiments import compute, crossing, forecast, section
from validation.experiments.experiment import Experiment, Measured, Quantity, Reading, edge, quantity, read_experiments
from validation.run_store import Run

SHIPPED = read_experiments()
PLAUSIBLE = Reading(name="plausible", deg=25.0, rate=True)
EXPERIMENT = """
title = "A wedge"
what = "Its front falls by 10 mm a degree."
source = "this test"
licence = "MIT"
cells = [0.02, 0.01]
angles = [
  { name = "avalanche", lower_deg = 24.5, upper_deg = 25.5, status = "read", source = "this test" },
  { name = "repose", lower_deg = 20.0, upper_deg = 20.0, status = "worked out", source = "this test" },
]
assumptions = [{ what = "everything", choice = "nothing", reason = "a test" }]
grains = { friction_growth = 0.26, inertial_number = 0.3, grain_diameter = 0.001, grain_density = 2400.0, source = "" }
[[cases]]
name = "wedge"
scene = "wedge.toml"
[[cases.measured]]
quantity = "front"
value = 0.52
spread = 0.005
status = "read"
source = "this test"
"""

PARTICLES = 2000


def front_of(friction_deg: float) -> float:
    """Front of the wedge [m]: 0.5 m at 25 degrees, 10 mm less a degree."""
    return 0.5 - 0.01 * (friction_deg - 25.0)


def deposits(runs: Sequence[Run]) -> list[Trajectory]:
    """Blocks whose front is `front_of` their angle; on cells of 20 mm 2 % less."""
    flows = []
    for scene in [run.scene for run in runs]:
        factor = 0.98 if scene.domain.cell > 0.015 else 1.0
        # Evenly spaced from 0: the quantile at a share q is at q times the length.
        length = factor * front_of(scene.material.friction_deg) / 0.995
        x = length * (np.arange(PARTICLES) + 0.5) / PARTICLES
        flows.append(flow_of(scene, np.stack([x, 0.05 * np.ones(PARTICLES)], axis=1)[None]))
    return flows


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A folder with the one experiment `wedge`."""
    folder = tmp_path / "shelf" / "wedge"
    folder.mkdir(parents=True)
    (folder / "experiment.toml").write_text(EXPERIMENT)
    wedge = Mass(lower=(0.0, 0.0), size=(0.2, 0.1))
    write_scene(scene_of(wedge, size=(1.0, 0.2), duration=0.1, frame_dt=0.01), folder / "wedge.toml")
    return tmp_path / "shelf"


@pytest.mark.parametrize("experiment", SHIPPED, ids=lambda experiment: experiment.name)
def test_scenes_are_undamped_and_hold_what_was_measured(experiment: Experiment) -> None:
    for case in experiment.cases:
        coarse, fine = (experiment.scene(case, number, PLAUSIBLE) for number in (0, 1))
        assert fine.domain.cell < coarse.domain.cell
        for scene in (coarse, fine):
            assert scene.damping == 0.0
            assert (scene.material.friction_deg, scene.material.angle) == (PLAUSIBLE.deg, "slope")
            assert scene.material.cohesion == 0.0
            assert scene.floor_friction == "rough"
            if experiment.grains is not None:
                # tan(25 deg) + 0.26
                assert scene.material.friction_limit_deg == pytest.approx(36.0, abs=0.02)
            assert 500 < particle_count(scene) < 200_000
        for measured in case.measured:
            # The box must not be what stops the flow.
            if measured.quantity in (Quantity.FRONT, Quantity.RADIUS):
                assert measured.value + 3.0 * measured.spread < scene.domain.size[0]


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('licence = "MIT"', "", "licence"),
        ('licence = "MIT"', 'license = "MIT"', "license"),
        ("spread = 0.005", "", "spread"),
        ("spread = 0.005", "spread = 0.0", "spread"),
        ('status = "read"', 'status = "recalled"', "status"),
        ("lower_deg = 24.5", "lower_deg = 34.5", "lower_deg"),
        ('quantity = "front"', 'quantity = "height"', "within"),
        ("value = 0.52", "value = -0.52", "value"),
    ],
)
def test_a_wrong_experiment_is_refused_by_file_and_key(shelf: Path, old: str, new: str, key: str) -> None:
    path = shelf / "wedge" / "experiment.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    error = refused(read_experiments, shelf)
    assert error.where == str(path)
    assert key in error.key


def test_forward_and_backward_of_a_formula(shelf: Path) -> None:
    (experiment,) = read_experiments(shelf)
    ((score, other),), inferred = compute(experiment, experiment.cases[0], deposits)
    assert inferred is not None
    assert str(score.reading) == "25.0° (avalanche)"
    assert (score.coarse, score.fine) == pytest.approx((0.98 * 0.5, 0.5), abs=1e-5)
    assert score.error == pytest.approx(-4.0, abs=1e-3)
    assert not score.agrees
    assert str(other.reading) == "20.0° (repose, μ(I))"
    assert other.error == pytest.approx((0.98 * 0.55 - 0.52) / 0.005, abs=1e-3)
    # 20 mm further than at 25 degrees: 2 degrees less, by the slope of the coarse cells; twice 5 mm are a degree.
    assert inferred.deg == pytest.approx(25.0 - 0.02 / 0.0098, abs=1e-3)
    assert inferred.half_width_deg == pytest.approx(2.0 * 0.005 / 0.0098, rel=1e-3)
    assert inferred.difference_deg == pytest.approx(-2.04, abs=0.01)
    assert not inferred.agrees


@pytest.mark.parametrize("target", [0.36, 0.45, 0.6])
def test_the_angle_of_a_front_lies_between_runs(target: float) -> None:
    fronts = {angle: 12.5 / angle for angle in (20.0, 24.0, 28.0, 32.0, 36.0)}
    angle, slope = crossing(fronts, target)
    assert angle == pytest.approx(12.5 / target, abs=0.3)
    assert slope == pytest.approx(-(target**2) / 12.5, rel=0.2)
    # A front that no angle gives has a slope alone.
    fronts = {20.0: 0.6, 28.0: 0.5, 36.0: 0.45}
    assert math.isnan(crossing(fronts, 0.7)[0])
    assert (crossing(fronts, 0.7)[1], crossing(fronts, 0.3)[1]) == pytest.approx((-0.0125, -0.00625))


BLOCK = scene_of(Mass(lower=(0.0, 0.0), size=(0.4, 0.1)), size=(1.0, 0.2), cell=0.01, jitter=0.0)
AT_START = initial_particles(BLOCK).positions


def flow(*positions: NDArray[np.floating]) -> Trajectory:
    """A trajectory of BLOCK with these frames, a second from one to the next."""
    return flow_of(BLOCK, positions, time=np.arange(len(positions), dtype=np.float64))


def number(kind: Quantity, **other: object) -> Measured:
    """A measured number of a kind."""
    return Measured(quantity=kind, value=0.1, spread=0.01, status="read", source="", **other)


def test_edge_is_linear_between_stations_and_ends_with_the_deposit() -> None:
    stations = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    assert edge(stations, np.array([0.3, 0.3, 0.1, 0.0, 0.0]), 0.05) == pytest.approx(0.25)
    # A crumb beyond a gap does not belong to the deposit.
    assert edge(stations, np.array([0.3, 0.3, 0.1, 0.0, 0.2]), 0.05) == pytest.approx(0.25)
    assert edge(stations, np.array([0.3, 0.3, 0.3, 0.3, 0.3]), 0.05) == 0.4
    assert edge(stations, np.array([0.0, 0.0, 0.01, 0.0, 0.0]), 0.05) == pytest.approx(0.2)


def test_radius_is_about_the_vertical_axis() -> None:
    angles = np.linspace(0.0, np.pi / 2.0, 1001)
    circle = np.stack([0.3 * np.cos(angles), np.zeros(1001), 0.3 * np.sin(angles)], axis=1)
    assert quantity(number(Quantity.RADIUS), flow(circle)) == pytest.approx(0.3)
    # From 0.3 to 0.6 m within a second; one radius of two is 50 mm off.
    measured = number(Quantity.RADII, times=(0.5, 1.0), radii=(0.4, 0.6))
    assert quantity(measured, flow(circle, 2.0 * circle)) == pytest.approx(0.05 / np.sqrt(2.0))


def test_height_front_and_profile_of_a_block() -> None:
    assert quantity(number(Quantity.HEIGHT, within=0.05), flow(AT_START)) == pytest.approx(0.1)
    for front in (number(Quantity.FRONT), number(Quantity.FRONT, thicker_than=0.05)):
        assert quantity(front, flow(AT_START)) == pytest.approx(0.4, abs=0.006)
    measured = number(Quantity.PROFILE, x=(0.1, 0.2, 0.3, 0.6), heights=(0.1, 0.12, 0.1, 0.0))
    # One row of four is 20 mm off.
    assert quantity(measured, flow(AT_START)) == pytest.approx(0.01, rel=1e-3)
    for x, heights in (((0.1,), (0.1,)), ((0.1, 0.2), (0.1,)), ((0.2, 0.1), (0.1, 0.1))):
        refused(number, Quantity.PROFILE, x=x, heights=heights)


def sliding(runs: Sequence[Run]) -> list[Trajectory]:
    """Blocks a tenth of a metre thick that slide at 1 m/s, on coarse cells at half of it."""
    flows = []
    for scene in [run.scene for run in runs]:
        time = np.arange(scene.frames) * scene.frame_dt
        speed = 1.0 if scene.domain.cell < 0.015 else 0.5
        moved = np.zeros((len(time), 1, 2))
        moved[:, 0, 0] = speed * time
        flows.append(flow_of(scene, AT_START + moved))
    return flows


def test_a_prediction_says_when_and_how_thick_a_flow_passes(shelf: Path, tmp_path: Path) -> None:
    path = shelf / "wedge" / "experiment.toml"
    variants = "variants = [{ name = 'tight', consolidation = 0.01, source = 'this test' }]"
    text = "[[predictions]]\nname = 'slide'\nscene = 'wedge.toml'\nstart = 0.1\ngauges = [0.5]\nspacing = 0.05\n"
    path.write_text(EXPERIMENT.split("[[cases]]")[0] + text + variants)
    soil = Material(friction_deg=25.0, saturated=True)
    wedge = Mass(lower=(0.0, 0.0), size=(0.4, 0.1), k0="elastic")
    write_scene(scene_of(wedge, size=(2.0, 0.2), material=soil, duration=1.0, frame_dt=0.1), path.parent / "wedge.toml")
    (experiment,) = read_experiments(shelf)
    coarse, fine = forecast(experiment, experiment.predictions[0], sliding)
    # The front is 0.2 m from the gauge, which stands 0.6 m from the wall.
    assert fine.arrivals[0] == pytest.approx(0.2, abs=0.01)
    assert coarse.arrivals[0] == pytest.approx(0.4, abs=0.02)
    assert fine.thickness[0].max() == pytest.approx(0.1, rel=0.02)
    said = section("wedge, slide", experiment, [coarse, fine], tmp_path)
    assert "| tight  | 0.01       | 0.20 " in said
    assert (tmp_path / "experiments-wedge.png").exists()
