"""What a deposit is judged by: runout, front, toe and height profile.

Every function takes the positions of one moment [m], shape [N, D]; volumes are those of the particles [m^D], shape [N].

The front is a quantile of the volume along x. That of the sample scatters with single particles; here it is that of
the least-squares fit of

    x(p) = c + a sqrt(1 - p) + b (1 - p),    p in `TAIL`,

to the quantile function of the sample, the x that a share p of the volume is behind. A wedge has b = 0 (its volume
ahead of x falls with the square of the distance to its tip), a block a = 0. A particle is a step of the quantile
function as wide as its volume: the fit is continuous in the positions. The furthest 0.1 % of the volume do not count.
"""

import math

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Scene

FRONT_QUANTILE = 0.995
TAIL = (0.98, 0.999)
"""Shares of the volume p between which the front is fitted [-]."""
TOE_FRACTION = 0.10

Positions = NDArray[np.floating]


def runout(positions: Positions) -> float:
    """d, the largest x [m], measured from the left wall."""
    return float(positions[:, 0].max())


def front(positions: Positions, volume: float | NDArray[np.floating] = 1.0) -> float:
    """The x [m] that 99.5 % of the volume is behind, by a fit; volume: one for all or shape [N]."""
    x = positions[:, 0].astype(np.float64)
    order = np.argsort(x)
    return float((tail_weights(np.broadcast_to(volume, x.shape)[order]) * x[order]).sum())


def tail_weights(volume: NDArray[np.floating]) -> NDArray[np.float64]:
    """Weights w [-], shape [N], with which sum_i w_i x_i is the front of particles in the order of x.

    volume: of the particles in this order. w_i is the integral of the fit's weight over the particle's step.
    """
    behind = np.append(0.0, np.cumsum(volume, dtype=np.float64))
    ahead = 1.0 - np.clip(behind / behind[-1], *TAIL)
    powers = np.array([0.0, 0.5, 1.0])
    products = np.subtract(*(_integral(1.0 - share, powers[:, None] + powers) for share in TAIL))
    fitted = np.linalg.solve(products, (1.0 - FRONT_QUANTILE) ** powers)
    return np.asarray(-np.diff(_integral(ahead[:, None], powers) @ fitted))


def _integral(ahead: float | NDArray[np.float64], power: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of s^power over s = 1 - p from 0 to `ahead` [-]."""
    return np.asarray(ahead ** (power + 1.0) / (power + 1.0))


def toe(positions: Positions) -> tuple[float, ...]:
    """Centroid [m] of the furthest 10 % of the particles, shape [D]."""
    count = max(1, math.ceil(TOE_FRACTION * len(positions)))
    furthest = np.argpartition(positions[:, 0], -count)[-count:]
    return tuple(float(x) for x in positions[furthest].mean(axis=0, dtype=np.float64))


def profile_stations(scene: Scene, spacing: float) -> NDArray[np.float64]:
    """The x [m] at which a height profile of `scene` is given, about `spacing` apart, walls included; shape [S]."""
    length = scene.domain.size[0]
    return np.linspace(0.0, length, round(length / spacing) + 1)


def height_profile(
    positions: Positions, volume: float | NDArray[np.floating], stations: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Height of the deposit at its initial density, per station [m], shape [S].

    The volume of the particles (`volume` [m^D] each, one for all or shape [N]), shared linearly between the two nearest
    stations and divided by the length that a station stands for (half of it at the walls): conserves volume and is
    continuous in the positions. In 3D the volume is summed over z, so divide by the width for a mean height.
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


def ends(positions: Positions, volume: NDArray[np.floating]) -> tuple[float, float]:
    """The x [m] that 0.5 % and that 99.5 % of the volume is behind: the rear and the front of a deposit."""
    return -front(-positions, volume), front(positions, volume)


SHARES = 20
"""Parts of equal volume by whose places along x two deposits are compared."""


def equal_shares(positions: Positions, volume: NDArray[np.floating]) -> NDArray[np.float64]:
    """The x [m] of the middles of `SHARES` equal parts of a deposit's volume, from the rear on, shape [SHARES]."""
    x = positions[:, 0].astype(np.float64)
    order = np.argsort(x, kind="stable")
    whole = volume[order].astype(np.float64)
    passed = np.cumsum(whole) - 0.5 * whole
    return np.asarray(np.interp((np.arange(SHARES) + 0.5) / SHARES * whole.sum(), passed, x[order]))


def transport_distance(
    positions: Positions, volume: NDArray[np.floating], others: Positions, other_volume: NDArray[np.floating]
) -> float:
    """How far the parts of one deposit lie from those of another along x, rms over equal shares of the volume [m]."""
    return rms(equal_shares(positions, volume) - equal_shares(others, other_volume))


def rms(values: NDArray[np.floating]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values.astype(np.float64) ** 2)))
