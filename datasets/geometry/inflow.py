"""What flows in through a section: its hydrograph, cut into particles that each enter at a time and a place.

The discharge Q and the speed v of a hydrograph are linear between its times. Of N particles that share the volume of
the inflow, V_p each, the i-th enters with the speed v(t_i) at the time t_i when half of it has flowed in,

    int_0^{t_i} Q dt = (i + 1/2) V_p

so that the volume of those that have entered is at any time the integral of the discharge to half a particle. It enters
somewhere in the area A = Q / v of the section at that time, below a level that is the same all across: in 2D up to the
depth Q / v, in 3D above the ground beneath the section. Where, follows from a Kronecker sequence (Kuipers and
Niederreiter 1974, section 2.3), the fractions of i / g and, in 3D, of i / g^2: shares of the area and of the depth
there. With the golden ratio g = 1.618, g^2 = g + 1, and in 3D the plastic number g = 1.325, g^3 = g + 1, particles keep
the distances of a lattice whatever the speed and the depth are, without rows.
"""

from dataclasses import dataclass

import numpy as np

from datasets.errors import require
from datasets.geometry.ground import TOUCHING, Floats, elevation, plan_axes
from datasets.geometry.shapes import check_rows, check_vector
from datasets.memory import require as require_memory
from datasets.scene.parts import TOLERANCE, Domain, Mass, Rows, Solid

RATIO = {2: 1.618033988749895, 3: 1.324717957244746}
"""g, by dimension."""
ASKEW = 1.0e-3
"""Cosine of the angle between the flow and the section, or of the section and the level, that counts as none."""
HALVINGS = 60
"""Of a range in which the ground is looked for."""
ROUNDING = 1.0e-12
"""Of a sum over strips."""
PORTION = 2**22
"""Numbers of particles times strips that are computed together."""
TOGETHER = 200
"""Bytes that a particle takes while it is made."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Inflow:
    """The particles of an inflow, N of them, and its section: a plane through `foot`, `flow` across it, `up` in it."""

    domain: Domain
    ground: tuple[Solid, ...] | None
    """What the section stands on; None where it has an elevation of its own."""
    hydrograph: Floats
    """Times [s], discharges [m^D/s] and speeds [m/s], shape [R, 3]."""
    volume: float
    """Of all that enters [m^D]."""
    time: Floats
    """When each particle enters [s], shape [N], ascending."""
    level: Floats
    """How high the surface is above the foot then [m], shape [N]."""
    foot: Floats
    """The middle of the lowest line of the section [m], shape [D]."""
    flow: Floats
    """The direction of the velocity, shape [D], and two more at right angles to it:"""
    along: Floats
    """along the foot, zero in 2D,"""
    up: Floats
    """and upwards."""
    width: float
    """Length of the foot [m]; 1 in 2D."""
    bed: Floats
    """Height of the ground above the foot in strips along it [m], shape [S]."""

    @property
    def depth(self) -> float:
        """The largest [m]."""
        return float(self.level.max() - self.bed.min())

    @property
    def velocities(self) -> Floats:
        """With which the particles enter [m/s], shape [N, D]."""
        return np.interp(self.time, self.hydrograph[:, 0], self.hydrograph[:, 2])[:, None] * self.flow

    def places(self, phase: Floats | float = 0.0) -> Floats:
        """Where they enter [m], shape [N, D]; phase: of the sequence, shape [D], for other places of the same kind."""
        dimension, count = len(self.foot), len(self.time)
        shares = np.arange(count)[:, None] / RATIO[dimension] ** np.arange(1, dimension)
        shares += np.broadcast_to(phase, dimension)[1:]
        shares -= np.floor(shares)
        across, height, strip = np.zeros(count), np.zeros(count), self.width / len(self.bed)
        for first in range(0, count, max(1, PORTION // len(self.bed))):
            part = slice(first, first + max(1, PORTION // len(self.bed)))
            depth = np.maximum(self.level[part, None] - self.bed, 0.0)
            passed = np.cumsum(depth, axis=1)
            area = (1.0 - ROUNDING) * shares[part, 0] * passed[:, -1] if dimension == 3 else np.zeros(len(depth))
            number = np.minimum((passed <= area[:, None]).sum(axis=1), len(self.bed) - 1)
            own = np.take_along_axis(depth, number[:, None], axis=1)[:, 0]
            before = np.take_along_axis(passed, number[:, None], axis=1)[:, 0] - own
            across[part] = (number + (area - before) / own) * strip - 0.5 * self.width
            height[part] = self.bed[number] + shares[part, -1] * own
        places = self.foot + across[:, None] * self.along + height[:, None] * self.up
        if self.ground is not None:
            # Within a strip the ground may be higher than in its middle.
            floor = elevation(self.ground, self.domain, places[:, plan_axes(dimension)])
            places[:, 1] = np.maximum(places[:, 1], floor + TOUCHING)
        return places


def until(hydrograph: Rows, end: float, key: str) -> Rows:
    """The rows of a hydrograph up to a time [s]. Raises InputError for one that is none."""
    check_rows(hydrograph, key, 3, least=2)
    time, discharge, speed = rows = np.array(hydrograph).T
    for index, row in enumerate(hydrograph):
        later = row[0] > time[index - 1] if index else row[0] >= 0.0
        require(later, f"{key}[{index}]", "times in ascending order from 0 s on", f"{row[0]:g}")
        require(min(row[1:]) >= 0.0, f"{key}[{index}]", "a discharge and a speed of at least 0", list(row[1:]))
        require(row[1] == 0.0 or row[2] > 0.0, f"{key}[{index}]", "a speed above 0 beside a discharge", row[2])
    some = (discharge[time < end] > 0.0).any() or (time[0] < end and np.interp(end, time, discharge) > 0.0)
    require(bool(some), key, f"some discharge before the end at {end:g} s", "none")
    if time[-1] <= end:
        return hydrograph
    last = [end, *(float(np.interp(end, time, each)) for each in (discharge, speed))]
    return (*map(tuple, rows.T[time < end].tolist()), tuple(last))


def inflow(mass: Mass, domain: Domain, ground: tuple[Solid, ...], share: float, key: str) -> Inflow:
    """What a mass of kind inflow brings, in particles of about `share` [m]. Raises InputError."""
    hydrograph, dimension = np.array(mass.hydrograph) * [1.0, mass.discharge_factor or 1.0, 1.0], domain.dimension
    foot, along, width, grounded = foot_of(mass, domain, ground, share, key)
    strips = max(1, round(width / share)) if dimension == 3 else 1
    across = ((np.arange(strips) + 0.5) / strips - 0.5) * width * along[:, None] if dimension == 3 else np.zeros((2, 1))
    flow = direction_of(mass, domain, ground if grounded else (), foot, along, foot[:, None] + across, key)
    up = np.cross(flow, along) if dimension == 3 else np.array([-flow[1], flow[0]])
    up *= 1.0 if up[1] >= 0.0 else -1.0
    require(up[1] > ASKEW, f"{key}.direction", "one that is not vertical", flow.tolist())
    bed = np.zeros(strips)
    if grounded and dimension == 3:
        low, high = np.full((2, strips), [[-domain.size[1] / up[1]], [domain.size[1] / up[1]]])
        for _ in range(HALVINGS):
            bed = 0.5 * (low + high)
            places = (foot[:, None] + across + bed * up[:, None]).T
            buried = places[:, 1] < elevation(ground, domain, places[:, ::2])
            low, high = np.where(buried, bed, low), np.where(buried, high, bed)
    time, discharge, _ = hydrograph.T
    passed = np.append(0.0, np.cumsum(0.5 * np.diff(time) * (discharge[1:] + discharge[:-1])))
    count = max(1, round(passed[-1] / share**dimension))
    instead = f"it has {count:.3g} of them; larger cells or fewer particles_per_axis"
    require_memory(TOGETHER * count, "the particles of an inflow", instead, key=key)
    entered = (np.arange(count) + 0.5) * passed[-1] / count
    row = np.clip(np.searchsorted(passed, entered, side="right") - 1, 0, len(time) - 2)
    missing, before = entered - passed[row], discharge[row]
    rising = (np.diff(discharge) / np.diff(time))[row]
    # The root of missing = before t + rising t^2 / 2 that is exact also where nothing rises.
    time = time[row] + 2.0 * missing / (before + np.sqrt(np.maximum(before**2 + 2.0 * rising * missing, 0.0)))
    area = np.interp(time, *hydrograph[:, :2].T) / np.interp(time, *hydrograph[:, ::2].T)
    sorted_bed, beyond = np.sort(bed), float(np.sum(domain.size))
    areas = width / strips * (sorted_bed * np.arange(strips) - np.append(0.0, np.cumsum(sorted_bed)[:-1]))
    knots = np.append(sorted_bed, sorted_bed[-1] + beyond)
    level = np.interp(area, np.append(areas, areas[-1] + width * beyond), knots)
    found = Inflow(
        domain=domain,
        ground=ground if grounded else None,
        hydrograph=hydrograph,
        volume=float(passed[-1]),
        time=time,
        level=level,
        foot=foot,
        flow=flow,
        along=along,
        up=up,
        width=width,
        bed=bed,
    )
    expected = f"a depth, discharge over speed and width, of at least a particle, {share:.3g} m"
    require(found.depth >= share, f"{key}.hydrograph", expected, f"{found.depth:.3g} m at most")
    return found


def foot_of(
    mass: Mass, domain: Domain, ground: tuple[Solid, ...], share: float, key: str
) -> tuple[Floats, Floats, float, bool]:
    """The foot of a section: its middle [m] [D], its direction [D], its length [m], whether it lies on the ground."""
    dimension, rows, key = domain.dimension, mass.section or (), f"{key}.section"
    grounded = bool(rows) and len(rows[0]) == dimension - 1
    check_rows(rows, key, dimension - int(grounded), least=dimension - 1)
    require(len(rows) == dimension - 1, key, f"{dimension - 1} rows", len(rows))
    ends = np.array(rows)
    if grounded:
        ends = np.insert(ends, 1, elevation(ground, domain, ends.mean(axis=0, keepdims=True)), axis=1)
    inside = (ends >= -TOLERANCE).all() and (ends <= np.array(domain.size) + TOLERANCE).all()
    require(bool(inside), key, f"a section inside the domain {list(domain.size)}", ends.tolist())
    if dimension == 2:
        line, width = np.zeros(2), 1.0
    else:
        line, width = ends[1] - ends[0], float(np.linalg.norm(ends[1] - ends[0]))
        require(width >= share, key, f"a section of at least a particle, {share:.3g} m, across", f"{width:.3g} m")
        line = line / width
    if not grounded:
        places = np.linspace(ends[0], ends[-1], max(2, round(width / share)))
        above = places[:, 1] - elevation(ground, domain, places[:, plan_axes(dimension)])
        require(above.min() >= -TOUCHING, key, "a section above the ground", f"one {-above.min():.3g} m below")
    return ends.mean(axis=0), line, width, grounded


def direction_of(
    mass: Mass, domain: Domain, ground: tuple[Solid, ...], foot: Floats, along: Floats, strips: Floats, key: str
) -> Floats:
    """The unit vector of the velocity, shape [D]: as given, else across the section and down along the ground beneath.

    strips: places along the foot [m], shape [D, S]. On level ground it is the one across whose x is larger.
    """
    dimension, key = domain.dimension, f"{key}.direction"
    if mass.direction is not None:
        check_vector(mass.direction, key, dimension)
        given = np.array(mass.direction)
        length = float(np.linalg.norm(given))
        across = length > 0.0 and bool(abs(given @ along) <= ASKEW * length)
        require(across, key, "a vector at right angles to the section", given.tolist())
        given -= (given @ along) * along
        return np.asarray(given / np.linalg.norm(given))
    level = np.array([1.0, 0.0]) if dimension == 2 else np.array([along[2], 0.0, -along[0]]) / np.hypot(*along[::2])
    ends = [(strips.T + sign * domain.cell * level)[:, plan_axes(dimension)] for sign in (-1.0, 1.0)]
    behind, ahead = (elevation(ground, domain, end) for end in ends)
    slope = float(np.mean(ahead - behind)) / (2.0 * domain.cell)
    known = abs(slope) > TOLERANCE or abs(level[0]) > ASKEW
    require(known, key, "the direction of the flow through a section on level ground", "none")
    level = level + slope * np.eye(dimension)[1]
    down = slope < -TOLERANCE or (slope <= TOLERANCE and level[0] > 0.0)
    return np.asarray((level if down else -level) / np.linalg.norm(level))
