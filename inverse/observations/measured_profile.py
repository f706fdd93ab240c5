"""Measured profiles: rows of x and height, converted to heights above the floor and checked against the release.

    h = (height - datum) in metres;    |1 - A / A0| within a bound,  A = int h dx,  A0 = released volume over the width

A profile that stops before its end is extrapolated linearly over at most two row distances; a longer rest is an error.
It may end at a solid: material beyond does not count then. In a gap of empty rows, the profile and the model are both
linear, and the area that this removes or adds is not compared.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from datasets.errors import InputError, require
from datasets.geometry.ground import elevation
from datasets.geometry.surface import closed_body, solids_of
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from inverse.observations.errors import Noise
from inverse.observations.observation import Between


class Heights(StrEnum):
    """The meaning of the heights of a measured profile."""

    EQUIVALENT = "equivalent"  # of the released volume at its initial density, over the length and the width
    SURFACE = "surface"  # of the deposit's surface above the ground; the deposit may be looser than the release
    ELEVATION = "elevation"
    """Of the deposit's surface above the datum, over terrain: the ground beneath it is subtracted (2D)."""


EDGE = 0.01  # height over the largest, below which a deposit has ended
FURTHEST = 2.0  # largest extrapolation of a profile, in distances of the last two rows
ALONG = 4  # rows that give the slope of an extrapolation: with two, noise would dominate
BELOW = 0.05  # height over the largest, by which noise may put a row beneath the floor; it counts as 0
RARE = 0.05  # a roughness that chance exceeds less often than this is more than the stated noise
MINIMUM_FREEDOM = 4  # fewer rows than twice this give no roughness, because the profile's shape contributes to it
AREA = {Heights.EQUIVALENT: (0.9, 1.1), Heights.SURFACE: (0.9, 1.25), Heights.ELEVATION: (0.9, 1.25)}
"""Area of a profile over the released one: sand of porosity 0.38 that comes to rest at 0.45 takes an eighth more."""


def require_inside(x: Floats, length: float) -> Floats:
    """`x` [m], if they lie in the box of `length` [m]. Raises InputError."""
    slack = 1e-9 * length
    outside = x[(x < -slack) | (x > length + slack)]
    if len(outside):
        got = f"got {outside[-1]:g} m; check `unit`, the unit of the file"
        raise InputError(f"expected x between the walls, 0 and {length:g} m, {got}")
    return x


@dataclass(frozen=True, kw_only=True)
class MeasuredProfile:
    """Heights above the floor at ascending x, from one edge of the deposit, or wall, to the other."""

    x: Floats  # [m], shape [R]
    height: Floats  # [m], shape [R]
    gaps: NDArray[np.bool_] | None = None
    """Whether rows are missing between each row and the next one, shape [R - 1]; default: nowhere."""
    ends: tuple[float, float] | None = None
    """The walls or solids [m] between which the profile lies; default: the walls of the box."""

    def at(self, stations: Floats) -> Floats:
        """Heights [m] at `stations` [m], linear in between, 0 beyond; shape [S]."""
        return np.asarray(np.interp(stations, self.x, self.height, left=0.0, right=0.0))

    def deviation(self, noise: Noise) -> Floats:
        """Standard deviation of each height [m], shape [R]; 0 where the ground is bare on both sides."""
        covered = self.height > 0.0
        edge = np.concatenate([[False], covered[:-1]]) | np.concatenate([covered[1:], [False]])
        return np.asarray(np.where(covered | edge, noise.of(self.height), 0.0))

    def roughness(self, deviation: Floats) -> float:
        """Scatter of the heights about the line through their neighbours, over `deviation` [m], shape [R]; at least 1.

        e_i = h_i - (b h_(i-1) + a h_(i+1)) / (a + b), a and b the distances to them: the pseudo-residuals of Gasser,
        Sroka & Jennen-Steinmetz (Residual variance and residual pattern in nonlinear regression, Biometrika 73 (1986)
        625-633), without a model. Only a scatter that chance exceeds less often than `RARE` counts; their sum of
        squares has roughly half as many degrees of freedom as a sum of independent ones."""
        if len(self.x) < 3:
            return 1.0
        before, after = self.x[1:-1] - self.x[:-2], self.x[2:] - self.x[1:-1]
        left, right = after / (before + after), before / (before + after)
        residual = self.height[1:-1] - left * self.height[:-2] - right * self.height[2:]
        variance = deviation[1:-1] ** 2 + (left * deviation[:-2]) ** 2 + (right * deviation[2:]) ** 2
        # Rows of bare ground on both sides do not scatter.
        scattering = (self.height[1:-1] > 0.0) & (variance > 0.0)
        if self.gaps is not None:
            scattering &= ~(self.gaps[1:] | self.gaps[:-1])
        freedom = 0.5 * int(scattering.sum())
        if freedom < MINIMUM_FREEDOM:
            return 1.0
        square = float(np.mean(residual[scattering] ** 2 / variance[scattering]))
        return math.sqrt(square) if chi2.sf(square * freedom, freedom) < RARE else 1.0


def checked_profile(x: Floats, height: Floats, scene: Scene, heights: Heights, released: Between) -> MeasuredProfile:
    """The profile of rows [m], both of shape [R]; its area is compared with the `released` one [m^2]. With gaps (NaN)
    or an end at a solid, the known area may be smaller. Raises InputError for rows that form no profile, lie outside
    the box, end within the deposit or have another area."""
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(height))
    require(len(rows) > 1, "", "at least two rows with an x and a height", len(rows))
    x, height, gaps = x[rows], height[rows], np.diff(rows) > 1
    if len(falls := np.flatnonzero(np.diff(x) <= 0.0)):
        raise InputError(f"expected x in ascending order, got {x[falls[0] + 1]:g} m after {x[falls[0]]:g} m")
    require_inside(x, scene.domain.size[0])
    if heights is Heights.ELEVATION:
        require(scene.dimension == 2, "heights", "heights above the ground in 3D", "elevations")
        height = height - elevation(scene.solids, scene.domain, x[:, None])
    got = "datum is the floor's in the file"
    require(height.max() > 0.0, "", "a height above the floor", f"none; {got}")
    tall = scene.domain.size[1]
    require(height.max() <= tall, "", f"heights up to that of the box, {tall:g} m", f"{height.max():.4g} m; check unit")
    least = height.min()
    require(least >= -BELOW * height.max(), "", "heights above the floor", f"{least:g} m; {got}")
    profile = closed(x, np.maximum(height, 0.0), gaps, scene)
    pieces = 0.5 * (profile.height[1:] + profile.height[:-1]) * np.diff(profile.x)
    area = float(pieces.sum() if profile.gaps is None else pieces[~profile.gaps].sum())
    low, high = AREA[heights]
    low = low if profile.gaps is None and profile.ends is None else 0.0
    (least, most), known = released, released[0] == released[1]
    which = f"{least:.4g} m^2" if known else f"{least:.4g} to {most:.4g} m^2 within the bounds"
    expected = f"{low:g} to {high:g} times the area that was released, {which}, for {heights} heights"
    got = f"{area:.4g} m^2{f', {area / least:.3g} times' if known else ''}; check unit, datum and heights"
    require(low * least <= area <= high * most, "", expected, got)
    return profile


def closed(x: Floats, height: Floats, gaps: NDArray[np.bool_], scene: Scene) -> MeasuredProfile:
    """The profile from one wall, solid or edge of the deposit to the other. Raises InputError if they are too far. If
    the deposit continues at an end, it is extrapolated along its last rows, towards larger x only downwards."""
    rows, open_rows, ends = [*zip(x, height, strict=True)], gaps.tolist(), [0.0, scene.domain.size[0]]
    solids = faces(scene)
    for number, side in ((0, 1), (1, -1)):
        inwards, heights, wall = x[::side], height[::side], ends[number]
        last_x, last = inwards[0], heights[0]
        if last <= EDGE * height.max():
            continue
        # The nearest face opposite the end.
        reached = [span[1 - number] for span in solids if side * (last_x - span[1 - number]) >= -1e-6]
        face = side * max(side * place for place in (*reached, wall))
        gap = side * (last_x - face)
        if gap > 1e-6:
            off = inwards[:ALONG] - inwards[:ALONG].mean()
            fall = side * float(off @ heights[:ALONG] / (off @ off))
            fall = fall if side > 0 else max(fall, 0.0)
            step = min(gap, last / fall) if fall > 0.0 else gap
            if step > FURTHEST * abs(inwards[1] - last_x) * (1.0 + 1e-9):
                where = f"the wall at x = {wall:g} m" + (f", the solid at x = {face:g} m" if face != wall else "")
                raise InputError(
                    f"expected rows as far as {where} or the edge of the deposit, the profile ends at "
                    f"x = {last_x:g} m with a height of {last:g} m"
                )
            rows.insert(0 if side > 0 else len(rows), (last_x - side * step, max(0.0, last - fall * step)))
            open_rows.insert(0 if side > 0 else len(open_rows), False)
            gap -= step
        if gap <= 1e-6:
            ends[number] = face
    (x, height), missing = np.array(rows).T, np.array(open_rows) if any(open_rows) else None
    within = None if ends == [0.0, scene.domain.size[0]] else (ends[0], ends[1])
    return MeasuredProfile(x=x, height=height, gaps=missing, ends=within)


def faces(scene: Scene) -> list[tuple[float, float]]:
    """The smallest and largest x of each baffle and each solid other than terrain [m]."""
    standing = [pair for pair in zip(*solids_of(scene), strict=True) if pair[0].kind != "terrain"]
    rows = [closed_body(solid, key, scene.domain).vertices[:, 0] for solid, key in standing]
    return [(float(x.min()), float(x.max())) for x in rows]
