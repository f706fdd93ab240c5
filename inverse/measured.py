"""A measured profile: rows x and height of a CSV, made heights above the floor and held against what was released.

    h = (height - datum) in metres;    |1 - A / A0| within a bound,  A = int h dx,  A0 = released volume over the width

What the rows leave open at their ends is extrapolated linearly over at most two distances of rows, else asked for.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from inverse.settings import Heights, TargetSettings

Floats = NDArray[np.float64]

EDGE = 0.01
"""Height over the largest, below which a deposit has ended."""
FURTHEST = 2.0
"""Distances of the last two rows over which a profile is extrapolated."""
BELOW = 0.05
"""Height over the largest, by which noise may put a row beneath the floor; it counts as 0."""
AREA = {Heights.EQUIVALENT: (0.9, 1.1), Heights.SURFACE: (0.9, 1.25)}
"""Area of a profile over the released one: what a measurement may miss, and of a surface also what loosening adds.

Sand that is released dense, at a porosity of 0.38, and comes to rest loose, at 0.45, takes up an eighth more.
"""


@dataclass(frozen=True, kw_only=True)
class MeasuredProfile:
    """Heights above the floor at ascending x, from the edge of the deposit, or a wall, to the other."""

    x: Floats
    """[m], shape [R]."""
    height: Floats
    """[m], shape [R]."""

    def at(self, stations: Floats) -> Floats:
        """Heights [m] at `stations` [m], linear in between, 0 beyond; shape [S]."""
        return np.asarray(np.interp(stations, self.x, self.height, left=0.0, right=0.0))

    def deviation(self, *, share: float, noise: float) -> Floats:
        """Standard deviation [m] of each height, shape [R]: a `share` of it and, for all alike, `noise` [m].

        Where the ground is bare, and beside it, there is no deposit to be mistaken about.
        """
        covered = self.height > 0.0
        edge = np.concatenate([[False], covered[:-1]]) | np.concatenate([covered[1:], [False]])
        return np.asarray(np.where(covered | edge, np.hypot(share * self.height, noise), 0.0))


def read_profile(folder: Path, settings: TargetSettings, length: float, released: float) -> MeasuredProfile:
    """The profile of `settings.csv` in a box of `length` [m], of a body of the area `released` [m^2].

    Raises InputError, which names the file, for rows that are no profile, lie outside of the box, end in the middle of
    the deposit, or hold another area than was released.
    """
    path = folder / str(settings.csv)
    try:
        x, height = read_rows(path)
        metres = settings.unit.metres
        x, height = x * metres, (height - settings.datum) * metres
        check_box(x, length)
        check_heights(height)
        profile = closed(x, np.maximum(height, 0.0), length)
        check_area(profile, settings.heights, released)
        return profile
    except InputError as error:
        raise error.at(str(path)) from None


def read_rows(path: Path) -> tuple[Floats, Floats]:
    """The columns x and height as they stand in the file, each of shape [R]. Raises InputError."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except FileNotFoundError:
        raise InputError("expected a measured profile (CSV), there is none") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"expected a readable CSV, {error}") from None
    if len(rows) < 2 or not {"x", "height"} <= rows[0].keys():
        raise InputError("expected the columns x and height and at least two rows")
    try:
        x, height = (np.array([float(row[column]) for row in rows]) for column in ("x", "height"))
    except (TypeError, ValueError):
        raise InputError("expected numbers in the columns x and height") from None
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(height)) and np.all(np.diff(x) > 0.0)):
        raise InputError("expected finite numbers, x in ascending order")
    return x, height


def check_box(x: Floats, length: float) -> None:
    """Raise InputError for an x [m] outside of the box."""
    slack = 1e-9 * length
    outside = x[(x < -slack) | (x > length + slack)]
    if len(outside):
        raise InputError(
            f"expected x between the walls, 0 and {length:g} m, got {outside[-1]:g} m; target.unit says in what unit "
            "the file is"
        )


def check_heights(height: Floats) -> None:
    """Raise InputError for heights [m] that are below the floor by more than noise, or nowhere above it."""
    if height.max() <= 0.0:
        raise InputError("expected a height above the floor, got none; target.datum is the floor's in the file")
    if height.min() < -BELOW * height.max():
        raise InputError(
            f"expected heights above the floor, got {height.min():g} m; target.datum is the floor's in the file"
        )


def closed(x: Floats, height: Floats, length: float) -> MeasuredProfile:
    """The profile with its ends at a wall or at the deposit's edge. Raises InputError where they are too far.

    An end at which the deposit goes on is extrapolated along its last two rows, towards larger x only downwards.
    """
    first = extrapolated(x[0], height[0], (height[1] - height[0]) / (x[1] - x[0]), x[1] - x[0], height.max())
    slope = (height[-1] - height[-2]) / (x[-1] - x[-2])
    last = extrapolated(length - x[-1], height[-1], -min(slope, 0.0), x[-1] - x[-2], height.max())
    for end, place, value, wall in ((first, x[0], height[0], 0.0), (last, x[-1], height[-1], length)):
        if end is None:
            raise InputError(
                f"expected rows as far as the wall at x = {wall:g} m or the edge of the deposit, the profile ends at "
                f"x = {place:g} m with a height of {value:g} m"
            )
    before = [(x[0] - way, h) for way, h in first or []]
    beyond = [(x[-1] + way, h) for way, h in last or []]
    rows = np.array([*before, *zip(x, height, strict=True), *beyond])
    return MeasuredProfile(x=rows[:, 0], height=rows[:, 1])


def extrapolated(
    gap: float, height: float, fall: float, spacing: float, largest: float
) -> list[tuple[float, float]] | None:
    """Rows (way beyond the last one, height) [m] at an end `gap` [m] from its wall; None where it is too far.

    height: of the last row [m]; fall: what the height loses per way towards the wall [-]; spacing: of the last rows
    [m]; largest: height of the deposit [m].
    """
    if height <= EDGE * largest or gap <= 0.0:
        return []
    way = min(gap, height / fall) if fall > 0.0 else gap
    if way > FURTHEST * spacing * (1.0 + 1e-9):
        return None
    return [(way, max(0.0, height - fall * way))]


def check_area(profile: MeasuredProfile, heights: Heights, released: float) -> None:
    """Raise InputError for a profile whose area is not what was released."""
    area = float(np.trapezoid(profile.height, profile.x))
    least, most = AREA[heights]
    if not least * released <= area <= most * released:
        raise InputError(
            f"expected {least:g} to {most:g} times the area that was released, {released:.4g} m^2, for {heights} "
            f"heights, got {area:.4g} m^2, {area / released:.3g} times; target.unit, datum and heights say what "
            "stands in the file"
        )
