"""What single rows have to show besides what every flow keeps: mostly a formula that the scene was made for.

Each takes a trajectory and returns what it found; those with keywords are given them in `validation.bench.stability.cases`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from datasets.measures import front, toe
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from validation.bench.stability.finding import Finding
from validation.bench.stability.invariants import point_masses, wall_impulse

FAILED = 0.05
"""Share of the particles of a cut that moved by a cell, from which on it has failed: a slice of a cell off its face,
which has hardly any tension to hold it, is less, and Rankine's wedge behind a cut as wide as it is high a quarter."""
CRACKS = 0.1
"""Tension limit over cohesion, below which soil counts as cracking freely in `critical_height`."""


def spreads(flow: Trajectory) -> Finding:
    """The front reaches at least as far as a heap of the same area at the angle of friction [m].

    Of a column L x H at the wall: a trapezoid L + H / (2 tan phi) where H <= 2 L tan phi, else a triangle
    sqrt(2 L H / tan phi); a deposit that slopes less than phi anywhere is longer.
    """
    mass, tan_phi = flow.scene.masses, flow.scene.material.friction
    length, height = mass[0].size[0], sum(box.size[1] for box in mass)
    flat = height <= 2.0 * length * tan_phi
    reach = length + height / (2.0 * tan_phi) if flat else math.sqrt(2.0 * length * height / tan_phi)
    return Finding(check="front [m]", value=front(flow.positions[-1]), least=reach)


def parts_freely(flow: Trajectory) -> Finding:
    """How high the upper mass has risen at the end, over v t - g t^2 / 2 of a free throw.

    Where the masses part, one row of nodes is common to both and shares its velocity; that may cost the thrown one
    a tenth of its way. More than a free throw would be energy from nowhere.
    """
    upper, scene = flow.scene.masses[1], flow.scene
    assert upper.velocity is not None
    thrown = upper.velocity[1] * scene.duration - 0.5 * scene.gravity * scene.duration**2
    moved = mass_height(flow, 1)
    return Finding(check="rise over free throw", value=float((moved[-1] - moved[0]) / thrown), least=0.9, most=1.001)


def never_pulls(flow: Trajectory) -> Finding:
    """Largest tension of any point in any frame, over the weight rho g H of the sand: cohesionless sand bears none."""
    assert flow.pressure is not None
    height = max(mass.lower[1] + mass.size[1] for mass in flow.scene.masses)
    weight = flow.scene.material.density * flow.scene.gravity * height
    return Finding(check="tension over weight", value=max(0.0, -float(flow.pressure.min())) / weight, most=1.0e-6)


def wall_stops(flow: Trajectory) -> Finding:
    """Largest momentum given to the walls along x, over that of the thrown mass.

    1 where the mass only stops, 2 where it bounces off without loss.
    """
    return Finding(check="wall impulse / M v", value=share_of_throw(flow, wall_impulse(flow)), least=1.0, most=2.0)


def baffle_takes(flow: Trajectory, *, least: float) -> Finding:
    """Largest momentum given to the baffles along x, over that of the thrown mass."""
    assert flow.baffle_impulse is not None
    taken = share_of_throw(flow, flow.baffle_impulse.sum(axis=1))
    return Finding(check="baffle impulse / M v", value=taken, least=least, most=2.0)


def reach_of_collapse(flow: Trajectory) -> Finding:
    """(d - L) / L of a tall column of aspect a, d the front.

    Between 1.9 a^(2/3), sand in a flume (Lube et al. 2005, a > 2.8), and 3.25 a^0.7, discs (Staron & Hinch 2005).
    """
    length, height = flow.scene.masses[0].size
    aspect = height / length
    value = (front(flow.positions[-1]) - length) / length
    return Finding(check="(d - L) / L", value=value, least=1.9 * aspect ** (2.0 / 3.0), most=3.25 * aspect**0.7)


def keeps_speed(flow: Trajectory) -> Finding:
    """Mean speed along x just before the first point is near the floor, over that at the start.

    Baffle and air are smooth: nothing may hold the layer, neither while it slides nor at the corner.
    """
    assert flow.velocities is not None
    near = flow.positions[:, :, 1].min(axis=1) < 2.0 * flow.scene.domain.cell
    last = int(np.argmax(near)) - 1
    speed = flow.velocities[:, :, 0].mean(axis=1, dtype=np.float64)
    return Finding(check="speed kept", value=float(speed[last] / speed[0]), least=0.98, most=1.001)


def passes_baffle(flow: Trajectory) -> Finding:
    """Share of the points that are beyond the baffle at the end."""
    baffle = flow.scene.baffles[0]
    past = flow.positions[-1, :, 0] > baffle.lower[0] + baffle.size[0]
    return Finding(check="past the baffle", value=float(past.mean()), least=0.99)


def falls_freely(flow: Trajectory) -> Finding:
    """Error of the height of the mass's centre against the parabola, up to the frame before it lands, over the fall."""
    scene = flow.scene
    drop = scene.masses[0].lower[1] - scene.domain.cell
    last = int(math.sqrt(2.0 * drop / scene.gravity) / scene.frame_dt)
    time = flow.time[: last + 1]
    # Symplectic Euler is ahead of the parabola by g t dt / 2.
    step = flow.time[-1] / flow.summary["steps"]
    fall = 0.5 * scene.gravity * time * (time + step)
    fallen = mass_height(flow, 0)[0] - mass_height(flow, 0)[: last + 1]
    return Finding(check="fall off parabola", value=float(np.abs(fallen - fall).max() / drop), most=1.0e-3)


def stands_as_before(flow: Trajectory) -> Finding:
    """Height of the centre of a bed at rest between walls, over half the bed's: neither loose nor above the floor."""
    height = flow.scene.masses[0].size[1]
    centre = float(flow.positions[-1, :, 1].mean(dtype=np.float64))
    return Finding(check="height of the centre", value=centre / (0.5 * height), least=0.95, most=1.05)


def lands(flow: Trajectory) -> Finding:
    """Height of the highest point at the end [cells]: a single point lies on the floor."""
    top = float(flow.positions[-1, :, 1].max()) / flow.scene.domain.cell
    return Finding(check="height at the end", value=top, unit="cells", most=0.5)


def creeps(flow: Trajectory, *, since: float, cells: float) -> Finding:
    """Largest way of any point from the time `since` [s] to the end [cells]."""
    start = int(np.argmin(np.abs(flow.time - since)))
    way = np.linalg.norm((flow.positions[start:] - flow.positions[start]).astype(np.float64), axis=2)
    return Finding(
        check=f"creep from {since:g} s", value=float(way.max()) / flow.scene.domain.cell, unit="cells", most=cells
    )


def runs_out(flow: Trajectory, *, cells: float) -> Finding:
    """How far the front has moved [cells]."""
    moved = front(flow.positions[-1]) - front(flow.positions[0])
    return Finding(check="front moved", value=moved / flow.scene.domain.cell, unit="cells", least=cells)


def stands_but_for_spall(flow: Trajectory) -> Finding:
    """Share of the particles that moved by a cell or more: what spalls off a face with hardly any tension is less."""
    return Finding(check="moved a cell", value=moved_share(flow), most=FAILED)


def falls(flow: Trajectory) -> Finding:
    """Share of the particles that moved by a cell or more: from FAILED on a cut has failed."""
    return Finding(check="moved a cell", value=moved_share(flow), least=FAILED)


def moved_share(flow: Trajectory) -> float:
    """Share of the particles that lie a cell or more from where they began."""
    moved = np.linalg.norm((flow.positions[-1] - flow.positions[0]).astype(np.float64), axis=1)
    return float((moved >= flow.scene.domain.cell).mean())


def over_critical_height(flow: Trajectory, *, ratio: float) -> Finding:
    """Height of the cut over its critical height (`critical_height`): that the scene is what it says."""
    value = flow.scene.masses[0].size[1] / critical_height(flow.scene)
    return Finding(check="H over critical H", value=value, least=ratio - 0.001, most=ratio + 0.001)


def critical_height(scene: Scene) -> float:
    """Critical height [m] of a vertical cut, N c / gamma tan(45 + phi / 2).

    N = 2 for soil without tension: a slice beside the face, cut off by a crack, stands on its unconfined strength
    (Drucker 1953); N = 4, a wedge on a plane, for soil with tension up to the apex of its cone (Fellenius 1927).
    Soil with a limit below `CRACKS` of its cohesion, as by default, counts as soil without (`datasets.material`: the
    default raises the height by some per cent).
    """
    material = scene.material
    angle = math.radians(45.0 + 0.5 * material.friction_deg)
    carries = material.tension_limit >= CRACKS * material.cohesion
    unit_weight = material.density * scene.gravity
    return (4.0 if carries else 2.0) * material.cohesion / unit_weight * math.tan(angle)


def settles(flow: Trajectory) -> Finding:
    """Settlement of the surface at the end, over that of elastic layers that cannot bulge (`settlement`)."""
    return Finding(check="settlement", value=float(sunk(flow)[-1] / settlement(flow.scene)), least=0.95, most=1.05)


def settles_at_most_twice(flow: Trajectory) -> Finding:
    """Largest settlement of the surface in any frame, over that of elastic layers.

    Without damping the layer swings: it may sink twice as far as under a load that comes slowly, and no further.
    """
    return Finding(check="deepest settlement", value=float(sunk(flow).max() / settlement(flow.scene)), most=2.1)


def settlement(scene: Scene) -> float:
    """How far layers sink under their own weight [m], if they stay elastic and walls keep them from bulging.

    u = sum over the layers of (w + rho g h / 2) h / M, with w the weight above and M the modulus of one-dimensional
    compression. The lateral stress is nu / (1 - nu) of the vertical, less than Mohr-Coulomb asks for: nothing yields.
    """
    load = total = 0.0
    for mass in reversed(scene.masses):
        material, height = scene.material_of(mass), mass.size[1]
        weight = material.density * scene.gravity * height
        total += (load + 0.5 * weight) * height / (material.lame + 2.0 * material.shear_modulus)
        load += weight
    return total


def sunk(flow: Trajectory) -> NDArray[np.float64]:
    """How far the topmost cell of points has sunk [m], shape [T]."""
    start = flow.positions[0, :, 1]
    top = start > start.max() - flow.scene.domain.cell
    return np.asarray((start[top] - flow.positions[:, top, 1]).mean(axis=1, dtype=np.float64))


def step_used(flow: Trajectory) -> Finding:
    """Fraction of cell / wave speed that the steps took on average: that the row tests what it says."""
    scene = flow.scene
    fastest = max(scene.material_of(mass).wave_speed for mass in scene.masses)
    value = scene.duration / flow.summary["steps"] * fastest / scene.domain.cell
    return Finding(check="step", value=value, least=0.85, most=0.9)


def as_far_as(flow: Trajectory, other: Trajectory, *, within: float) -> Finding:
    """Front over that of the same scene at another step or stiffness, which is no business of the front."""
    value = front(flow.positions[-1]) / front(other.positions[-1])
    return Finding(check="front over the other's", value=value, least=1.0 - within, most=1.0 + within)


def is_round(flow: Trajectory) -> Finding:
    """Largest difference between the reaches of the deposit along +x, -x, +z and -z from where it started [cells]."""
    start, end = flow.positions[0].mean(axis=0, dtype=np.float64), flow.positions[-1]
    reaches = [np.quantile(sign * (end[:, axis] - start[axis]), 0.995) for axis in (0, 2) for sign in (-1, 1)]
    value = float(max(reaches) - min(reaches)) / flow.scene.domain.cell
    return Finding(check="out of round", value=value, unit="cells", most=1.0)


def is_symmetric(flow: Trajectory) -> Finding:
    """Difference between the toes along x and z, the mean of the furthest tenth, where both are alike [cells].

    The fronts rest on half a per cent of the particles, and where these lie another jitter decides.
    """
    end = flow.positions[-1]
    apart = abs(toe(end)[0] - toe(end[:, ::-1])[0]) / flow.scene.domain.cell
    return Finding(check="toe along x against z", value=apart, unit="cells", most=0.1)


def stays_in_place(flow: Trajectory) -> Finding:
    """How far the centre has moved along the floor [cells]."""
    moved = (flow.positions[-1] - flow.positions[0]).mean(axis=0, dtype=np.float64)
    return Finding(
        check="centre moved",
        value=math.hypot(moved[0], moved[2]) / flow.scene.domain.cell,
        unit="cells",
        most=0.1,
    )


def every_point_agrees(single: Trajectory, double: Trajectory) -> Finding:
    """Largest distance between the same point in f32 and f64 in any frame [cells]; the runout d among them."""
    apart = np.linalg.norm(single.positions.astype(np.float64) - double.positions, axis=2)
    value = float(apart.max()) / single.scene.domain.cell
    return Finding(check="points, f32 to f64", value=value, unit="cells", most=0.1)


def mass_height(flow: Trajectory, index: int) -> NDArray[np.float64]:
    """Height of the centre of what was one of the scene's masses [m], shape [T]."""
    box = flow.scene.masses[index]
    start = flow.positions[0, :, 1]
    mine = (start > box.lower[1]) & (start < box.lower[1] + box.size[1])
    return np.asarray(flow.positions[:, mine, 1].mean(axis=1, dtype=np.float64))


def share_of_throw(flow: Trajectory, impulse: NDArray[np.float64]) -> float:
    """Largest x of an impulse [N s], shape [T, D], over the momentum that the flow had along x at the start."""
    assert flow.velocities is not None
    thrown = float(point_masses(flow) @ flow.velocities[0, :, 0].astype(np.float64))
    return float(impulse[:, 0].max()) / thrown
