"""What a deposit is judged by: runout, front, toe and height profile.

Every function takes the positions of one moment [m], shape [N, D].
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
    """The x [m] that 99.5 % of the points are behind: d without the fate of single points."""
    return float(np.quantile(positions[:, 0].astype(np.float64), FRONT_QUANTILE))


def toe(positions: Positions) -> tuple[float, ...]:
    """Centroid [m] of the furthest 10 % of the points, shape [D]."""
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

    The volume of the points (`volume` [m^D] each, one for all or shape [N]), shared linearly between the two nearest
    stations and divided by the length that a station stands for (half of it at the walls): conserves volume and is
    continuous in the positions. In 3D the volume is summed over z, so divide by the width for a mean height.
    """
    spacing = stations[1] - stations[0]
    place = np.clip((positions[:, 0].astype(np.float64) - stations[0]) / spacing, 0.0, len(stations) - 1.0)
    left = np.minimum(place.astype(np.int64), len(stations) - 2)
    share = place - left
    height = np.bincount(left, volume * (1.0 - share), minlength=len(stations))
    height += np.bincount(left + 1, volume * share, minlength=len(stations))
    length = np.full(len(stations), spacing)
    length[[0, -1]] *= 0.5
    return np.asarray(height / length)
