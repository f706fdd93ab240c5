"""Quantities of single rows, in addition to the invariants of every flow; most are divided by an exact solution.

`rows.toml` names the functions here, with a label and the usual range of each.
"""

import math

import numpy as np
from numpy.typing import NDArray

from datasets.flow.measures import bulk, front, particle_spacing, toe
from datasets.flow.trajectory import Trajectory
from validation.bench.stability import exact_solutions as exact
from validation.bench.stability.invariants import particle_masses, wall_impulse


def slides(flow: Trajectory) -> float:
    """Displacement of the centre of a block down an incline, over that of a rigid one."""
    block = exact.SlidingBlock.of_scene(flow.scene)
    return float(exact.centre_displacement(flow)[-1, 0]) / block.displacement(flow.time[-1])


def middle_slides(flow: Trajectory) -> float:
    """Mean displacement of the middle third of a layer down an incline, over that of a rigid block."""
    moved = middle_displacement(flow)[:, 0].mean()
    return float(moved / exact.SlidingBlock.of_scene(flow.scene).displacement(flow.time[-1]))


def middle_stays(flow: Trajectory) -> float:
    """How far the middle third of a layer has moved on average, while its ends collapse."""
    return 1.0e3 * float(np.linalg.norm(middle_displacement(flow), axis=1).mean())


def thrust_ratio(flow: Trajectory) -> float:
    """Mean thrust of a bed on the first solid beside it, over rho g H^2 / 2 of a liquid of its density: its `k0`."""
    assert flow.solid_impulse is not None
    scene, bed = flow.scene, flow.scene.masses[0]
    liquid = 0.5 * scene.material_of(bed).density * scene.gravity * bed.size[1] ** 2
    return float(flow.solid_impulse[-1, 0, 0]) / (liquid * float(flow.time[-1]))


def moves_on(flow: Trajectory) -> float:
    """Displacement of the centre of a body without force along its motion, over v t."""
    free = np.array(flow.scene.masses[0].velocity) * flow.time[-1]
    return float(exact.centre_displacement(flow)[-1] @ free / (free @ free))


def spins_on(flow: Trajectory) -> float:
    """Kinetic energy at the end over that at the start, for a freely rotating rigid body: 1."""
    kinetic = flow.summary["energy"]["kinetic"]
    return float(kinetic[-1] / kinetic[0])


def falls_freely(flow: Trajectory) -> float:
    """Error of the height of the mass's centre against free fall, up to the frame before it lands, over the fall."""
    scene = flow.scene
    drop = scene.masses[0].lower[1] - scene.domain.cell
    last = int(math.sqrt(2.0 * drop / scene.gravity) / scene.frame_dt)
    fall = exact.FreeFlight.of_flow(flow).displacement(flow.time[: last + 1])[:, 1]
    height = mass_height(flow, 0)[: last + 1]
    return float(np.abs(height - height[0] - fall).max()) / drop


def parts_freely(flow: Trajectory) -> float:
    """Rise of the upper mass at the end, over v t - g t^2 / 2 of a free throw. Where the masses separate, they share
    one row of nodes and its velocity; that may cost the thrown one a tenth of its rise. More than a free throw would be
    a gain of energy."""
    upper, scene, height = flow.scene.masses[1], flow.scene, mass_height(flow, 1)
    assert upper.velocity is not None
    thrown = upper.velocity[1] * scene.duration - 0.5 * scene.gravity * scene.duration**2
    return float((height[-1] - height[0]) / thrown)


def never_pulls(flow: Trajectory) -> float:
    """Largest tension of any particle in any frame, over rho g H: cohesionless sand has none."""
    assert flow.pressure is not None
    height = max(mass.lower[1] + mass.size[1] for mass in flow.scene.masses)
    return max(0.0, -float(flow.pressure.min())) / (flow.scene.material.density * flow.scene.gravity * height)


def bar_decrement(flow: Trajectory) -> float:
    """Logarithmic decrement per period of a free bar's lowest longitudinal mode; 0 for an elastic bar."""
    return exact.StandingWave.of_bar(flow).decrement(flow)


def layer_decrement(flow: Trajectory) -> float:
    """Logarithmic decrement per period of a layer's lowest vertical mode; 0 for an elastic layer."""
    return exact.StandingWave.of_layer(flow).decrement(flow)


def stays_at_rest(flow: Trajectory) -> float:
    """Largest speed of any particle in any frame: 0 in geostatic equilibrium.

    In f32 a stress of rho g H has the error eps rho g H, eps = 6e-8. It gives an acceleration of eps g H / dx until the
    elasticity of the cell balances it, after at most dx / c: a speed of eps g H / c, times the ten roundings of a node.
    """
    assert flow.velocities is not None
    return float(np.linalg.norm(flow.velocities.astype(np.float64), axis=2).max())


def settles(flow: Trajectory) -> float:
    """Settlement of the surface at the end, over that of elastic layers that cannot bulge."""
    return float(surface_settlement(flow)[-1]) / exact.settlement(flow.scene)


def fills_raster(flow: Trajectory) -> float:
    """Volume of the particles over sum h A of the release raster: 3 x 3 cells of 1 m, 2 m thick, within no data."""
    return float(flow.volumes.sum(dtype=np.float64)) / 18.0


def at_rest_beyond_step(flow: Trajectory) -> NDArray[np.bool_]:
    """Which particles rest beyond the first solid, shape [N]. It leaves out particles that still move by more than a
    tenth of a cell per frame, and those within three cells of the step, where one on its edge would count as a column
    as high as the step."""
    before, last = flow.positions[-2:].astype(np.float64)
    step, cell = flow.scene.solids[0], flow.scene.domain.cell
    assert step.lower is not None
    assert step.size is not None
    beyond = step.lower[0] + step.size[0] + 3.0 * cell
    return np.asarray((last[:, 0] > beyond) & (np.linalg.norm(last - before, axis=1) < 0.1 * cell))


def fills_its_volume(flow: Trajectory) -> float:
    """Volume under the surface of the material at rest beyond the first solid, over that of its particles."""
    rests = at_rest_beyond_step(flow)
    volumes = flow.volumes[rests].astype(np.float64)
    spacing = particle_spacing(volumes, flow.scene.dimension)
    return bulk(flow.positions[-1, rests].astype(np.float64), spacing, float(volumes.sum()), flow.scene.domain.cell)


def lies_as_high_as_dense(flow: Trajectory) -> float:
    """Mean height of the material at rest beyond the first solid over half its volume per area, in strips a cell wide.
    It ignores the roughness of the surface: in 3D a deposit five particles thick is rough by one particle."""
    rests = at_rest_beyond_step(flow)
    positions, volumes = flow.positions[-1, rests].astype(np.float64), flow.volumes[rests].astype(np.float64)
    cell = flow.scene.domain.cell
    area = cell * math.prod(flow.scene.domain.size[2:])
    strip = (positions[:, 0] / cell).astype(int)
    volume = np.bincount(strip, volumes)
    height = np.bincount(strip, volumes * positions[:, 1]) / np.maximum(volume, 1e-30)
    thick = volume / area > particle_spacing(volumes, flow.scene.dimension)
    return float((2.0 * height * area)[thick].sum() / volume[thick].sum())


def settles_at_most_twice(flow: Trajectory) -> float:
    """The same in the deepest frame: undamped, it may settle twice as far as under a slowly applied load."""
    return float(surface_settlement(flow).max()) / exact.settlement(flow.scene)


def rests_settled(flow: Trajectory) -> float:
    """The same when the solver detects rest: a bed oscillates between 0 and twice that, where nothing moves either."""
    rest = flow.summary.get("rest_time") or 0.0
    return float(surface_settlement(flow)[np.abs(flow.time - rest).argmin()]) / exact.settlement(flow.scene)


def rests_after_landing(flow: Trajectory) -> float:
    """Time at which the solver detects rest of thrown sand, over that of its landing; inf if it never does. Sand thrown
    upwards at v from the height h lands after (v + sqrt(v^2 + 2 g h)) / g."""
    rest, (mass, *_), gravity = flow.summary.get("rest_time"), flow.scene.masses, flow.scene.gravity
    up = mass.velocity[1] if mass.velocity else 0.0
    landing = (up + math.sqrt(up**2 + 2.0 * gravity * mass.lower[1])) / gravity
    return math.inf if rest is None else float(rest) / landing


def stands(flow: Trajectory) -> float:
    """Mean loss of height of soil far from failure, in the second half of the frames; rho g H^2 / (3 E) is elastic."""
    height = flow.positions[:, :, 1].mean(axis=1, dtype=np.float64)
    return in_cells(height[0] - height[len(height) // 2 :].mean(), flow)


def spreads(flow: Trajectory) -> float:
    """The front over that of a pile at the friction angle with the area of the column L x H at the wall. The pile is a
    trapezoid, L + H / (2 tan phi), if H <= 2 L tan phi, else a triangle, sqrt(2 L H / tan phi)."""
    masses, tan_phi = flow.scene.masses, flow.scene.material.friction
    length, height = masses[0].size[0], sum(mass.size[1] for mass in masses)
    low = height <= 2.0 * length * tan_phi
    pile = length + height / (2.0 * tan_phi) if low else math.sqrt(2.0 * length * height / tan_phi)
    return front(flow.positions[-1], flow.volumes) / pile


def creeps(flow: Trajectory) -> float:
    """Largest displacement of any particle over the second half of the time."""
    half = len(flow.time) // 2
    moved = np.linalg.norm((flow.positions[half:] - flow.positions[half]).astype(np.float64), axis=2)
    return in_cells(moved.max(), flow)


def runs_out(flow: Trajectory) -> float:
    """Displacement of the front."""
    return in_cells(front(flow.positions[-1], flow.volumes) - front(flow.positions[0], flow.volumes), flow)


def fails(flow: Trajectory) -> float:
    """Share of the particles that moved by a cell or more: from 0.05 on a cut has failed. A slice of one cell off its
    face is less; Rankine's wedge behind a cut as wide as high is a quarter."""
    moved = np.linalg.norm((flow.positions[-1] - flow.positions[0]).astype(np.float64), axis=1)
    return float((moved >= flow.scene.domain.cell).mean())


def wall_stops(flow: Trajectory) -> float:
    """Largest momentum given to the walls along x, over that of the thrown mass: 1 if it stops, 2 if it bounces."""
    return share_of_throw(flow, wall_impulse(flow))


def baffle_stops(flow: Trajectory) -> float:
    """Largest momentum given to the baffles along x, over that of the thrown mass."""
    assert flow.solid_impulse is not None
    return share_of_throw(flow, flow.solid_impulse.sum(axis=1))


def passes_baffle(flow: Trajectory) -> float:
    """Share of the particles that are beyond the middle of the first baffle at the end."""
    baffle = flow.scene.baffles[0]
    return float((flow.positions[-1, :, 0] > baffle.lower[0] + 0.5 * baffle.size[0]).mean())


def is_round(flow: Trajectory) -> float:
    """Largest difference between the extents of the deposit along +x, -x, +z and -z from its initial place."""
    start, end = flow.positions[0].mean(axis=0, dtype=np.float64), flow.positions[-1]
    extents = [np.quantile(sign * (end[:, axis] - start[axis]), 0.995) for axis in (0, 2) for sign in (-1, 1)]
    return in_cells(max(extents) - min(extents), flow)


def is_symmetric(flow: Trajectory) -> float:
    """Difference between the toes (mean of the furthest tenth) along x and z, which should be equal."""
    end = flow.positions[-1]
    return in_cells(abs(toe(end)[0] - toe(end[:, ::-1])[0]), flow)


def middle_displacement(flow: Trajectory) -> NDArray[np.float64]:
    """Displacement [m] at the end of the particles that began in the middle third along x, shape [N, D]."""
    x = flow.positions[0, :, 0]
    low, high = float(x.min()), float(x.max())
    middle = np.abs(x - 0.5 * (low + high)) < (high - low) / 6.0
    return np.asarray((flow.positions[-1] - flow.positions[0])[middle], np.float64)


def in_cells(length: float, flow: Trajectory) -> float:
    return float(length) / flow.scene.domain.cell


def surface_settlement(flow: Trajectory) -> NDArray[np.float64]:
    """Settlement of the topmost cell of particles [m], shape [T]."""
    start = flow.positions[0, :, 1]
    top = start > start.max() - flow.scene.domain.cell
    return np.asarray((start[top] - flow.positions[:, top, 1]).mean(axis=1, dtype=np.float64))


def mass_height(flow: Trajectory, index: int) -> NDArray[np.float64]:
    """Height of the centre of one of the scene's initial masses [m], shape [T]."""
    box = flow.scene.masses[index]
    start = flow.positions[0, :, 1]
    mass = (start > box.lower[1]) & (start < box.lower[1] + box.size[1])
    return np.asarray(flow.positions[:, mass, 1].mean(axis=1, dtype=np.float64))


def share_of_throw(flow: Trajectory, impulse: NDArray[np.float64]) -> float:
    """Largest x of an impulse [N s], shape [T, D], over the momentum that the flow had along x at the start."""
    assert flow.velocities is not None
    thrown = float(particle_masses(flow) @ flow.velocities[0, :, 0].astype(np.float64))
    return float(impulse[:, 0].max()) / thrown
