"""Measures of a deposit: runout, front, toe, profile, thickness, bulk; and distances between two deposits.

Every function takes the positions of one moment [m], shape [N, D]; volumes are those of the particles [m^D], shape [N].

The front is a quantile of the volume along x. The sample quantile scatters with single particles; here it comes from
the least-squares fit of

    x(p) = c + a sqrt(1 - p) + b (1 - p),    p in `TAIL`,

to the quantile function of the sample, the x behind which a share p of the volume lies. A wedge has b = 0 (its volume
ahead of x falls with the square of the distance to its tip), a block a = 0. A particle is a step of the quantile
function as wide as its volume, so that the fit is continuous in the positions. The furthest 0.1 % is ignored.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.ground import elevation
from datasets.scene import Scene

FRONT_QUANTILE = 0.995
TAIL = (0.98, 0.999)
"""Shares of the volume p between which the front is fitted [-]."""
TOE_FRACTION = 0.10
AT_WALL = 0.01
"""A front within this share of the box's length from the wall ahead touches the wall, which then limits all fronts."""
OUTLINE = 0.1
"""Thickness over a deposit's largest, above which a place in plan is covered [-]."""
AFTER = 4
"""Time, in durations of the flow, until which a deposit must stay in place (`creep`)."""
SHARES = 20
"""Number of parts of equal volume whose places along x are compared between two deposits."""
COLUMN = 3.0
"""Width of the columns in which two deposits are compared, over the larger distance between their particles [-]."""
FACTORS = {"%": 100.0, "mm/s": 1000.0}
"""Unit of tables -> number of these units in one SI unit."""

Positions = NDArray[np.floating]
Volumes = NDArray[np.floating]
Floats = NDArray[np.float64]
Ground = Callable[[Floats], Floats]
"""Elevation [m], shape [N], at places in plan [m], shape [N, D - 1]."""


def runout(positions: Positions) -> float:
    """d, the largest x [m], measured from the left wall."""
    return float(positions[:, 0].max())


def front(positions: Positions, volume: float | Volumes = 1.0) -> float:
    """The x [m] that 99.5 % of the volume is behind, by a fit, at most the runout; volume: one for all or shape [N].
    With a gap before a few particles, the unlimited fit could leave the box."""
    x = positions[:, 0].astype(np.float64)
    order = np.argsort(x)
    return min(float((tail_weights(np.broadcast_to(volume, x.shape)[order]) * x[order]).sum()), float(x.max()))


def extents(scene: Scene, positions: Positions, volume: float | Volumes) -> dict[str, Any]:
    """`runout`, `front` and `toe` [m] of a summary, in map coordinates if the box of the scene has an origin."""
    corner = scene.domain.corner
    return {
        "runout": float(corner[0] + runout(positions)),
        "front": float(corner[0] + front(positions, volume)),
        "toe": (corner + toe(positions)).tolist(),
    }


def tail_weights(volume: Volumes) -> Floats:
    """Weights w [-], shape [N], such that sum_i w_i x_i is the front of particles sorted by x. volume: of the particles
    in this order. w_i is the integral of the fit's weight over the particle's step."""
    behind = np.append(0.0, np.cumsum(volume, dtype=np.float64))
    ahead = 1.0 - np.clip(behind / behind[-1], *TAIL)
    powers = np.array([0.0, 0.5, 1.0])
    products = np.subtract(*(_integral(1.0 - share, powers[:, None] + powers) for share in TAIL))
    fitted = np.linalg.solve(products, (1.0 - FRONT_QUANTILE) ** powers)
    return np.asarray(-np.diff(_integral(ahead[:, None], powers) @ fitted))


def _integral(ahead: float | Floats, power: Floats) -> Floats:
    """Integral of s^power over s = 1 - p from 0 to `ahead` [-]."""
    return np.asarray(ahead ** (power + 1.0) / (power + 1.0))


def toe(positions: Positions) -> tuple[float, ...]:
    """Centroid [m] of the furthest 10 % of the particles, shape [D]."""
    count = max(1, math.ceil(TOE_FRACTION * len(positions)))
    furthest = np.argpartition(positions[:, 0], -count)[-count:]
    return tuple(float(x) for x in positions[furthest].mean(axis=0, dtype=np.float64))


def profile_stations(scene: Scene, spacing: float) -> Floats:
    """The x [m] of a height profile's stations in `scene`, about `spacing` apart, including walls; shape [S]."""
    length = scene.domain.size[0]
    return np.linspace(0.0, length, round(length / spacing) + 1)


def height_profile(positions: Positions, volume: float | Volumes, stations: Floats) -> Floats:
    """Height of the deposit at its initial density, per station [m], shape [S].

    The volume of the particles (`volume` [m^D] each, one for all or shape [N]) is shared linearly between the two
    nearest stations and divided by the length of a station (half at the walls). This conserves volume and is continuous
    in the positions. In 3D the volume is summed over z, so divide by the width for a mean height.
    """
    spacing = stations[1] - stations[0]
    coordinate = np.clip((positions[:, 0].astype(np.float64) - stations[0]) / spacing, 0.0, len(stations) - 1.0)
    left = np.minimum(coordinate.astype(np.int64), len(stations) - 2)
    share = coordinate - left
    height = np.bincount(left, volume * (1.0 - share), minlength=len(stations))
    height += np.bincount(left + 1, volume * share, minlength=len(stations))
    length = np.full(len(stations), spacing)
    length[[0, -1]] *= 0.5
    return np.asarray(height / length)


def ends(positions: Positions, volume: Volumes) -> tuple[float, float]:
    """The x [m] that 0.5 % and that 99.5 % of the volume is behind: the rear and the front of a deposit."""
    return -front(-positions, volume), front(positions, volume)


def equal_shares(positions: Positions, volume: Volumes) -> Floats:
    """The x [m] of the middles of `SHARES` equal parts of a deposit's volume, from the rear, shape [SHARES]."""
    x = positions[:, 0].astype(np.float64)
    order = np.argsort(x, kind="stable")
    whole = volume[order].astype(np.float64)
    passed = np.cumsum(whole) - 0.5 * whole
    return np.asarray(np.interp((np.arange(SHARES) + 0.5) / SHARES * whole.sum(), passed, x[order]))


def transport_distance(positions: Positions, volume: Volumes, others: Positions, other_volume: Volumes) -> float:
    """Distance along x between equal volume shares of two deposits, rms over the shares [m]."""
    return rms(equal_shares(positions, volume) - equal_shares(others, other_volume))


def particle_spacing(volume: Volumes, dimension: int) -> float:
    """Mean distance s between neighbours [m]: the edge of a cube of their mean volume."""
    return float(np.mean(volume) ** (1.0 / dimension))


def ground_of(scene: Scene) -> Ground:
    """The ground of a scene: the highest terrain, or the floor; baffles and other solids are not ground."""
    return partial(elevation, scene.solids, scene.domain)


def above(positions: Positions, ground: Ground) -> Floats:
    """The positions with heights above the ground below each [m], shape [N, D]."""
    raised = positions.astype(np.float64)
    raised[:, 1] -= ground(raised[:, ::2])
    return raised


def mean_height(positions: Positions, volume: Volumes) -> float:
    """Mean height of the volume [m], sum_i V_i y_i / sum_i V_i: the potential energy over the weight."""
    return float(np.average(positions[:, 1].astype(np.float64), weights=volume))


def thickness(positions: Positions, spacing: float, column: float, plan: Sequence[float]) -> Floats:
    """Thickness of a deposit in columns of its plan [m], shape [X], in 3D [X, Z]: the top of the highest particle,

        h(c) = max over i in c of y_i, plus s / 2,    0 in columns without particles.

    positions: with y from the ground (`above`); spacing: s [m], between neighbours; column: width of the columns [m],
    from the corner x = z = 0 on; plan: level lengths of the box [m], beyond which particles do not count.
    """
    counts = [max(1, math.ceil(length / column - 1.0e-6)) for length in plan]
    level, heights = positions[:, ::2], np.zeros(counts)
    within = ((level >= 0.0) & (level <= np.array(plan))).all(axis=1)
    place = np.minimum((level[within] / column).astype(np.int64), np.array(counts) - 1)
    np.maximum.at(heights, tuple(place.T), positions[within, 1] + 0.5 * spacing)
    return heights


def bulk(positions: Positions, spacing: float, own_volume: float, column: float) -> float:
    """Volume under the surface of a deposit over that of its particles [-]; 1 without gaps between them.

        sum_c h(c) w^(D - 1) / V,    h: `thickness`

    positions: with y from the ground; own_volume: V [m^D], of all these particles; column: w [m], a cell or two. The
    highest particle represents the whole column, which adds w tan(slope) / 2 to the mean thickness.
    """
    corner = column * np.floor(positions[:, ::2].min(axis=0).astype(np.float64) / column)
    moved = positions.astype(np.float64)
    moved[:, ::2] -= corner
    heights = thickness(moved, spacing, column, moved[:, ::2].max(axis=0).tolist())
    return float(heights.sum() * column ** (positions.shape[1] - 1) / own_volume)


def overlap(one: Floats, other: Floats) -> float:
    """Common plan area of two deposits over the area of their union [-], from their thickness in the same columns. A
    column is covered if it is thicker than `OUTLINE` times the largest thickness of the first."""
    covered, its = one > OUTLINE * one.max(), other > OUTLINE * one.max()
    return 1.0 - int((covered ^ its).sum()) / max(1, int((covered | its).sum()))


def error(title: str, unit: str = "%", *, exact: float = 0.0, signed: bool = False, **default: Any) -> Any:
    """A field of `Errors`: its title in tables, a unit of `FACTORS`, its exact value, whether it has a sign. Tables,
    logs and cards of models take their columns from these: to add an error is to add its field."""
    return field(metadata={"title": title, "unit": unit, "exact": exact, "sign": "+" if signed else ""}, **default)


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one deposit against another, the reference [-]; nan if not meaningful."""

    front: float = error("front", signed=True)
    """Front minus the reference's, over the extent from its rear to its front; see `Deposit.side`."""
    profile: float = error("profile")
    """`transport_distance` over the extent: compares places along x, not heights."""
    height: float = error("mean height", signed=True)
    """`mean_height` minus the reference's, over the reference's."""
    thickness: float = error("thickness")
    """Difference in `thickness`, rms over the columns where either deposit lies, over the reference's largest."""
    overlap: float = error("overlap in plan", exact=1.0)
    """`overlap` in plan, in 2D along x; 1 if the outlines are equal."""
    creep: float = error("creep", "mm/s", default=math.nan)
    """`creep` of the deposit after the flow [m/s]."""


def amounts(errors: Sequence[Errors]) -> dict[str, float]:
    """Name -> mean absolute value of each error; nan if none is known."""
    values = {name: np.abs(signed) for name, (signed, _) in columns(errors).items()}
    return {name: float(amount.mean()) if len(amount) else math.nan for name, amount in values.items()}


def summary(errors: Sequence[Errors]) -> dict[str, str]:
    """Title -> the same as text, with the worst value: `1.2 % (+3.4)`; a dash if none is known."""
    texts = {}
    for values, about in columns(errors).values():
        factor, words = FACTORS[about["unit"]], "-"
        if len(values):
            worst = values[np.abs(values - about["exact"]).argmax()]
            words = f"{factor * np.abs(values).mean():.1f} {about['unit']} ({factor * worst:{about['sign']}.1f})"
        texts[about["title"]] = words
    return texts


def columns(errors: Sequence[Errors]) -> dict[str, tuple[Floats, Mapping[str, Any]]]:
    """Name -> the known values of each error, shape [n], and its metadata from `error`."""
    by_name: dict[str, tuple[Floats, Mapping[str, Any]]] = {}
    for column in (column for column in fields(errors[0]) if column.metadata):
        values = np.array([getattr(record, column.name) for record in errors])
        by_name[column.name] = values[~np.isnan(values)], column.metadata
    return by_name


@dataclass(frozen=True, kw_only=True)
class Deposit:
    """The deposit of a flow, with which others are compared."""

    positions: Positions
    """Positions [m], shape [N, D]."""
    volume: Volumes
    """Volumes of the particles [m^D], shape [N]."""
    size: tuple[float, ...]
    """Size of the box [m], shape [D]."""
    ground: Ground
    """The ground beneath it."""
    x: tuple[float, float]
    """The x of its ends, the smaller and the larger one [m]."""
    side: int
    """The end that the flow has moved farther, 0 or 1: the front."""

    @staticmethod
    def of_positions(
        start: Positions, end: Positions, volume: Volumes, size: tuple[float, ...], ground: Ground
    ) -> "Deposit":
        """The deposit of particles that moved from `start` to `end` [m], both [N, D]."""
        before, after = ends(start, volume), ends(end, volume)
        side = int(after[1] - before[1] >= before[0] - after[0])
        return Deposit(positions=end, volume=volume, size=size, ground=ground, x=after, side=side)

    @property
    def extent(self) -> float:
        """Distance of the two ends [m]."""
        return self.x[1] - self.x[0]

    @property
    def front(self) -> float:
        """The x of the front [m]."""
        return self.x[self.side]

    @property
    def at_wall(self) -> bool:
        """Whether the front touches the wall ahead, which then limits all fronts."""
        return (self.size[0] - self.front if self.side == 1 else self.front) < AT_WALL * self.size[0]

    def errors(self, positions: Positions, volume: Volumes) -> Errors:
        """The errors of another deposit of the same scene; without material in the box, thickness is over a spacing."""
        beyond = ends(positions, volume)[self.side] - self.front
        deposits = ((self.positions, self.volume), (positions, volume))
        raised = [above(places, self.ground) for places, _ in deposits]
        spacings = [particle_spacing(volumes, len(self.size)) for _, volumes in deposits]
        column = COLUMN * max(spacings)
        reference, other = (thickness(*pair, column, self.size[::2]) for pair in zip(raised, spacings, strict=True))
        return Errors(
            front=(beyond if self.side == 1 else -beyond) / self.extent,
            profile=transport_distance(positions, volume, self.positions, self.volume) / self.extent,
            height=mean_height(raised[1], volume) / mean_height(raised[0], self.volume) - 1.0,
            thickness=thickness_apart(reference, other) / (float(reference.max()) or max(spacings)),
            overlap=overlap(reference, other),
        )


def thickness_apart(one: Floats, other: Floats) -> float:
    """Difference of two thicknesses [m] in the same columns, rms over those where either deposit lies."""
    somewhere = (one > 0.0) | (other > 0.0)
    return rms((other - one)[somewhere]) if somewhere.any() else 0.0


def creep(positions: Positions, step: float) -> float:
    """Speed of a deposit [m/s] in a run until `AFTER` times the duration of its flow: rms displacement of the particles
    after the flow, over that time. positions: [m], shape [T, N, D]; step: between two of them [s]."""
    steps = (len(positions) - 1) // AFTER
    return rms(np.linalg.norm(positions[-1] - positions[steps], axis=1)) / ((len(positions) - 1 - steps) * step)


def rms(values: NDArray[np.floating]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values.astype(np.float64) ** 2)))
