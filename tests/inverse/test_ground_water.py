"""Pore pressure at gauges, and inversions of what makes it."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Mass, Material, Scene, Solid, Trajectory
from datasets.scene.parts import Water
from datasets.scene.water import DENSITY, consolidation
from inverse import Parameter, Problem, TargetSettings
from inverse.observations import FrontSettings, PorePressureSettings
from inverse.settings import Surrogate
from mpm import ALL, Recording
from tests.refusals import refused
from tests.scenes import flow_of, scene_of
from validation import solve

GRAVITY, SOIL, HEIGHT = 9.81, 2000.0, 0.4
DRAINS = Material(friction_deg=30.0, density=SOIL, saturated=True, young=1.0e6, permeability=5.0e-4)
GAUGES: dict[str, Any] = {"x": (0.04, 0.04), "y": (0.0, 0.2), "times": (0.1, 0.2, 0.4, 0.6, 0.8)}


def layer(ratio: float = 0.7, *, dimension: int = 2, **changes: Any) -> Scene:
    """A saturated layer between smooth walls on a tight floor."""
    width = (0.08,) * (dimension - 1)
    size = (width[0], HEIGHT, *width[1:])
    body = Mass(lower=(0.0,) * dimension, size=size, k0=0.5, initial_pore_pressure_ratio=ratio)
    box = (size[0], 0.48, *size[2:])
    given: dict[str, Any] = {"material": DRAINS, "duration": 0.8, "frame_dt": 0.05, "jitter": 0.0}
    return scene_of(body, **{"size": box, **given, **changes})


def drained(scene: Scene) -> Trajectory:
    """A layer whose excess pore pressure decays as its slowest part does, exp(-pi^2 c_v t / (4 h^2)), at rest."""
    lattice = np.stack(np.meshgrid(*((np.arange(side / 0.005) + 0.5) * 0.005 for side in scene.masses[0].size)), -1)
    places, ratio = lattice.reshape(-1, scene.dimension), scene.masses[0].initial_pore_pressure_ratio or 0.0
    rate = 0.25 * np.pi**2 * consolidation(scene.material, scene.gravity) / HEIGHT**2
    time = np.arange(scene.frames) * scene.frame_dt
    share = DENSITY / SOIL + (ratio - DENSITY / SOIL) * np.exp(-rate * time)
    p = SOIL * GRAVITY * share[:, None] * (HEIGHT - places[:, 1])
    return flow_of(scene, np.tile(places, (scene.frames, 1, 1)), pore_pressure=p.astype(np.float32))


@pytest.mark.parametrize("dimension", [2, 3])
def test_gauges_read_the_pressure_where_they_are(dimension: int) -> None:
    flow = drained(layer(dimension=dimension))
    across = {} if dimension == 2 else {"z": (0.04, 0.04)}
    gauges = PorePressureSettings(**GAUGES, **across).operator(flow.scene)
    rate = 0.25 * np.pi**2 * consolidation(DRAINS, GRAVITY) / HEIGHT**2
    share = 0.5 + 0.2 * np.exp(-rate * np.array(GAUGES["times"]))
    exact = SOIL * GRAVITY * np.concatenate([share * HEIGHT, share * (HEIGHT - 0.2)])
    assert gauges.observe(flow) == pytest.approx(exact, rel=2.0e-3)
    # On the floor where no elevation is given; nothing where nothing is.
    floor = dataclasses.replace(PorePressureSettings(**GAUGES, **across), y=None).operator(flow.scene)
    assert floor.observe(flow)[:5] == pytest.approx(exact[:5], rel=2.0e-3)
    above = dataclasses.replace(PorePressureSettings(**GAUGES, **across), y=(0.46, 0.46)).operator(flow.scene)
    assert above.observe(flow) == pytest.approx(0.0)


def test_gauges_stand_on_terrain_and_in_tables(tmp_path: Path) -> None:
    flow = drained(layer())
    bed = Solid(kind="terrain", points=((0.0, 0.1), (0.08, 0.1)))
    raised = dataclasses.replace(flow.scene.masses[0], lower=(0.0, 0.1), size=(0.08, 0.3))
    scene = dataclasses.replace(flow.scene, solids=(bed,), masses=(raised,))
    gauge = PorePressureSettings(x=(0.04,), times=(0.0,)).operator(scene)
    assert gauge.observe(flow) == pytest.approx(0.7 * SOIL * GRAVITY * 0.3, rel=2.0e-3)
    buried = PorePressureSettings(x=(0.04,), y=(0.05,), times=(0.0,))
    assert refused(buried.operator, scene, said="above the ground, at 0.1 m for gauge 0").key == "y"
    (tmp_path / "gauge.csv").write_text("time,pressure\n0.1,4000\n0.2,3500\n")
    target = PorePressureSettings(x=(0.04,), noise="5%", csv="gauge.csv").read(flow.scene, tmp_path, None)
    assert target.values == pytest.approx([4000.0, 3500.0])


def test_what_no_gauge_can_be_is_refused() -> None:
    scene, dry = layer(), scene_of()
    gauge = PorePressureSettings(x=(0.04,), times=(0.1,))
    assert refused(gauge.operator, dry).key == "kind"
    assert refused(dataclasses.replace(gauge, x=(2.0,)).operator, scene).key == "x"
    assert refused(dataclasses.replace(gauge, times=None).operator, scene).key == "times"
    assert refused(dataclasses.replace(gauge, z=(0.1,)).operator, scene).key == "z"
    bare = dataclasses.replace(drained(scene), pore_pressure=None)
    refused(gauge.operator(scene).observe, bare, said="recorded the pore pressure")


def draining() -> Problem:
    """How permeable a layer is and how fluid it begins, by two gauges."""
    truth = {"permeability": 5.0e-4, "masses[0].initial_pore_pressure_ratio": 0.8}
    return Problem(
        name="draining",
        scene=layer(0.5),
        parameters=(
            Parameter(name="permeability", initial=4.0e-4, lower=1.0e-4, upper=1.0e-3),
            Parameter(name="masses[0].initial_pore_pressure_ratio", initial=0.7, lower=0.6, upper=0.86),
        ),
        observations=(PorePressureSettings(noise=20.0, **GAUGES),),
        target=TargetSettings(twin=True, seed=5, truth=truth),
        surrogate=Surrogate.NONE,
    )


def check(**options: Any) -> None:
    problem = draining()
    result = solve(problem, **options)
    for name, true in problem.target.truth.items():
        low, high = result.interval[name]
        assert low <= true <= high
        assert result.unknowns[name] == pytest.approx(true, rel=0.1)
    assert result.verdict.confirms
    assert any(remark.startswith("partly drained") for remark in result.remarks) or "simulate" in options


def test_gauges_tell_permeability_and_initial_pressure() -> None:
    asked = list[Recording]()

    def known(scenes: Sequence[Scene], /, *, record: Recording = ALL) -> list[Trajectory]:
        asked.append(record)
        return [drained(scene) for scene in scenes]

    check(simulate=known)
    assert {recording.pore_pressure for recording in asked} == {True}


@pytest.mark.slow
def test_gauges_tell_permeability_and_initial_pressure_by_the_mpm() -> None:
    check()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no initial stress")
def test_a_gauge_and_a_front_tell_the_level_of_the_water_and_the_friction() -> None:
    """A column that falls while its lower half is full of water."""
    bed = Solid(kind="terrain", points=((0.0, 0.0), (1.0, 0.0)), friction=0.4)
    body, soil = Mass(lower=(0.0, 0.0), size=(0.2, 0.2), k0=0.5), dataclasses.replace(DRAINS, permeability=None)
    scene = scene_of(body, size=(1.0, 0.3), material=soil, solids=(bed,), water=Water(level=0.1), duration=0.6)
    names = {"water.level": (0.05, 0.18), "friction_deg": (20.0, 45.0)}
    problem = Problem(
        name="falling",
        scene=dataclasses.replace(scene, frame_dt=0.02),
        parameters=tuple(
            Parameter(name=name, initial=low, lower=low, upper=high) for name, (low, high) in names.items()
        ),
        observations=(
            PorePressureSettings(x=(0.1,), times=(0.0, 0.04), noise=30.0),
            FrontSettings(times=(0.3, 0.6), noise="2%"),
        ),
        target=TargetSettings(twin=True, seed=5, truth={"water.level": 0.12, "friction_deg": 32.0}),
        surrogate=Surrogate.NONE,
    )
    result = solve(problem)
    assert result.unknowns["water.level"] == pytest.approx(0.12, abs=0.01)
    for name, true in problem.target.truth.items():
        assert result.interval[name][0] <= true <= result.interval[name][1]
