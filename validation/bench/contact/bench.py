"""`python -m validation.bench contact`: layers at rest, sliding, leaks, a flume, a baffle that is moved."""

import math
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.nearest import nearest
from datasets.geometry.surface import surface_of
from datasets.measures import front, toe
from datasets.trajectory import Trajectory
from mpm import LAST, WITH_FIELDS, simulate, simulate_many
from validation.bench.contact.flume import SCENE, draw, run_flume
from validation.bench.contact.scenes import (
    CELL,
    DEPTH,
    GRAVITY,
    SAND,
    SLOPE_DEG,
    WIDTH,
    against_baffle,
    baffles_shifted,
    block,
    block_acceleration,
    layer,
    level,
    on_incline,
    on_touching_baffles,
    retained_bed,
    thrown_at_plate,
)
from validation.report.page import Page, percent

OFFSETS = tuple(float(each) for each in np.arange(0.0, 1.0, 0.1).round(1))
"""Of a face from a node [cells]."""
PLATES = ((1.0, 50.0), (0.5, 50.0), (0.2, 20.0), (0.05, 5.0))
"""Thickness [cells] and speed [m/s] of throws at plates."""
SHIFTS = (2.0e-2, 2.0e-3, 2.0e-4, 2.0e-5)
"""Differences of a baffle's position [m]."""
POSITIONS = tuple(float(each) for each in np.arange(0.0, 2.01, 0.1).round(1))
"""Of a baffle in a flow [cells]."""
SEEDS = 4
BULK = 0.95
"""Share of the sand whose extent down an incline is compared besides the front, which single particles make."""


@dataclass(frozen=True, kw_only=True)
class LayerError:
    """How far layers that should rest are from doing so: of each kind of error that of the largest amount."""

    surface: str
    height: float
    """Change of the mean height beyond the elastic settlement [cells]."""
    gain: float
    """Energy gained over the potential energy [-]."""
    force: float
    """Force on the surface over the weight, less 1 [-]."""


def layer_error(kind: str, dimension: int, offsets: tuple[float, ...], duration: float) -> LayerError:
    """Of layers at these offsets [cells]; means over the second half of the duration [s]."""
    nu, area = SAND.poisson, WIDTH[dimension] ** (dimension - 1)
    weight = SAND.density * GRAVITY * DEPTH * area
    modulus = SAND.young * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    settlement = SAND.density * GRAVITY * DEPTH**2 / (3.0 * modulus)
    heights, gains, forces = [], [], []
    for offset in offsets:
        flow = simulate(layer(offset, kind=kind, dimension=dimension, duration=duration), record=WITH_FIELDS)
        half = len(flow.time) // 2
        mean = flow.positions[:, :, 1].mean(axis=1, dtype=float)
        heights.append(float(mean[half:].mean() - mean[0] + settlement) / CELL)
        energy = np.sum([flow.summary["energy"][key] for key in ("kinetic", "potential", "elastic")], axis=0)
        gains.append(float(energy.max() - energy[0]) / (0.5 * weight * DEPTH))
        impulse = np.array(flow.summary["side_impulse"]["y-"])
        if flow.solid_impulse is not None:
            impulse = flow.solid_impulse[:, 0]
        mean_force = (impulse[half, 1] - impulse[-1, 1]) / (flow.time[-1] - flow.time[half])
        forces.append(float(mean_force / weight) - 1.0)
    return LayerError(
        surface=f"{kind}, {dimension}D", height=max(heights, key=abs), gain=max(gains), force=max(forces, key=abs)
    )


def acceleration(slope_deg: float, offset: float) -> float:
    """Of a sliding block, from the slope of its speed over its later half [m/s^2]."""
    with warnings.catch_warnings():
        # The block slides from the start: what it starts from is no equilibrium.
        warnings.simplefilter("ignore", UserWarning)
        flow = simulate(block(slope_deg, offset))
    speed = np.gradient(flow.positions[:, :, 0].mean(axis=1, dtype=float), flow.time)
    late = flow.time > 0.5 * flow.time[-1]
    return float(np.polyfit(flow.time[late], speed[late], 1)[0])


def incline_extents(cell: float, seeds: int) -> NDArray[np.float64]:
    """Front and BULK quantile along the incline [m], means over jitters, shape [2, 2].

    Columns: down the floor of a tilted box, down a polyline in a level one.
    """
    theta = math.radians(SLOPE_DEG)
    downhill = np.array([math.cos(theta), -math.sin(theta)])
    found = []
    for seed in range(seeds):
        tilted, slope = (simulate(scene, record=LAST).positions[-1].astype(float) for scene in on_incline(cell, seed))
        along = (tilted[:, 0], (slope - np.array(level(0.0, 0.0))) @ downhill)
        found.append([[front(x[:, None]) for x in along], [np.quantile(x, BULK) for x in along]])
    return np.asarray(np.mean(found, axis=0))


def particles_inside(flow: Trajectory) -> int:
    """Particles in a solid, deeper than rounding, summed over every fifth frame."""
    surface = surface_of(flow.scene)
    assert surface is not None
    return sum(int((nearest(surface, x.astype(float)).distance < -1.0e-5 * CELL).sum()) for x in flow.positions[::5])


def particles_beyond(flow: Trajectory) -> int:
    """Particles beyond the plate at the end."""
    plate = flow.scene.baffles[0]
    return int((flow.positions[-1, :, 0] > plate.lower[0] + 0.5 * plate.size[0]).sum())


def toe_slopes(shifts: tuple[float, ...]) -> list[float]:
    """d toe_x / dz of the first baffle of `baffles-2` by central differences of `shifts` [m]."""
    scenes = [baffles_shifted(sign * shift / 2.0) for shift in shifts for sign in (-1.0, 1.0)]
    toes = [float(toe(flow.positions[-1])[0]) for flow in simulate_many(scenes, record=LAST)]
    return [(above - below) / shift for shift, below, above in zip(shifts, toes[::2], toes[1::2], strict=True)]


def roughness(positions: tuple[float, ...], seeds: int) -> tuple[float, float]:
    """rms distance of a deposit's centre from a parabola over the baffle's position, and its standard error [mm]."""
    scenes = [against_baffle(position, seed) for position in positions for seed in range(seeds)]
    flows = simulate_many(scenes, record=LAST)
    centres: NDArray[np.float64] = 1000.0 * np.array([flow.positions[-1, :, 0].mean(dtype=float) for flow in flows])
    centres = centres.reshape(len(positions), seeds)
    mean = centres.mean(axis=1)
    residual = mean - np.polyval(np.polyfit(positions, mean, 2), positions)
    return float(np.sqrt(np.mean(residual**2))), float(centres.std(axis=1, ddof=1).mean() / math.sqrt(seeds))


def thrust(offset: float) -> float:
    """Force of a bed on a smooth baffle, mean of the last 0.3 s [N/m]."""
    impulse = simulate(retained_bed(offset)).solid_impulse
    assert impulse is not None
    return float((impulse[-1, 0, 0] - impulse[-31, 0, 0]) / 0.3)


def bench(out: Path, *, quick: bool, keep: Path) -> str:
    """Measure contact with solids: contact.md. quick: fewer offsets, shorter. keep: not used, the whole takes minutes.

    Raises WorkFailed where a simulation fails.
    """
    offsets = (0.3,) if quick else OFFSETS
    duration = 0.4 if quick else 5.0
    layers = [
        layer_error("floor", 2, (0.0,), duration),
        layer_error("baffle", 2, offsets, duration),
        layer_error("terrain", 2, offsets, duration),
        layer_error("baffle", 3, offsets if quick else (0.0, 0.3, 0.5, 0.8), duration),
    ]
    thrusts = [thrust(offset) for offset in (offsets if quick else (0.0, 0.25, 0.5, 0.75, 0.9))]
    sliding = [
        (angle, offset, acceleration(angle, offset), block_acceleration(angle))
        for angle in ((35.0,) if quick else (29.0, 33.0, 35.0))
        for offset in (0.0, 0.3, 0.8)[: len(offsets)]
    ]
    inclines = {cell: incline_extents(cell, 2 if quick else SEEDS) for cell in ((0.02,) if quick else (0.02, 0.01))}
    throws = [(thickness, speed, simulate(thrown_at_plate(thickness, speed))) for thickness, speed in PLATES]
    grounds = {rise: particles_inside(simulate(on_touching_baffles(rise))) for rise in (0.0, 0.3)}
    shifts = SHIFTS[1:2] if quick else SHIFTS
    slopes = toe_slopes(shifts)
    rough, scatter = roughness(POSITIONS[:: 5 if quick else 1], 2 if quick else SEEDS)
    flume = run_flume()

    off = max(abs(found / exact - 1.0) for *_, found, exact in sliding)
    fronts, bulk = (max(abs(each[k, 1] / each[k, 0] - 1.0) for each in inclines.values()) for k in range(2))
    leaks = sum(particles_beyond(flow) for *_, flow in throws) + sum(grounds.values())
    solids = layers[1:]
    page = Page(
        "Contact with solids",
        command="python -m validation.bench contact --out docs",
        conclusion=[
            f"**At rest**: layers on baffles and terrain at {len(offsets)} offsets from the nodes change their height"
            f" by {max(abs(each.height) for each in solids):.2g} cells at most, gain"
            f" {max(each.gain for each in solids):.1e} of their energy, and press with their weight within"
            f" {percent(max(abs(each.force) for each in solids))}.",
            f"**Sliding**: blocks accelerate within {percent(off)} of the closed form; down a polyline"
            f" {100.0 * BULK:g} % of the sand come as far as down the floor of a tilted box within {percent(bulk)},"
            f" the front within {percent(fronts)}.",
            f"**Leaks**: {leaks} particles passed a plate or entered a solid.",
            f"**Smooth**: the centre of a deposit follows a baffle's position within {rough:.2g} mm of a parabola"
            f" (cells of {1000 * CELL:g} mm; standard error over jitters {scatter:.2g} mm).",
            f"**Slope** of the toe of `baffles-2` over a baffle's position: {min(slopes):.2f} to {max(slopes):.2f} by"
            f" differences of {1000 * shifts[0]:g} to {1000 * shifts[-1]:g} mm.",
        ],
        quick=quick,
    )
    page.text("The contact law: `mpm/physics/contact.py`.")
    page.section("Layers at rest")
    page.text(f"""
        {DEPTH:g} m deep, undamped, {duration:g} s, E = {SAND.young:g} Pa; the largest error over the offsets of the
        face from the nodes; height beyond the elastic settlement, force over the second half.
    """)
    page.table(
        [(each.surface, each.height, each.gain, each.force) for each in layers],
        formats={"on": "", "height [cells]": "+.4f", "energy gained": ".1e", "force / weight - 1": "+.2%"},
    )
    page.text(f"""
        A bed 0.3 m deep against a smooth baffle, by the offset of its face, thrust [N/m]:
        {", ".join(f"{each:.0f}" for each in thrusts)}; nu / (1 - nu) of the weight is
        {0.5 * 0.3 / 0.7 * 1800.0 * GRAVITY * 0.09:.0f}.
    """)
    page.section("Sliding")
    page.table(
        sliding,
        formats={"slope [°]": "g", "offset [cells]": "g", "acceleration [m/s²]": ".4f", "g (sin θ - μ cos θ)": ".4f"},
    )
    share = f"{100.0 * BULK:g} % of the sand"
    page.table(
        [(cell, *extents.flat) for cell, extents in inclines.items()],
        formats={
            "cell [m]": "g",
            "front, tilted box [m]": ".3f",
            "front, polyline [m]": ".3f",
            f"{share}, tilted box [m]": ".3f",
            f"{share}, polyline [m]": ".3f",
        },
    )
    page.section("Leaks")
    page.table(
        [(thickness, speed, particles_beyond(flow), flow.positions.shape[1]) for thickness, speed, flow in throws],
        formats={"plate [cells]": "g", "thrown at [m/s]": "g", "particles beyond it": "", "of": ""},
    )
    page.table(list(grounds.items()), formats={"touching baffles in steps of [cells]": "g", "particles inside": ""})
    page.section("A flume of 35°")
    page.text(f"""
        `{SCENE}`: sand is released on a slope of 35°, runs out on a level floor and hits a wall. Its front comes to
        {flume.front:.3f} m; the largest force on the wall is {flume.peak[0]:.0f} N/m, at {flume.peak[1]:.2f} s;
        momentum balances within {flume.balance:.1e} of the weight times the time (double precision).
    """)
    draw(out / "contact-flume.png", flume)
    page.picture("contact-flume.png", "the flume")
    page.section("Position of a baffle")
    page.table(
        [(1000.0 * shift, slope) for shift, slope in zip(shifts, slopes, strict=True)],
        formats={"difference [mm]": "g", "d toe / dz of `baffles-2`": ".2f"},
    )
    return page.write(out / "contact.md")
