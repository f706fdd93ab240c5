"""Inflow through a section: its hydrograph, divided into particles that each enter at a time and a place.

Discharge Q and speed v are linear between the times of a hydrograph. Of N particles that share the volume of the
inflow, V_p each, the i-th enters with v(t_i) when half of it has flowed in: int_0^{t_i} Q dt = (i + 1/2) V_p. So the
entered volume equals the integral of the discharge to within half a particle, at any time. A particle enters within the
area A = Q / v of the section, between the ground and a level surface. A Kronecker sequence (Kuipers and Niederreiter
1974, section 2.3) gives its place: the fractions of i / g and, in 3D, of i / g^2, with the golden ratio g^2 = g + 1, in
3D the plastic number g^3 = g + 1, are shares of the area and of the depth there. Particles thus keep the distances of a
lattice at any speed and depth. A section in 2D is one metre wide along z here.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from datasets.errors import require
from datasets.geometry.ground import TOUCHING, Floats, Solids, elevation, plan_axes
from datasets.geometry.shapes import check_rows, check_vector
from datasets.memory import require as require_memory
from datasets.scene.parts import TOLERANCE, Domain, Mass, Rows

STEPS = {2: (0.0, 0.6180339887498949), 3: (0.7548776662466927, 0.5698402909980532)}
"""Steps from particle to particle, by dimension: of the share of the area, 0 or 1 / g, and of the depth's share."""
ASKEW, ROUNDING, HALVINGS = 1.0e-3, 1.0e-12, 60
"""Cosine that counts as a right angle; rounding of a sum over strips; halvings of the range that holds the ground."""
PORTION, PARTICLE = 2**22, 200
"""Number of particles times strips that are computed together; bytes per particle while it is made."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Inflow:
    """The particles of an inflow, N of them, and its section: the plane of `along` and `up` through `foot`."""

    domain: Domain
    ground: Solids | None  # ground on which the section stands; None if it has its own elevation
    hydrograph: Floats  # times [s], discharges [m^D/s] and speeds [m/s], shape [R, 3]
    volume: float  # total inflow [m^D]
    time: Floats  # time at which each particle enters [s], shape [N], ascending
    level: Floats  # height of the surface above the foot at that time [m], shape [N]
    foot: Floats  # the middle of the foot [m], shape [3]
    flow: Floats  # unit vector of the velocity, shape [3]
    along: Floats  # along the foot
    up: Floats  # upwards across both
    width: float  # length of the foot [m]
    bed: Floats  # height of the ground above the foot in strips along it [m], shape [S]

    @property
    def depth(self) -> float:
        """The largest depth [m]."""
        return float(self.level.max() - self.bed.min())

    @property
    def velocities(self) -> Floats:
        """Velocities with which the particles enter [m/s], shape [N, D]."""
        speed = np.interp(self.time, self.hydrograph[:, 0], self.hydrograph[:, 2])
        return speed[:, None] * self.flow[: self.domain.dimension]

    def places(self, phase: Floats | float = 0.0) -> Floats:
        """Places of entry [m], shape [N, D]; phase: of the sequence, shape [D], for other places of the same kind."""
        dimension, count = self.domain.dimension, len(self.time)
        shares = np.arange(count)[:, None] * STEPS[dimension] + np.broadcast_to(phase, dimension)[-2:]
        shares -= np.floor(shares)
        across, height, some = np.zeros(count), np.zeros(count), max(1, PORTION // len(self.bed))
        for part in (slice(first, first + some) for first in range(0, count, some)):
            depth = np.maximum(self.level[part, None] - self.bed, 0.0)
            passed = np.cumsum(depth, axis=1)
            area = (1.0 - ROUNDING) * shares[part, 0] * passed[:, -1]
            strip = (passed <= area[:, None]).sum(axis=1)
            local_depth, until_its_end = depth[np.arange(len(strip)), strip], passed[np.arange(len(strip)), strip]
            across[part] = strip + 1.0 - (until_its_end - area) / local_depth
            height[part] = self.bed[strip] + shares[part, 1] * local_depth
        across = (across / len(self.bed) - 0.5) * self.width
        places = (self.foot + across[:, None] * self.along + height[:, None] * self.up)[:, :dimension]
        if self.ground is not None:
            # Within a strip the ground may be higher than in its middle.
            floor = elevation(self.ground, self.domain, places[:, plan_axes(dimension)])
            places[:, 1] = np.maximum(places[:, 1], floor + TOUCHING)
        return places


def until(hydrograph: Rows, end: float, key: str) -> Rows:
    """The rows of a hydrograph up to a time [s]. Raises InputError for an invalid hydrograph."""
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
    last = [end, *(float(np.interp(end, time, column)) for column in (discharge, speed))]
    return (*map(tuple, rows.T[time < end].tolist()), tuple(last))


def inflow(mass: Mass, domain: Domain, ground: Solids, share: float, key: str) -> Inflow:
    """The inflow of a mass of kind inflow, in particles of about `share` [m]. Raises InputError."""
    hydrograph = np.array(mass.hydrograph) * [1.0, mass.discharge_factor or 1.0, 1.0]
    level = plan_axes(domain.dimension)
    ends, grounded = foot_of(mass, domain, ground, share, key)
    foot, width = ends.mean(axis=0), float(np.linalg.norm(ends[1] - ends[0]))
    along, strips = (ends[1] - ends[0]) / width, max(1, round(width / share)) if domain.dimension == 3 else 1
    line = foot + (((np.arange(strips) + 0.5) / strips - 0.5) * width)[:, None] * along
    flow = direction_of(mass, domain, ground if grounded else (), line, along, key)
    up = np.cross(flow, along)
    up *= 1.0 if up[1] >= 0.0 else -1.0
    require(up[1] > ASKEW, f"{key}.direction", "one that is not vertical", flow[: domain.dimension].tolist())
    bed = np.zeros(strips)
    low, high = np.full((2, strips), [[-domain.size[1] / up[1]], [domain.size[1] / up[1]]])
    for _ in range(HALVINGS if grounded else 0):
        bed = 0.5 * (low + high)
        places = line + bed[:, None] * up
        buried = places[:, 1] < elevation(ground, domain, places[:, level])
        low, high = np.where(buried, bed, low), np.where(buried, high, bed)
    time, discharge, _ = hydrograph.T
    passed = np.append(0.0, np.cumsum(0.5 * np.diff(time) * (discharge[1:] + discharge[:-1])))
    count = max(1, round(passed[-1] / share**domain.dimension))
    instead = f"it has {count:.3g} of them; larger cells or fewer particles_per_axis"
    require_memory(PARTICLE * count, "the particles of an inflow", instead, key=key)
    entered = (np.arange(count) + 0.5) * passed[-1] / count
    row = np.clip(np.searchsorted(passed, entered, side="right") - 1, 0, len(time) - 2)
    missing, before = entered - passed[row], discharge[row]
    rising = (np.diff(discharge) / np.diff(time))[row]
    # The root of missing = before t + rising t^2 / 2 in a form that is exact even for rising = 0.
    time = time[row] + 2.0 * missing / (before + np.sqrt(np.maximum(before**2 + 2.0 * rising * missing, 0.0)))
    area = np.interp(time, *hydrograph[:, :2].T) / np.interp(time, *hydrograph[:, ::2].T)
    # A level at the height of a strip covers all lower ones; above the highest, the area grows with the whole width.
    heights = np.sort(bed)
    heights = np.append(heights, heights[-1] + area.max() / width)
    areas = np.append(0.0, np.cumsum(width / strips * np.arange(1, strips + 1) * np.diff(heights)))
    section: dict[str, Any] = {"foot": foot, "flow": flow, "along": along, "up": up, "bed": bed, "width": width}
    enters: dict[str, Any] = {"volume": float(passed[-1]), "time": time, "level": np.interp(area, areas, heights)}
    inlet = Inflow(domain=domain, ground=ground if grounded else None, hydrograph=hydrograph, **section, **enters)
    expected = f"a depth, discharge over speed and width, of at least a particle, {share:.3g} m"
    require(inlet.depth >= share, f"{key}.hydrograph", expected, f"{inlet.depth:.3g} m at most")
    return inlet


def foot_of(mass: Mass, domain: Domain, ground: Solids, share: float, key: str) -> tuple[Floats, bool]:
    """Both ends of the foot of a section [m], shape [2, 3], and whether it lies on the ground."""
    dimension, rows, key = domain.dimension, mass.section or (), f"{key}.section"
    grounded = bool(rows) and len(rows[0]) == dimension - 1
    check_rows(rows, key, dimension - int(grounded), least=dimension - 1)
    require(len(rows) == dimension - 1, key, f"{dimension - 1} rows", len(rows))
    ends, level = np.array(rows), plan_axes(dimension)
    if grounded:
        ends = np.insert(ends, 1, elevation(ground, domain, ends.mean(axis=0, keepdims=True)), axis=1)
    inside = (ends >= -TOLERANCE).all() and (ends <= np.array(domain.size) + TOLERANCE).all()
    require(bool(inside), key, f"a section inside the domain {list(domain.size)}", ends.tolist())
    if dimension == 2:
        ends = np.array([[*ends[0], -0.5], [*ends[0], 0.5]])
    width = float(np.linalg.norm(ends[1] - ends[0]))
    wide = dimension == 2 or width >= share
    require(wide, key, f"a section of at least a particle, {share:.3g} m, across", f"{width:.3g} m")
    places = np.linspace(ends[0], ends[1], max(2, round(width / share)))
    above = float((places[:, 1] - elevation(ground, domain, places[:, level])).min())
    require(grounded or above >= -TOUCHING, key, "a section above the ground", f"one {-above:.3g} m below")
    return ends, grounded


def direction_of(mass: Mass, domain: Domain, ground: Solids, line: Floats, along: Floats, key: str) -> Floats:
    """The unit vector of the velocity, shape [3]: as given, else across the section, whose places are `line` [S, 3],
    and downslope along the ground beneath; on level ground, the direction with the larger x."""
    key = f"{key}.direction"
    if mass.direction is not None:
        check_vector(mass.direction, key, domain.dimension)
        flow = np.pad(np.array(mass.direction), (0, 3 - domain.dimension))
        across = bool(np.any(flow)) and bool(abs(flow @ along) <= ASKEW * np.linalg.norm(flow))
        require(across, key, "a vector at right angles to the section", list(mass.direction))
        flow -= (flow @ along) * along
    else:
        flow = np.array([along[2], 0.0, -along[0]]) / np.hypot(along[0], along[2])
        steps = ((line + way * domain.cell * flow)[:, plan_axes(domain.dimension)] for way in (-1.0, 1.0))
        behind, ahead = (elevation(ground, domain, places) for places in steps)
        flow[1] = float(np.mean(ahead - behind)) / (2.0 * domain.cell)
        level = abs(flow[1]) <= TOLERANCE
        defined = not level or abs(flow[0]) > ASKEW
        require(defined, key, "the direction of the flow through a section on level ground", "none")
        flow *= -1.0 if (flow[0] < 0.0 if level else flow[1] > 0.0) else 1.0
    return np.asarray(flow / np.linalg.norm(flow))
