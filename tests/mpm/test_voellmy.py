"""Voellmy's law of the bed: blocks on inclines against the closed form, sheets of sand, and what is refused."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from datasets import Baffle, Mass, Material, Scene, Solid
from mpm import WITH_FIELDS, simulate
from mpm.arrays.features import features_of
from tests.refusals import refused
from tests.scenes import scene_of
from validation.bench.stability.exact_solutions import SlidingBlock, centre_displacement

STRONG = Material(friction_deg=30.0, cohesion=1.0e9, tension_cutoff=1.0e9, young=1.0e7, poisson=0.0, density=1800.0)
SLOPE_DEG, FRICTION, TURBULENCE, THICKNESS, CELL = 30.0, 0.2, 20.0, 0.1, 0.02
BED: dict[str, Any] = {"friction": FRICTION, "turbulence": TURBULENCE}
STEEP = math.radians(SLOPE_DEG)
ALONG, ACROSS = np.array([math.cos(STEEP), -math.sin(STEEP)]), np.array([math.sin(STEEP), math.cos(STEEP)])


class VoellmyBlock:
    """A rigid block on an incline with the bed law of Voellmy, let go at rest: dv/dt = a (1 - v^2 / v_inf^2).

    a = g (sin theta - mu cos theta) > 0, v_inf^2 = xi h (sin theta - mu cos theta), h normal to the bed."""

    def __init__(self, slope_deg: float, thickness: float = THICKNESS) -> None:
        self.acceleration = SlidingBlock.on_incline(slope_deg, FRICTION).acceleration
        self.terminal_speed = math.sqrt(TURBULENCE * thickness * self.acceleration / 9.81)

    def speed(self, time: ArrayLike) -> np.ndarray[Any, Any]:
        """[m/s] after `time` [s]."""
        return np.asarray(self.terminal_speed * np.tanh(self.acceleration * np.asarray(time) / self.terminal_speed))

    def displacement(self, time: ArrayLike) -> np.ndarray[Any, Any]:
        """[m] after `time` [s]."""
        scaled = self.acceleration * np.asarray(time) / self.terminal_speed
        return np.asarray(self.terminal_speed**2 / self.acceleration * np.log(np.cosh(scaled)))


def tilted(
    kind: type[Baffle | Solid], offset: float, cells: float = 5.0, width: tuple[float, ...] = (), **changes: Any
) -> Scene:
    """A block so many cells thick on a bed that ends `offset` cells above a row of nodes, in a tilted box."""
    top, across = (4.0 + offset) * CELL, (0.0,) * len(width)
    bed = kind(lower=(0.0, 0.0, *across), size=(1.2, top, *width), **BED)
    body = Mass(lower=(0.1, top, *across), size=(0.4, cells * CELL, *width))
    stands = {"baffles": (bed,)} if kind is Baffle else {"solids": (bed,)}
    settings = {"size": (1.2, 0.4, *width), "slope_deg": SLOPE_DEG, "duration": 0.8, "frame_dt": 0.02} | changes
    return scene_of(body, material=STRONG, jitter=0.0, **settings, **stands)


LENGTH = 1.4


def height(x: float) -> float:
    """Of an incline that ends at LENGTH [m]."""
    return 0.05 + (LENGTH - x) * math.tan(STEEP)


def on_polyline(seed: int) -> Scene:
    """A block on an incline of a level box, which cuts the grid."""
    foot, up, end = np.array([0.15, height(0.15)]), THICKNESS * ACROSS, 0.4 * ALONG
    corners = tuple(tuple(corner.tolist()) for corner in (foot, foot + end, foot + end + up, foot + up))
    line = ((0.0, height(0.0)), (LENGTH, height(LENGTH)))
    settings = {"size": (LENGTH, 1.02), "particles_per_axis": 3, "seed": seed, "duration": 0.8, "frame_dt": 0.02}
    bed = Solid(kind="terrain", points=line, **BED)
    return scene_of(Mass(kind="polygon", vertices=corners), material=STRONG, solids=(bed,), **settings)


def on_raster() -> Scene:
    """A block on an incline by a raster, on cells of 4 cm."""
    rows = tuple((height(x),) * 2 for x in np.linspace(0.0, LENGTH, 8).tolist())
    bed = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(0.2, 0.24), heights=rows, **BED)
    outline = ((0.1, 0.0), (0.46, 0.0), (0.46, 0.24), (0.1, 0.24))
    body = Mass(kind="layer", thickness=THICKNESS / math.cos(STEEP), outline=outline)
    settings = {"size": (LENGTH, 1.04, 0.24), "cell": 0.04, "particles_per_axis": 3, "frame_dt": 0.02}
    return scene_of(body, material=STRONG, solids=(bed,), duration=0.8, **settings)


@pytest.mark.parametrize(
    ("scene", "share"),
    [
        (tilted(Solid, 0.0), 0.002),
        (tilted(Baffle, 0.3), 0.002),
        *((on_polyline(seed), 0.01) for seed in (0, 1)),
        pytest.param(on_raster(), 0.02, marks=pytest.mark.slow),
    ],
)
def test_a_block_reaches_the_terminal_speed(scene: Scene, share: float) -> None:
    """v = v_inf tanh(a t / v_inf), in a tilted box within 0.2 %: there rows stand where the sum of delta is exact."""
    # With fields as below: of one kernel.
    flow, exact = simulate(scene, record=WITH_FIELDS), VoellmyBlock(SLOPE_DEG)
    along = np.array([1.0, 0.0]) if scene.slope_deg else ALONG
    moved = centre_displacement(flow)[:, :2] @ along
    assert moved[-1] == pytest.approx(float(exact.displacement(flow.time[-1])), rel=share)
    speeds = np.gradient(moved, flow.time)[1:-1]
    assert np.abs(speeds - exact.speed(flow.time[1:-1])).max() < share * exact.terminal_speed
    assert exact.speed(flow.time[-1]) > 0.99 * exact.terminal_speed


@pytest.mark.filterwarnings("ignore:.*hardly resolves it")
@pytest.mark.parametrize(
    ("cells", "offset", "width"),
    [
        *((cells, offset, ()) for cells in (0.25, 0.375, 0.75, 1.5, 3.0) for offset in (0.0, 0.4)),
        (0.375, 0.3, (4 * CELL,)),
    ],
)
def test_thin_layers_feel_all_of_the_drag(cells: float, offset: float, width: tuple[float, ...]) -> None:
    """v = v_inf tanh(a t / v_inf) with v_inf^2 = xi h (sin - mu cos), within 3 % from the start on.

    On a bed that ends `offset` cells above a row of nodes; in 3D between walls of the box, four cells apart."""
    exact = VoellmyBlock(SLOPE_DEG, cells * CELL)
    duration = 0.02 * math.ceil(3.0 * exact.terminal_speed / exact.acceleration / 0.02)
    # In 3D without gaps, which a strong block has not.
    changes = {"duration": duration, "volume_correction": False if width else None}
    flow = simulate(tilted(Solid, offset, cells, width, **changes), record=WITH_FIELDS)
    speeds = flow.velocities[:, :, 0].mean(axis=1)
    assert np.abs(speeds - exact.speed(flow.time)).max() < 0.03 * exact.terminal_speed
    assert exact.speed(flow.time[-1]) > 0.99 * exact.terminal_speed


@pytest.mark.filterwarnings("ignore:.*(hardly resolves it|is negligible compared)")
@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_a_row_of_sand_that_has_sunk_to_the_bed_feels_the_drag_of_its_thickness(offset: float) -> None:
    """It spreads a little, too. By its distance from the bed alone the speed would be 0.63 of the block's."""
    top, exact = (4.0 + offset) * CELL, VoellmyBlock(SLOPE_DEG, 0.25 * CELL)
    bed = Solid(lower=(0.0, 0.0), size=(1.6, top), **BED)
    body = Mass(lower=(0.1, top), size=(0.6, 0.25 * CELL))
    settings: dict[str, Any] = {"size": (1.6, 0.2), "slope_deg": SLOPE_DEG, "duration": 4.0, "frame_dt": 0.1}
    # As good as without cohesion, and so by the kernel of the blocks.
    sand = Material(friction_deg=38.0, cohesion=0.01, young=2.0e6)
    flow = simulate(scene_of(body, material=sand, solids=(bed,), **settings), record=WITH_FIELDS)
    middle = (flow.positions[0, :, 0] > 0.25) & (flow.positions[0, :, 0] < 0.55)
    assert np.median(flow.positions[-1, middle, 1]) < top + 0.05 * CELL
    assert 0.82 < flow.velocities[-1, middle, 0].mean() / exact.terminal_speed < 1.05


@pytest.mark.slow
@pytest.mark.parametrize(("bump", "share"), [(0.0, 0.02), (0.1, 0.02), (0.5, 0.1)])
def test_the_middle_of_a_sheet_of_sand_has_the_speed_of_the_block(bump: float, share: float) -> None:
    """On a plane and on kinks `bump` cells high, five cells apart, over which it bounces."""
    length, slope_deg, cell = 4.0, 25.0, 0.02
    steep = math.radians(slope_deg)
    places = np.linspace(0.0, length, 41)
    heights = 0.05 + (length - places) * math.tan(steep) + bump * cell * (np.arange(41) % 2)
    bed = Solid(kind="terrain", points=tuple(zip(places.tolist(), heights.tolist(), strict=True)), **BED)
    body = Mass(kind="layer", thickness=THICKNESS / math.cos(steep), outline=((0.2,), (2.2,)))
    sand = Material(friction_deg=38.0, young=2.0e6)
    settings = {"size": (length, 2.24), "cell": cell, "duration": 1.0, "frame_dt": 0.02}
    flow = simulate(scene_of(body, material=sand, solids=(bed,), **settings), record=WITH_FIELDS)
    middle = (flow.positions[0, :, 0] > 0.7) & (flow.positions[0, :, 0] < 1.7)
    speed = flow.velocities[-1, middle] @ np.array([math.cos(steep), -math.sin(steep)])
    exact = VoellmyBlock(slope_deg)
    assert speed.mean() == pytest.approx(float(exact.speed(flow.time[-1])), rel=share)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:solids.*stops nearly any flow")
def test_blocks_on_a_bed_whose_turbulence_varies_have_the_speeds_of_their_places() -> None:
    """Side by side on xi of 10 and 40 m/s^2 by columns of a raster; of one value it is the number."""
    low, high = 10.0, 40.0
    columns = (low, low, low, high, high, high)

    def scene(turbulence: float | tuple[tuple[float, ...], ...]) -> Scene:
        ground: dict[str, Any] = {"origin": (0.0, 0.0), "spacing": (1.2, 0.08), "heights": ((0.088,) * 6,) * 2}
        bed = Solid(kind="terrain", friction=FRICTION, turbulence=turbulence, **ground)
        bodies = [Mass(lower=(0.1, 0.088, z), size=(0.2, 0.04, 0.08)) for z in (0.04, 0.28)]
        settings: dict[str, Any] = {"size": (1.2, 0.2, 0.4), "slope_deg": SLOPE_DEG, "duration": 0.6, "frame_dt": 0.1}
        return scene_of(*bodies, material=STRONG, solids=(bed,), **settings)

    flow = simulate(scene((columns,) * 2), record=WITH_FIELDS)
    first = flow.positions[0, :, 2] < 0.2
    scale = VoellmyBlock(SLOPE_DEG, 0.04).terminal_speed / math.sqrt(TURBULENCE)
    for mine, xi in ((first, low), (~first, high)):
        exact = math.sqrt(xi) * scale
        reached = exact * math.tanh(VoellmyBlock(SLOPE_DEG).acceleration * 0.6 / exact)
        assert flow.velocities[-1, mine, 0].mean() == pytest.approx(reached, rel=0.03)
    even = [simulate(scene(xi)) for xi in (20.0, ((20.0,) * 6,) * 2)]
    np.testing.assert_allclose(even[1].positions[-1], even[0].positions[-1], atol=1e-6)


def test_scenes_without_turbulence_pay_for_none() -> None:
    scene = tilted(Solid, 0.0)
    plain = dataclasses.replace(scene, solids=(dataclasses.replace(scene.solids[0], turbulence=None),))
    assert features_of([scene], "f32").turbulent
    assert not features_of([plain], "f32").turbulent
    assert features_of([plain], "f32").scratch.size == features_of([scene], "f32").scratch.size - 3


def test_what_turbulence_does_not_go_with_is_refused() -> None:
    scene = tilted(Solid, 0.0)
    (bed,) = scene.solids
    stuck = dataclasses.replace(bed, contact="no-slip")
    refused(dataclasses.replace, scene, solids=(stuck,), said="solids[0].turbulence: expected none of a surface on")
    rough = (Baffle(lower=(0.0, 0.0), size=(0.1, 0.1), friction="rough", turbulence=9.0),)
    refused(dataclasses.replace, scene, solids=(), baffles=rough, said="baffles[0].turbulence: expected none of a")
    refused(dataclasses.replace, bed, turbulence=0.0, said="turbulence: expected positive coefficients in m/s^2")
    rows = (dataclasses.replace(bed, turbulence=((9.0, 9.0), (9.0, 9.0))),)
    refused(dataclasses.replace, scene, solids=rows, said="solids[0].turbulence: expected a single number of a box")
