"""Pore water: consolidation, rest, sheets on inclines, and what is refused."""

import dataclasses
import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import Mass, Material, Scene, Solid, Trajectory
from datasets.scene import water
from datasets.scene.library import scene_from
from datasets.scene.parts import Water
from datasets.scene.water import drainage
from gns.settings import ModelSettings
from gns.surroundings.initial import check
from inverse.parameters.kind import KINDS
from mpm import WITH_FIELDS, simulate
from mpm.adjoint.tape import check as known_to_adjoint
from mpm.arrays.features import features_of
from mpm.output.recording import Recording
from tests.refusals import refused
from tests.scenes import scene_of
from validation.bench.stability.invariants import momentum

GRAVITY, DENSITY, HEIGHT = 9.81, 2000.0, 0.4
WET = Material(friction_deg=30.0, density=DENSITY, saturated=True)
FIELDS, PRESSURES = Recording(fields=True), Recording(pore_pressure=True)
MODES = (2.0 * np.arange(60) + 1.0) * math.pi / 2.0
EVEN: dict[str, Any] = {"jitter": 0.0}


def layer(ratio: float | None, *, width: float = 0.08, c_v: float | None = None, **changes: Any) -> Scene:
    """A layer of HEIGHT between smooth walls on a tight floor."""
    material = dataclasses.replace(WET, consolidation=c_v)
    body = Mass(lower=(0.0, 0.0), size=(width, HEIGHT), k0=0.5, initial_pore_pressure_ratio=ratio)
    given = {"duration": 1.0, "frame_dt": 0.05} | changes
    return scene_of(body, size=(width, 0.48), material=material, **given)


def off_terzaghi(flow: Trajectory, ratio: float, c_v: float) -> np.ndarray[Any, Any]:
    """Error of the degree of consolidation over the time of the flow of such a layer, [T].

    Exact with one drain, of an excess that grows linearly from it (Terzaghi 1943)."""
    decay = np.exp(-(MODES**2) * c_v * flow.time[:, None] / HEIGHT**2)
    exact = 1.0 - (4.0 * (-1.0) ** np.arange(60) / MODES**3 * decay).sum(axis=1)
    at_rest = water.DENSITY * GRAVITY * (HEIGHT - flow.positions[:, :, 1])
    first = (ratio * DENSITY - water.DENSITY) * GRAVITY * (HEIGHT - flow.positions[0, :, 1]).mean()
    return np.abs(1.0 - (flow.pore_pressure - at_rest).mean(axis=1) / first - exact)


@pytest.mark.parametrize(("ratio", "jitter"), [(0.7, 0.0), (0.7, 0.4), (0.2, 0.4)])
def test_layers_consolidate_and_swell_as_terzaghi_says(ratio: float, jitter: float) -> None:
    c_v = 0.16
    flow = simulate(layer(ratio, c_v=c_v, jitter=jitter), record=PRESSURES)
    assert off_terzaghi(flow, ratio, c_v)[flow.time * c_v >= 0.049 * HEIGHT**2].max() < 0.01


@pytest.mark.filterwarnings("ignore:no initial stress")
def test_grains_that_yield_consolidate_by_their_plastic_stiffness() -> None:
    """sigma'_y = 3 K e / (1 + 2 K_a) where both horizontal stresses are K_a sigma'_y, in place of M e."""
    c_v, ratio, k0 = 0.16, 0.9, 0.75
    scene = layer(ratio, c_v=c_v, **EVEN)
    soil = dataclasses.replace(scene.material, friction_deg=10.0)
    scene = dataclasses.replace(scene, material=soil, masses=(dataclasses.replace(scene.masses[0], k0=k0),))
    flow = simulate(scene, record=PRESSURES)
    active = math.tan(math.radians(40.0)) ** 2
    stiffness = (3.0 * soil.lame + 2.0 * soil.shear_modulus) / (1.0 + 2.0 * active)
    slower = water.mobility(soil, GRAVITY) * stiffness
    assert slower < 0.8 * c_v
    assert off_terzaghi(flow, ratio, slower)[flow.time > 0.1].max() < 0.01


def test_water_at_rest_moves_nothing() -> None:
    scene = layer(None, width=0.4, duration=1.0, frame_dt=0.1, c_v=0.01)
    flow = simulate(scene, record=PRESSURES)
    moved = np.linalg.norm(flow.positions[-1] - flow.positions[0], axis=1).max()
    assert moved < 1.0e-3 * scene.domain.cell
    assert np.allclose(flow.pore_pressure[-1].mean(), 0.5 * water.DENSITY * GRAVITY * HEIGHT, rtol=0.02)


def sheet(ratio: float | None, *, friction: float, width: float = 0.0, length: float = 2.0, **changes: Any) -> Scene:
    """A sheet of five cells on an incline, in a tilted box; in 3D with a width [m]."""
    soil = dataclasses.replace(WET, **{"friction_deg": 35.0} | changes.pop("material", {}))
    line = {"points": ((0.0, 0.0), (length + 1.0, 0.0))}
    plan = {"origin": (0.0, 0.0), "spacing": (length + 1.0, width), "heights": ((0.0, 0.0), (0.0, 0.0))}
    bed = Solid(kind="terrain", friction=friction, **(plan if width else line))
    across = (width,) if width else ()
    place, size = (0.1, 0.0, 0.0)[: 2 + len(across)], (length, 0.1, *across)
    body = Mass(lower=place, size=size, initial_pore_pressure_ratio=ratio)
    given = {"solids": (bed,), "duration": 0.3, "frame_dt": 0.03} | EVEN | changes
    return scene_of(body, size=(length + 1.0, 0.3, *across), material=soil, **given)


def travelled(flow: Trajectory) -> np.ndarray[Any, Any]:
    """Displacement of the middle of a sheet along its bed [m], [T]."""
    x = flow.positions[:, :, 0]
    middle = np.abs(x[0] - 0.5 * (x[0].min() + x[0].max())) < 0.2
    return np.asarray((x[:, middle] - x[0, middle]).mean(axis=1))


FLOOR: dict[str, Any] = {"solids": (), "floor_friction": 0.3}


@pytest.mark.parametrize(
    ("changes", "ratio", "miss"),
    [
        (FLOOR, 0.8, 0.005),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in [
                ({}, None, 0.002),
                ({}, 0.5, 0.005),
                ({}, 0.8, 0.005),
                ({"jitter": 0.4}, 0.5, 0.02),
                ({"jitter": 0.4}, 0.8, 0.02),
                (FLOOR, 0.5, 0.002),
                (FLOOR | {"jitter": 0.4}, 0.8, 0.01),
                (FLOOR | {"width": 0.12, "length": 4.0, "duration": 0.04}, 0.8, 0.01),
                ({"width": 0.12, "length": 4.0, "duration": 0.04}, 0.8, 0.01),
                # A single row of particles in each cell does not tell the pressure at the bed.
                ({"particles_per_axis": 1}, 0.5, 0.03),
                # Where the bed cuts the cells, water cannot bear what the grid asks of single rows, and grains may not.
                ({"raised": 0.25}, 0.5, 0.005),
                ({"raised": 0.25}, 0.8, 0.03),
                ({"raised": 0.5}, 0.8, 0.03),
                ({"raised": 0.4, "jitter": 0.4}, 0.8, 0.08),
            ]
        ),
    ],
)
def test_a_sheet_slides_by_its_effective_stress(changes: dict[str, Any], ratio: float | None, miss: float) -> None:
    """Of a ratio, or in water that fills it and stays, half as heavy; so long that no wave from its ends gets there.

    raised: the bed, by so many cells."""
    slope_deg, friction, fixed = 25.0, 0.3, {} if ratio else {"water": Water(fixed=True)}
    soil = {"friction_deg": 50.0, "young": 2.0e5}
    given: dict[str, Any] = {"length": 8.0, "duration": 0.08, "frame_dt": 0.04, "material": soil} | fixed | changes
    height = given.pop("raised", 0.0) * 0.02
    scene = sheet(ratio, slope_deg=slope_deg, friction=friction, **given)
    if height:
        bed = dataclasses.replace(scene.solids[0], points=((0.0, height), (9.0, height)))
        body = dataclasses.replace(scene.masses[0], lower=(0.1, height))
        scene = dataclasses.replace(scene, solids=(bed,), masses=(body,))
    flow = simulate(scene, record=FIELDS)
    x = flow.positions[0, :, 0]
    speed = flow.velocities[-1, np.abs(x - 0.5 * (x.min() + x.max())) < 0.2, 0].mean()
    steep = math.radians(slope_deg)
    acceleration = GRAVITY * (math.sin(steep) - (1.0 - (ratio or 0.5)) * friction * math.cos(steep))
    assert speed == pytest.approx(acceleration * flow.time[-1], rel=miss)


@pytest.mark.double
def test_what_water_presses_on_walls_is_recorded() -> None:
    """The momentum of a wet column that spreads between walls is gravity's less what these took."""
    body = Mass(lower=(0.0, 0.0), size=(0.2, 0.2), k0=0.5, initial_pore_pressure_ratio=0.6)
    settings: dict[str, Any] = {"size": (0.4, 0.3), "material": WET, "duration": 0.3, "frame_dt": 0.02}
    scene = scene_of(body, floor_friction=0.4, wall_friction=0.3, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        flow = simulate(scene, record=WITH_FIELDS, precision="f64")
    assert momentum(flow).value < 1.0e-5


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.5, 0.8])
def test_side_walls_rub_on_grains_alone(ratio: float) -> None:
    """A sheet in a channel, so strong that it stays a block: its walls take mu of the effective stress across it."""
    slope_deg, friction, wall, width = 25.0, 0.3, 0.3, 0.12
    given: dict[str, Any] = {"duration": 0.15, "length": 1.2, "material": {"friction_deg": 50.0, "young": 5.0e5}}
    scene = sheet(ratio, slope_deg=slope_deg, friction=friction, width=width, wall_friction=wall, **given)
    flow = simulate(scene, record=FIELDS)
    middle, steep = np.abs(flow.positions[0, :, 0] - 0.7) < 0.25, math.radians(slope_deg)
    across = -flow.stress[:, middle, 2].mean()
    acceleration = GRAVITY * (math.sin(steep) - (1.0 - ratio) * friction * math.cos(steep))
    acceleration -= 2.0 * wall * across / (DENSITY * width)
    assert across == pytest.approx(0.43 * (1.0 - ratio) * DENSITY * GRAVITY * math.cos(steep) * 0.05, rel=0.2)
    assert travelled(flow)[-1] == pytest.approx(0.5 * acceleration * flow.time[-1] ** 2, rel=0.035)


def draining(c_v: float, ratio: float, duration: float) -> tuple[Trajectory, float]:
    """A sheet whose water drains at its top: its flow, and the mean share of its weight that grains bear at the bed.

    So long that waves from its ends do not reach the middle, and so strong that its grains stay elastic."""
    soil: dict[str, Any] = {"friction_deg": 50.0, "young": 2.0e5, "consolidation": c_v}
    times: dict[str, Any] = {"duration": duration, "frame_dt": 0.02}
    flow = simulate(sheet(ratio, slope_deg=8.0, friction=0.35, length=16.0, material=soil, **times), record=FIELDS)
    time = np.linspace(0.0, duration, 1001)
    excess = (2.0 / MODES**2 * np.exp(-(MODES**2) * c_v / 0.1**2 * time[:, None])).sum(axis=1)
    return flow, float(np.mean(0.5 - (ratio - 0.5) * excess))


@pytest.mark.slow
def test_a_sheet_is_braked_as_its_water_drains() -> None:
    """The impulse of the bed is that of the effective stress of a one-dimensional layer (Terzaghi)."""
    flow, share = draining(0.01, 0.8, 0.3)
    steep, time = math.radians(8.0), float(flow.time[-1])
    x = flow.positions[0, :, 0]
    speed = flow.velocities[-1, np.abs(x - 8.1) < 0.2, 0].mean()
    braked = math.sin(steep) - speed / (GRAVITY * time)
    assert braked / (0.35 * math.cos(steep)) == pytest.approx(share, rel=0.06)


@pytest.mark.slow
def test_a_sheet_stops_once_its_water_has_drained() -> None:
    flow, _ = draining(0.03, 0.9, 0.6)
    moved = travelled(flow)
    assert moved[5] < 0.9 * moved[-1]
    assert moved[-1] - moved[-6] < 0.02 * moved[-1]


@pytest.mark.slow
def test_moduli_step_and_cell_are_numerical(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of very wet columns; a difference of two such means of five has a standard error of 2 to 3 %."""
    usual = front(0.8, seeds=5)
    assert front(0.8, seeds=5, young=2.0e6) == pytest.approx(usual, rel=0.06)
    assert front(0.8, seeds=5, step_fraction=0.2) == pytest.approx(usual, rel=0.07)
    assert front(0.8, seeds=3, cell=0.005) == pytest.approx(usual, rel=0.09)
    # Ten cells are few for a tip that is thinner than one.
    assert front(0.8, seeds=5, cell=0.02) == pytest.approx(usual, rel=0.17)
    fronts = []
    for stiffer in (5.0, 50.0):
        monkeypatch.setattr(water, "STIFFER", stiffer)
        fronts.append(front(0.8, seeds=12))
    # Of 40 jitters each, 2.2 % with a standard error of 1 %.
    assert fronts[1] == pytest.approx(fronts[0], rel=0.07)


def column(ratio: float | None, *, young: float = 2.0e5, threads: int | None = None, **changes: Any) -> Trajectory:
    """The flow of a column of 0.2 m; dry without a ratio. changes: of the scene and its `material`."""
    soil = dataclasses.replace(WET, saturated=ratio is not None, young=young, **changes.pop("material", {}))
    bed = Solid(kind="terrain", points=((0.0, 0.0), (1.6, 0.0)), friction=0.4)
    body = Mass(lower=(0.0, 0.0), size=(0.2, 0.2), k0=0.5, initial_pore_pressure_ratio=ratio)
    given = {"solids": (bed,), "cell": 0.01, "duration": 1.2, "frame_dt": 0.02} | changes
    with warnings.catch_warnings():
        # That no stress within yield balances gravity on a jittered grid; the column falls at once.
        warnings.simplefilter("ignore")
        flow = scene_of(body, size=(1.6, 0.3), material=soil, **given)
        return simulate(flow, threads=threads, record=PRESSURES if threads else Recording())


def front(ratio: float | None, *, seeds: int = 3, **changes: Any) -> float:
    """Mean front of such columns over several jitters [m]."""
    return float(np.mean([column(ratio, seed=seed, **changes).summary["front"] for seed in range(seeds)]))


@pytest.mark.slow
def test_columns_run_farther_the_more_water_bears() -> None:
    dry, *fronts = [front(ratio) for ratio in (None, 0.2, 0.5, 0.8, 1.0)]
    assert fronts == sorted(fronts)
    assert fronts[0] == pytest.approx(dry, rel=0.1)
    assert fronts[-1] > 1.7 * dry
    assert front(0.5, cell=0.02) == pytest.approx(fronts[1], rel=0.08)
    assert front(0.5, step_fraction=0.2) == pytest.approx(fronts[1], rel=0.08)


@pytest.mark.parametrize("bed", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_wet_scene_in_parts_is_the_same_on_one_and_two_threads(bed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {"young": 2.0e6, "duration": 0.06, "material": {"consolidation": 1.0e-3}}
    given |= {} if bed else {"solids": ()}
    whole = column(0.5, threads=1, **given)
    monkeypatch.setattr("mpm.runtime.PARTICLES_PER_WORKER", 100)
    monkeypatch.setattr("mpm.simulation.LARGE", 0)
    one, two = (column(0.5, threads=threads, **given) for threads in (1, 2))
    for shared in (one, two):
        np.testing.assert_allclose(shared.positions, whole.positions, atol=1e-4)
        # Where single pores open and close hangs on the last digits; not what all of them bear.
        assert np.abs(shared.pore_pressure - whole.pore_pressure).mean() < 0.005 * whole.pore_pressure.max()
    np.testing.assert_array_equal(one.positions, two.positions)
    np.testing.assert_array_equal(one.pore_pressure, two.pore_pressure)


@pytest.mark.slow
def test_dense_columns_suck_and_loose_ones_liquefy() -> None:
    def psi(degrees: float) -> dict[str, Any]:
        return {"material": {"dilation_deg": degrees, "softening_length": 0.02 if degrees else None}}

    flows = [column(0.3, **psi(degrees)) for degrees in (-5.0, 0.0, 1.0, 10.0)]
    fronts = [flow.summary["front"] for flow in flows]
    assert fronts == sorted(fronts, reverse=True)
    assert fronts[-1] < 1.1 * 0.2
    assert fronts[0] > 1.4 * fronts[1]
    for flow in flows:
        energy = flow.summary["energy"]
        total = np.sum([energy[part] for part in ("kinetic", "potential", "elastic")], axis=0)
        assert np.diff(total).max() < 0.01 * total[0]


def test_a_water_table_counts_from_the_origin_of_a_map() -> None:
    table = json.loads(layer(None, water=Water(level=0.2)).to_json())
    table["domain"]["origin"] = [2600000.0, 1200.0]
    table["masses"][0]["lower"] = [2600000.0, 1200.0]
    table["water"]["level"] = 1200.2
    assert scene_from(table, Path()).water.level == 0.2


def test_reports_say_whether_water_drains() -> None:
    assert drainage(layer(None), 1.0).startswith("undrained")
    kinds = [drainage(layer(None, c_v=c_v), 1.0).split(":")[0] for c_v in (1.0e-4, 0.1, 10.0)]
    assert kinds == ["undrained", "partly drained", "drained"]
    assert drainage(scene_of(), 1.0) == ""
    assert "stays" in drainage(layer(None, water=Water(fixed=True)), 1.0)


def test_scenes_that_water_cannot_be_in_are_refused() -> None:
    body = Mass(lower=(0.0, 0.0), size=(0.2, 0.4))
    assert refused(simulate, scene_of(body, material=WET)).key == "masses[0].k0"
    assert refused(layer, None, volume_correction=False).key == "volume_correction"
    for values in ({"dilation_deg": 5.0}, {"dilation_deg": -31.0, "softening_length": 0.1}):
        assert refused(dataclasses.replace, WET, **values).key == "material.dilation_deg"
    assert refused(scene_of, water=Water(level=0.1)).key == "water"
    ratio = dataclasses.replace(body, initial_pore_pressure_ratio=0.5)
    assert refused(scene_of, ratio).key == "masses[0].initial_pore_pressure_ratio"
    wet = dataclasses.replace(WET, friction_deg=29.0)
    assert refused(scene_of, dataclasses.replace(body, k0=0.5, material=wet), ratio, material=WET).key == "masses"
    assert refused(Material, friction_deg=30.0, saturated=True, permeability=1.0e-4).key == "material.permeability"
    assert refused(Material, friction_deg=30.0, consolidation=1.0e-4).key == "material.consolidation"


def test_what_knows_no_water_says_so() -> None:
    scene = layer(None)
    assert refused(check, scene, ModelSettings(dimension=2)).key == "material.saturated"
    assert refused(features_of, [scene], "f32", gpu=True).key == "material.saturated"
    assert refused(known_to_adjoint, features_of([scene], "f32")).key == "material.saturated"


def test_an_inversion_sets_the_water() -> None:
    scene = layer(0.5, c_v=0.01)
    ratio = dataclasses.replace(KINDS["masses[].initial_pore_pressure_ratio"], index=0)
    assert ratio.read(scene) == 0.5
    KINDS["consolidation"].check(scene)
    refused(KINDS["permeability"].check, scene, said="it states a consolidation: make that the unknown")
    soil = dataclasses.replace(WET, permeability=1.0e-4, young=2.0e6)
    measured = dataclasses.replace(scene, material=soil)
    refused(KINDS["consolidation"].check, measured, said="it states a permeability: make that the unknown")
    refused(KINDS["permeability"].check, layer(0.5), said="its water does not flow")
