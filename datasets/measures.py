"""What a deposit is judged by: runout, front, toe and height profile.

Every function takes the positions of one moment [m], shape [N, D]; volumes are those of the particles [m^D], shape [N].

The 99.5 % quantile of some 400 particles is the second of them, and scatters by 1 to 2 % of the extent with the choice
of the particles. `fitted_front` reads the same x from the whole tail, by least squares of

    x(p) = c + a sqrt(1 - p) + b (1 - p)

for the x that a share p of the volume is behind, evaluated at `FRONT_QUANTILE`. A wedge has b = 0 (its volume ahead of
x falls with the square of the distance to its tip), a block a = 0.
"""

import math

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Scene

FRONT_QUANTILE = 0.995
TOE_FRACTION = 0.10

Positions = NDArray[np.floating]


def runout(positions: Positions) -> float:
    """d, the largest x [m], measured from the left wall."""
    return float(positions[:, 0].max())


def front(positions: Positions) -> float:
    """The x [m] that 99.5 % of the particles are behind: d without the fate of single particles."""
    return float(np.quantile(positions[:, 0].astype(np.float64), FRONT_QUANTILE))


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


TAIL = np.linspace(0.97, 0.999, 30)
"""Shares of the volume p whose x the fit goes through [-]."""
FEWEST = 50
"""Particles of which the fit is made; of fewer the front is the quantile itself."""


def tail_weights(volume: NDArray[np.floating]) -> NDArray[np.float64]:
    """Weights w [-], shape [N], with which sum_i w_i x_(i) over particles in the order of x is their `fitted_front`.

    volume: of the particles in this order. x is linear in p between the middles of two particles' volumes.
    """
    whole = volume.astype(np.float64)
    middle = (np.cumsum(whole) - 0.5 * whole) / whole.sum()
    tail, part = np.array([FRONT_QUANTILE]), np.ones(1)
    if len(volume) >= FEWEST:
        tail, part = TAIL, _terms(np.array([FRONT_QUANTILE]))[0] @ np.linalg.pinv(_terms(TAIL))
    after = np.clip(np.searchsorted(middle, tail), min(1, len(middle) - 1), len(middle) - 1)
    before = np.maximum(after - 1, 0)
    step = np.where(after > before, middle[after] - middle[before], 1.0)
    share = np.clip((tail - middle[before]) / step, 0.0, 1.0)
    weights = np.zeros(len(middle))
    np.add.at(weights, before, part * (1.0 - share))
    np.add.at(weights, after, part * share)
    return weights


def _terms(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """1, sqrt(1 - p) and 1 - p of shares p [P], shape [P, 3]."""
    ahead = 1.0 - shares
    return np.stack((np.ones_like(ahead), np.sqrt(ahead), ahead), axis=1)


def fitted_front(positions: Positions, volume: NDArray[np.floating]) -> float:
    """The x [m] that 99.5 % of the volume is behind, by a fit through the tail."""
    x = positions[:, 0].astype(np.float64)
    order = np.argsort(x, kind="stable")
    return float(tail_weights(volume[order]) @ x[order])


def ends(positions: Positions, volume: NDArray[np.floating]) -> tuple[float, float]:
    """The x [m] that 0.5 % and that 99.5 % of the volume is behind: the rear and the front of a deposit, fitted."""
    return -fitted_front(-positions, volume), fitted_front(positions, volume)


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
    apart = equal_shares(positions, volume) - equal_shares(others, other_volume)
    return float(np.sqrt(np.mean(apart**2)))
