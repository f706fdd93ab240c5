"""`python -m validation.bench contact`: what solids bear, what passes them, how smoothly a flow follows their place."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.files import write_text
from datasets.geometry.nearest import nearest
from datasets.geometry.surface import surface_of
from datasets.measures import front, toe
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.report.markdown import table
from mpm import LAST, WITH_FIELDS, simulate, simulate_each
from validation.bench.contact.cases import (
    CELL,
    DEPTH,
    GRAVITY,
    SAND,
    SLOPE_DEG,
    WIDTH,
    block,
    block_acceleration,
    joints,
    layer,
    level,
    moved,
    on_incline,
    retained,
    shifted,
    thrown,
)
from validation.bench.contact.flume import draw, run_flume
from validation.report.machine import machine

OFFSETS = tuple(float(each) for each in np.arange(0.0, 1.0, 0.1).round(1))
"""Where a face lies between two nodes [cells]."""
PLATES = ((1.0, 50.0), (0.5, 50.0), (0.2, 20.0), (0.05, 5.0))
"""Thickness [cells] and speed [m/s] of throws at plates."""
SHIFTS = (2.0e-2, 2.0e-3, 2.0e-4, 2.0e-5)
"""Differences of the place of a baffle [m]."""
PLACES = tuple(float(each) for each in np.arange(0.0, 2.01, 0.1).round(1))
"""Places of a baffle in a flow [cells]."""
SEEDS = 4
BULK = 0.95
"""Share of the sand whose extent down an incline is compared besides the front, which single particles make."""


@dataclass(frozen=True, kw_only=True)
class Rest:
    """A layer that ought to rest."""

    name: str
    height: float
    """Change of its mean height beyond the elastic settlement, the largest by its amount over all offsets [cells]."""
    gain: float
    """Largest energy gained over its potential energy [-]."""
    force: float
    """Force on the surface over the weight, less 1, the largest by its amount [-]."""


def rest(kind: str, dimension: int, offsets: tuple[float, ...], duration: float) -> Rest:
    """The worst of layers at several offsets; means over the second half of the time."""
    scenes = [layer(offset, kind=kind, dimension=dimension, duration=duration) for offset in offsets]
    nu, area = SAND.poisson, WIDTH[dimension] ** (dimension - 1)
    weight = SAND.density * GRAVITY * DEPTH * area
    modulus = SAND.young * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    settlement = SAND.density * GRAVITY * DEPTH**2 / (3.0 * modulus)
    heights, gains, forces = [], [], []
    for scene in scenes:
        flow = simulate(scene, record=WITH_FIELDS)
        half = len(flow.time) // 2
        mean = flow.positions[:, :, 1].mean(axis=1, dtype=float)
        heights.append((mean[half:].mean() - mean[0] + settlement) / CELL)
        series = np.sum([flow.summary["energy"][key] for key in ("kinetic", "potential", "elastic")], axis=0)
        gains.append((series.max() - series[0]) / (0.5 * weight * DEPTH))
        taken = np.array(flow.summary["side_impulse"]["y-"])
        if flow.solid_impulse is not None:
            taken = flow.solid_impulse[:, 0]
        forces.append((taken[half, 1] - taken[-1, 1]) / (flow.time[-1] - flow.time[half]) / weight - 1.0)
    return Rest(name=f"{kind}, {dimension}D", height=largest(heights), gain=float(max(gains)), force=largest(forces))


def largest(values: list[float]) -> float:
    """That of the largest amount."""
    return float(max(values, key=abs))


def acceleration(slope_deg: float, offset: float) -> float:
    """Of a block that slides, from the slope of its speed over its later half [m/s^2]."""
    flow = simulate(block(slope_deg, offset))
    speed = np.gradient(flow.positions[:, :, 0].mean(axis=1, dtype=float), flow.time)
    late = flow.time > 0.5 * flow.time[-1]
    return float(np.polyfit(flow.time[late], speed[late], 1)[0])


def incline_extents(cell: float, seeds: int) -> NDArray[np.float64]:
    """Along the incline the front and what BULK of the sand are behind, means over jitter seeds [m], shape [2, 2]:

    of each down the floor of a tilted box, then down a polyline.
    """
    theta = math.radians(SLOPE_DEG)
    downhill = np.array([math.cos(theta), -math.sin(theta)])
    found = []
    for seed in range(seeds):
        tilted, slope = (simulate(scene, record=LAST).positions[-1].astype(float) for scene in on_incline(cell, seed))
        lines = (tilted[:, 0], (slope - np.array(level(0.0, 0.0))) @ downhill)
        found.append([[front(line[:, None]) for line in lines], [np.quantile(line, BULK) for line in lines]])
    return np.asarray(np.mean(found, axis=0))


def inside(flow: Trajectory) -> int:
    """Particles in a solid, deeper than rounding, summed over the frames."""
    surface = surface_of(flow.scene)
    assert surface is not None
    return sum(
        int((nearest(surface, each.astype(float)).distance < -1.0e-5 * CELL).sum()) for each in flow.positions[::5]
    )


def passed(flow: Trajectory) -> int:
    """Particles beyond the plate at the end."""
    plate = flow.scene.baffles[0]
    return int((flow.positions[-1, :, 0] > plate.lower[0] + 0.5 * plate.size[0]).sum())


def finals(scenes: list[Scene]) -> list[Trajectory]:
    """Deposits of scenes. Raises WorkFailed where one blew up."""
    flows = simulate_each(scenes, record=LAST)
    for flow in flows:
        if not isinstance(flow, Trajectory):
            raise flow
    return [flow for flow in flows if isinstance(flow, Trajectory)]


def slopes_of_toe(shifts: tuple[float, ...]) -> list[float]:
    """d toe_x / dz of the first baffle of `baffles-2` by central differences of `shifts` [m]."""
    flows = finals([shifted(sign * shift / 2.0) for shift in shifts for sign in (-1.0, 1.0)])
    toes = [float(toe(flow.positions[-1])[0]) for flow in flows]
    return [(toes[2 * k + 1] - toes[2 * k]) / shift for k, shift in enumerate(shifts)]


def followed(places: tuple[float, ...], seeds: int) -> tuple[float, float]:
    """rms distance of a deposit's centre from a smooth (quadratic) curve over the baffle's place, and scatter [mm]."""
    flows = finals([moved(place, seed) for place in places for seed in range(seeds)])
    centres: NDArray[np.float64] = 1000.0 * np.array([flow.positions[-1, :, 0].mean(dtype=float) for flow in flows])
    centres = centres.reshape(len(places), seeds)
    mean = centres.mean(axis=1)
    rough = mean - np.polyval(np.polyfit(places, mean, 2), places)
    scatter = centres.std(axis=1, ddof=1).mean() / math.sqrt(seeds)
    return float(np.sqrt(np.mean(rough**2))), float(scatter)


def thrusts(offsets: tuple[float, ...]) -> list[float]:
    """Force of a bed on a smooth baffle over the last 0.3 s [N/m]."""
    found = []
    for scene in map(retained, offsets):
        impulse = simulate(scene).solid_impulse
        assert impulse is not None
        found.append(float((impulse[-1, 0, 0] - impulse[-31, 0, 0]) / 0.3))
    return found


def bench(out: Path | None, *, quick: bool = False, keep: Path | None = None) -> str:
    """Measure contact, and return the tables; with `out`, contact.md there. quick: fewer offsets, shorter.

    keep: nothing is kept; the whole takes minutes.
    """
    offsets = (0.3,) if quick else OFFSETS
    duration = 0.4 if quick else 5.0
    rests = [
        rest("floor", 2, (0.0,), duration),
        rest("baffle", 2, offsets, duration),
        rest("terrain", 2, offsets, duration),
        rest("baffle", 3, offsets if quick else (0.0, 0.3, 0.5, 0.8), duration),
    ]
    angles = (35.0,) if quick else (29.0, 33.0, 35.0)
    blocks = [
        (angle, offset, acceleration(angle, offset)) for angle in angles for offset in (0.0, 0.3, 0.8)[: len(offsets)]
    ]
    cells = (0.02,) if quick else (0.02, 0.01)
    inclines = [(cell, incline_extents(cell, 2 if quick else SEEDS)) for cell in cells]
    throws = [(thickness, speed, simulate(thrown(thickness, speed))) for thickness, speed in PLATES]
    grounds = [(rise, inside(simulate(joints(rise)))) for rise in (0.0, 0.3)]
    shifts = SHIFTS[1:2] if quick else SHIFTS
    slopes = slopes_of_toe(shifts)
    rough, scatter = followed(PLACES[:: 7 if quick else 1], 2 if quick else SEEDS)
    sides = thrusts(offsets if quick else (0.0, 0.25, 0.5, 0.75, 0.9))

    flume = run_flume()

    solids = rests[1:]
    off = max(abs(found / block_acceleration(angle) - 1.0) for angle, _, found in blocks)
    fronts, bulk = (max(abs(each[k, 1] / each[k, 0] - 1.0) for _, each in inclines) for k in range(2))
    heaviest = 100.0 * max(abs(each.force) for each in solids)
    through = sum(passed(flow) for _, _, flow in throws) + sum(count for _, count in grounds)
    conclusion = [
        f"- **At rest**: layers on baffles and terrain anywhere between the nodes change their height by"
        f" {max(abs(each.height) for each in solids):.2g} cells at most, gain"
        f" {max(each.gain for each in solids):.1e} of their energy, and weigh within {heaviest:.2g} % of their weight.",
        f"- **Sliding**: blocks accelerate within {100.0 * off:.2g} % of the closed form; down a polyline"
        f" {100.0 * BULK:g} % of the sand come as far as down the floor of a tilted box within"
        f" {100.0 * bulk:.2g} %, the front within {100.0 * fronts:.2g} %.",
        f"- **Leaks**: {through} particles of all passed a plate or got into a solid.",
        f"- **Smooth**: the centre of a deposit follows a baffle's place within {rough:.2g} mm of a smooth curve"
        f" (cells of {1000 * CELL:g} mm; jitter scatters it by {scatter:.2g} mm).",
        f"- **Slope** of the toe of `baffles-2` over a baffle's place: {min(slopes):.2f} to {max(slopes):.2f} by"
        f" differences of {1000 * shifts[0]:g} to {1000 * shifts[-1]:g} mm.",
    ]
    tables = [
        "## Layers at rest",
        "",
        f"0.2 m deep, undamped, {duration:g} s; over {len(offsets)} offsets of the face between the nodes the worst; E"
        f" {SAND.young:g} Pa; height beyond the elastic settlement, force over the second half.",
        "",
        *table(
            ("on", "height [cells]", "energy gained", "force / weight - 1"),
            [(each.name, f"{each.height:+.4f}", f"{each.gain:.1e}", f"{100 * each.force:+.2f} %") for each in rests],
        ),
        "",
        "A bed 0.3 m deep against a smooth baffle, by the offset of its face, thrust [N/m]: "
        + ", ".join(f"{each:.0f}" for each in sides)
        + f"; nu / (1 - nu) of the weight is {0.5 * 0.3 / 0.7 * 1800.0 * GRAVITY * 0.09:.0f}.",
        "",
        "## Sliding",
        "",
        *table(
            ("slope", "offset [cells]", "acceleration [m/s²]", "g (sin θ - μ cos θ)"),
            [(f"{a:g}°", f"{o:g}", f"{v:.4f}", f"{block_acceleration(a):.4f}") for a, o, v in blocks],
        ),
        "",
        *table(
            ("cell [m]", "front down a tilted box, a polyline [m]", f"{100.0 * BULK:g} % of the sand, both [m]"),
            [(f"{cell:g}", *(f"{floor:.3f}, {line:.3f}" for floor, line in extents)) for cell, extents in inclines],
        ),
        "",
        "## Leaks",
        "",
        *table(
            ("plate [cells]", "thrown at [m/s]", "particles beyond it", "of"),
            [(f"{t:g}", f"{v:g}", str(passed(flow)), str(flow.positions.shape[1])) for t, v, flow in throws],
        ),
        "",
        *table(
            ("touching baffles in steps of [cells]", "particles inside"),
            [(f"{rise:g}", str(count)) for rise, count in grounds],
        ),
        "",
        "## A flume of 35°",
        "",
        f"`flume-35`: sand lets go on a slope of 35°, runs out on a level floor and meets a wall. Its front"
        f" comes to {flume.front:.3f} m; the wall bears {flume.peak[0]:.0f} N/m at most, at"
        f" {flume.peak[1]:.2f} s;"
        f" momentum balances within {flume.balance:.1e} of the weight times the time (double precision).",
        "",
        *(["![the flume](contact-flume.png)", ""] if out is not None else []),
        "## Where a baffle stands",
        "",
        *table(
            ("difference [mm]", "d toe / dz of `baffles-2`"),
            [(f"{1000 * shift:g}", f"{slope:.2f}") for shift, slope in zip(shifts, slopes, strict=True)],
        ),
        "",
    ]
    text = "\n".join([*conclusion, "", *tables])
    if out is not None:
        draw(out / "contact-flume.png", flume)
        head = ["# Contact with solids", ""]
        made = ["", f"`python -m validation.bench contact`; {machine()}. The law: `mpm/physics/contact.py`.", ""]
        write_text(out / "contact.md", "\n".join([*head, *conclusion, *made, *tables]))
    return text
