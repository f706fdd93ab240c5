"""Mohr-Coulomb plasticity with a tension cutoff, returned in principal stresses; branchless, for vectors of lanes.

Tension is positive, s1 >= s2 >= s3 are the principal stresses. Yield functions and flow potentials (Davis 1968; de
Souza Neto, Peric & Owen 2008, section 8.2), Coulomb's for every ordered pair of axes and Rankine's for every axis:

    F_ij = s_i (1 + sin phi) - s_j (1 - sin phi) - 2 c cos phi      G_ij = s_i (1 + sin psi) - s_j (1 - sin psi)
    F_i  = s_i - T                                                  G_i  = s_i

with the tension limit T = min(tension cutoff, c cot phi), for phi = 0 the cutoff alone: Tresca's prism. The return is
the backward Euler step of all nine surfaces together (Koiter 1953; Simo, Kennedy & Govindjee 1988): with isotropic
elasticity D (Lame constants lambda, mu),

    s = s_trial - sum_a g_a D dG_a/ds,    g_a >= 0,  F_a(s) <= 0,  g_a F_a(s) = 0.

Its solution is unique, piecewise linear and continuous in s_trial (by enumeration: `tests/mpm/test_return_map.py`). It
is the first of the following that no other surface excludes:

    A  the hexagon alone: the plane F_13, or an edge where F_13 meets F_23 or F_12, taken where s1 <= T;
    B  the cutoff alone: one, two or three stresses equal T, taken where F_13 <= 0;
    C  both: s1 = T, s3 = (T (1 + sin phi) - 2 c cos phi) / (1 - sin phi), and s2 follows elastically,
       s2 = s2_trial + nu (ds1 + ds3), for nothing yields along axis 2 until s2 meets s1 or s3; then it stays there.

On the plane dgamma = F / (4 [mu + (lambda + mu) sin phi sin psi]); an edge is a symmetric 2 x 2 system. A stress that
opens a crack relaxes the others by elastic coupling, lambda / (lambda + 2 mu) of its own decrease.

Without cohesion T = 0 is the apex: B and C give zero stress, taken where the mean of A is not below 0.

| symbol | variable |
|---|---|
| s1, s2, s3 | s1, s2, s3 |
| sin phi, sin psi | sin_phi, sin_psi |
| 2 c cos phi | strength |
| lambda, mu | lame, shear |
| T | limit |
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, auto
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from datasets.scene import Stage
from datasets.scene.material import Material
from datasets.schema import Record
from mpm.arrays.access import TINY, clamp, maximum, minimum
from mpm.arrays.layout import Property
from mpm.physics.inertial import sin_phi_at_rate

Floats = NDArray[np.float64]

OPENS = True
REDUCED = 1.0e-3  # reduction of sin(phi) for `nearest`, so that an iteration ends within yield after finite steps


@dataclass(frozen=True, kw_only=True)
class Parameters(Record):
    """None besides those of `datasets.scene.material`, with their units and bounds: all of Talus knows this law."""


class Column(IntEnum):
    """The properties of a particle for the law."""

    SIN_PHI = len(Property)  # [-]
    SIN_PSI = auto()  # [-]
    STRENGTH = auto()  # 2 c cos(phi) [Pa]
    LIMIT = auto()  # largest tensile stress [Pa]
    RESIDUAL_SIN_PHI = auto()  # [-]; from here on only if the material softens
    RESIDUAL_STRENGTH = auto()  # 2 c cos(phi) of the residual values [Pa]
    RESIDUAL_LIMIT = auto()  # [Pa]
    SOFTENING = auto()  # sqrt(3) / softening length [1/m], 0 where it does not soften
    SIN_PHI_LIMIT = auto()  # [-], 0 if friction does not depend on the rate; from here on only if it does
    INERTIAL_RATE = auto()  # I_0 / (d sqrt(rho_s)) [1/(s sqrt(Pa))]


PEAK = Column.SIN_PHI, Column.STRENGTH, Column.LIMIT
RESIDUAL = Column.RESIDUAL_SIN_PHI, Column.RESIDUAL_STRENGTH, Column.RESIDUAL_LIMIT


def features(materials: Sequence[Material], stages: Sequence[Stage]) -> dict[str, bool]:
    """The parts of the law that these materials need, at the start or after a stage."""
    return {
        "cohesive": any(material.cohesive for material in materials)
        or any(stage.cohesion or stage.strength_gradient for stage in stages),
        "dilates": any(material.dilation_deg for material in materials) or any(stage.dilation_deg for stage in stages),
        "softens": any(material.softening_length is not None for material in materials),
        "inertial": any(material.friction_limit_deg is not None for material in materials),
    }


def columns(features: Any) -> list[Column]:
    """The columns that `strengths` reads."""
    return [
        Column.SIN_PHI,
        *([Column.SIN_PSI] if features.dilates else []),
        *([Column.STRENGTH, Column.LIMIT] if features.cohesive else []),
        *([*RESIDUAL, Column.SOFTENING] if features.softens else []),
        *([Column.SIN_PHI_LIMIT, Column.INERTIAL_RATE] if features.inertial else []),
    ]


def properties(material: Material, depth: Floats, friction_deg: Floats | None) -> Floats:
    """Columns of particles at `depth` [m] below the top of their body, shape [N]; [N, len(Column)].

    friction_deg: of each particle, shape [N], in place of the material's; a residual angle stays."""
    values: dict[Column, Any] = {
        Column.SIN_PSI: math.sin(math.radians(material.dilation_deg)),
        Column.SOFTENING: math.sqrt(3.0) / material.softening_length if material.softening_length else 0.0,
        Column.SIN_PHI_LIMIT: material.sin_phi_limit,
        Column.INERTIAL_RATE: material.inertial_rate,
    }
    remains = friction_deg if material.residual_friction_deg is None else None
    limits = material.tension_limit_at, material.residual_tension_limit_at
    states = (material, limits[0], friction_deg, PEAK), (material.residual, limits[1], remains, RESIDUAL)
    for state, limit_at, given_deg, (sine, strength, limit) in states:
        if given_deg is None:
            phi = math.radians(state.phi_deg)
            values[sine], cosine, tangent = math.sin(phi), math.cos(phi), None
        else:
            angle = np.radians(material.phi_deg_of(given_deg, material.dilation_deg))
            values[sine], cosine, tangent = np.sin(angle), np.cos(angle), np.tan(angle)
        values[strength] = 2.0 * state.cohesion_at(depth) * cosine
        values[limit] = limit_at(depth, tangent)
    return np.stack([np.broadcast_to(values[column], depth.shape) for column in Column], axis=1)


def weakened(material: Material, factor: float) -> Material:
    """`material` with its strength divided by `factor`: tan(phi), c, tension cutoff, and their residual values."""
    phi = flatter(material.phi_deg, factor)
    values: dict[str, Any] = {"angle": "triaxial", "friction_limit_deg": None, "friction_deg": phi}
    if material.residual_friction_deg is not None:
        values["residual_friction_deg"] = flatter(material.residual.phi_deg, factor)
    for name in ("cohesion", "strength_gradient", "tension_cutoff", "residual_cohesion", "residual_tension_cutoff"):
        if (value := getattr(material, name)) is not None:
            values[name] = value / factor
    return dataclasses.replace(material, dilation_deg=min(max(material.dilation_deg, -phi), phi), **values)


def flatter(angle: float, factor: float) -> float:
    """The angle [deg] whose tangent is that of `angle` [deg] over `factor`."""
    return math.degrees(math.atan(math.tan(math.radians(angle)) / factor))


def limit(rows: Floats) -> Floats:
    """T [Pa] of particles with these rows of properties, shape [N]."""
    return rows[:, Column.LIMIT]


def admitted_share(mean: Floats, deviators: Floats, rows: Floats) -> Floats:
    """The factor by which a deviator is admitted at its mean stress [Pa], shape [N]; 1 and more: unchanged.

    deviators: its principal values [Pa], ascending, shape [N, 3]."""
    sin_phi, strength, largest = rows[:, Column.SIN_PHI], rows[:, Column.STRENGTH], deviators[:, 2]
    shear = excess_over.__wrapped__(largest, deviators[:, 0], sin_phi, 0.0)
    return np.minimum(quotient(strength - 2.0 * sin_phi * mean, shear), quotient(rows[:, Column.LIMIT] - mean, largest))


def quotient(top: Floats, bottom: Floats) -> Floats:
    """top / bottom, infinite where `bottom` is not positive."""
    return np.asarray(np.divide(top, bottom, out=np.full_like(top, np.inf), where=bottom > 0.0))


def nearest(principal: Floats, rows: Floats) -> Floats:
    """The admitted principal stresses [Pa] nearest to given ones, ascending, [N, 3]: Mohr-Coulomb, then the cutoff.

    a >= b >= c with F(a, c) <= 0: projected onto that plane if b then lies between a and c; else with the two stresses
    that would pass each other set equal."""
    c, b, a = principal.T
    sin_phi, tension = (1.0 - REDUCED) * rows[:, Column.SIN_PHI], rows[:, Column.LIMIT]
    upper, lower = 1.0 + sin_phi, 1.0 - sin_phi

    def on_plane(a: Floats, c: Floats, count_a: int, count_c: int) -> tuple[Floats, Floats]:
        excess = np.maximum(excess_over.__wrapped__(a, c, sin_phi, rows[:, Column.STRENGTH]), 0.0)
        excess /= upper**2 / count_a + lower**2 / count_c
        return a - excess * upper / count_a, c + excess * lower / count_c

    largest, least = on_plane(a, c, 1, 1)
    above, below = on_plane(0.5 * (a + b), c, 2, 1), on_plane(a, 0.5 * (b + c), 1, 2)
    high, low = b > largest, b < least
    middle = np.where(high, above[0], np.where(low, below[1], b))
    largest = np.where(high, above[0], np.where(low, below[0], largest))
    least = np.where(high, above[1], np.where(low, below[1], least))
    apex = least > largest
    changed = np.minimum(np.stack([least, middle, largest], axis=1), tension[:, None])
    changed[apex] = tension[apex, None]
    return changed


@ti.func
def excess_over(s_i, s_j, sin_phi, strength):
    """F_ij [Pa], in lanes and of arrays."""
    return s_i * (1.0 + sin_phi) - s_j * (1.0 - sin_phi) - strength


@ti.func
def strengths(values: ti.template(), strain: ti.template(), cell, dt, features: ti.template()):
    """The strengths of a step, as `return_principal` takes them, from the values of the columns; one that the kernel
    does not read is 0. strain: a list of one number if the material softens, the initial plastic strain of the step.
    """
    slow = slow_strengths(values, strain, cell, features)
    if ti.static(features.inertial):
        return slow[0], slow[1], slow[2], slow[3], values[8], dt * values[9]
    else:
        return slow[0], slow[1], slow[2], slow[3]


@ti.func
def slow_strengths(values: ti.template(), strain: ti.template(), cell, features: ti.template()):
    """sin phi [-], sin psi [-], 2 c cos phi [Pa] and T [Pa] in slow shear."""
    peak = values[0], values[1], values[2], values[3]
    if ti.static(features.softens):
        return softened(strain[0], values[7] * cell, peak, (values[4], values[5], values[6]), features)
    else:
        return peak


@ti.func
def apex_limit(cutoff, sin_phi, strength):
    """T [Pa]: the tension cutoff, or the apex c cot phi = strength / (2 sin phi) if that is lower."""
    return minimum(cutoff, strength / maximum(2.0 * sin_phi, TINY))


@ti.func
def softened(strain, per_strain, peak: ti.template(), residual: ti.template(), features: ti.template()):
    """sin phi [-], sin psi [-], 2 c cos phi [Pa] and T [Pa] after the accumulated plastic strain `strain` [-].

    Linear in w = max(0, 1 - `per_strain` * `strain`) between `residual`, which is (sin phi, 2 c cos phi, T), and
    `peak`, with sin psi, which falls to 0; `per_strain` = sqrt(3) * cell / softening length
    (`datasets.scene.material`).
    """
    w = maximum(1.0 - per_strain * strain, 0.0)
    sin_phi = residual[0] + w * (peak[0] - residual[0])
    if ti.static(features.cohesive):
        strength = residual[1] + w * (peak[2] - residual[1])
        # c cot phi is not linear in w: in between it may lie below the straight line.
        limit = apex_limit(residual[2] + w * (peak[3] - residual[2]), sin_phi, strength)
        return sin_phi, w * peak[1], strength, limit
    else:
        return sin_phi, w * peak[1], peak[2], peak[3]


@ti.func
def on_plane(s1, s2, s3, excess, sin_phi, sin_psi, lame, shear, dilates: ti.template()):
    """Return along the flow of the plane F(s1, s3), which is violated by `excess` >= 0."""
    if ti.static(dilates):
        rate = excess / (4.0 * (shear + (lame + shear) * sin_phi * sin_psi))
        bulge = 2.0 * lame * sin_psi
        s1 = s1 - rate * (bulge + 2.0 * shear * (1.0 + sin_psi))
        s2 = s2 - rate * bulge
        s3 = s3 - rate * (bulge - 2.0 * shear * (1.0 - sin_psi))
    else:
        s1 = s1 - 0.5 * excess
        s3 = s3 + 0.5 * excess
    return s1, s2, s3


@ti.func
def on_edge(s1, s2, s3, excess, sin_phi, sin_psi, strength, lame, shear, upper: ti.template(), dilates: ti.template()):
    """Return to the edge where stresses 1 and 2 (`upper`) or 2 and 3 coincide: the single one, then the equal two."""
    sign = ti.static(1.0 if upper else -1.0)
    pair, single = s2 + s3, s1
    if ti.static(upper):
        pair, single = s1 + s2, s3
    if ti.static(dilates):
        # The sum of both multipliers; a, b: change of a plane's F per its own and per the other multiplier.
        second = excess_over(s1, s2, sin_phi, strength)
        if ti.static(upper):
            second = excess_over(s2, s3, sin_phi, strength)
        a = 4.0 * (shear + (lame + shear) * sin_phi * sin_psi)
        b = 4.0 * lame * sin_phi * sin_psi + 2.0 * shear * (1.0 - sign * sin_phi) * (1.0 - sign * sin_psi)
        total = (excess + second) / (a + b)
        bulge = 2.0 * lame * sin_psi * total
        pair = pair - (2.0 * bulge + sign * 2.0 * shear * (1.0 + sign * sin_psi) * total)
        single = single - (bulge - sign * 2.0 * shear * (1.0 - sign * sin_psi) * total)
    else:
        # psi = 0 preserves the mean stress; with F = 0 that determines the result.
        mean = pair + single
        single = ((1.0 + sign * sin_phi) * mean - sign * 2.0 * strength) / (3.0 - sign * sin_phi)
        pair = mean - single
    return single, 0.5 * pair


@ti.func
def on_hexagon(s1, s2, s3, sin_phi, sin_psi, strength, lame, shear, dilates: ti.template()):
    """Return to Mohr-Coulomb's pyramid alone (A), extended beyond its apex; elastic states are unchanged."""
    excess = maximum(excess_over(s1, s3, sin_phi, strength), 0.0)
    t1, t2, t3 = on_plane(s1, s2, s3, excess, sin_phi, sin_psi, lame, shear, dilates)
    low, twin_high = on_edge(s1, s2, s3, excess, sin_phi, sin_psi, strength, lame, shear, True, dilates)
    high, twin_low = on_edge(s1, s2, s3, excess, sin_phi, sin_psi, strength, lame, shear, False, dilates)
    upper, lower = t2 > t1, t3 > t2
    return (
        ti.select(upper, twin_high, ti.select(lower, high, t1)),
        ti.select(upper, twin_high, ti.select(lower, twin_low, t2)),
        ti.select(upper, low, ti.select(lower, twin_low, t3)),
    )


@ti.func
def on_cutoff(s1, s2, s3, sin_phi, strength, limit, lame, shear):
    """Return where the cutoff is active, s1 > T: s2 and s3 on the cutoff alone (B) or on cutoff and plane (C)."""
    # One stress at T relaxes the others; if s2 stays beyond T, two are at T; if then s3 does, all three.
    beyond = s1 - limit
    coupling = lame / (lame + 2.0 * shear)
    poisson = 0.5 * lame / (lame + shear)
    one2, one3 = s2 - coupling * beyond, s3 - coupling * beyond
    two = one2 > limit
    b2 = ti.select(two, limit, one2)
    b3 = ti.select(two, minimum(s3 - poisson * (beyond + s2 - limit), limit), one3)
    # F <= 0 at s1 = T says that s3 is at or above that of C.
    lowest = (limit * (1.0 + sin_phi) - strength) / (1.0 - sin_phi)
    c2 = clamp(s2 - poisson * (beyond + s3 - lowest), lowest, limit)
    cut = b3 >= lowest
    return ti.select(cut, b2, c2), ti.select(cut, b3, lowest)


@ti.func
def strengths_at_rate(s1, s2, s3, strengths: ti.template(), lame, shear, features: ti.template()):
    """sin phi [-] and T [Pa] at the rate of shear of a step, from `strengths` as `return_principal` takes them."""
    if ti.static(features.inertial):
        sin_phi, sin_psi, strength, limit = strengths[0], strengths[1], strengths[2], strengths[3]
        dilates = ti.static(features.dilates)
        excess = maximum(excess_over(s1, s3, sin_phi, strength), 0.0)
        t1, t2, t3 = on_plane(s1, s2, s3, excess, sin_phi, sin_psi, lame, shear, dilates)
        now = sin_phi_at_rate(s1, s2, s3, t2 > t1, t3 > t2, strengths, lame, shear, dilates)
        if ti.static(features.cohesive):
            # The apex of the steeper cone lies at a lower tension.
            return now, ti.select(now > sin_phi, apex_limit(limit, now, strength), limit)
        else:
            return now, limit
    else:
        return strengths[0], strengths[3]


@ti.func
def return_principal(s1, s2, s3, strengths: ti.template(), lame, shear, features: ti.template()):
    """The stresses that Mohr-Coulomb with tension cutoff admits in place of s1 >= s2 >= s3, then the mean stress [Pa]
    lost by opening: K times the volume of the cracks, without dilation; 0 where nothing opened.

    strengths: sin phi, sin psi, 2 c cos phi and T; if friction grows with the shear rate, then also sin phi at very
    high rates and I_0 dt / (d sqrt(rho_s)). Of `features` it reads `dilates`, `inertial` and `cohesive`; without
    `cohesive`, 2 c cos phi and T must be 0. The return never moves stresses apart: no difference s_i - s_j grows or
    changes its sign.
    """
    dilates = ti.static(features.dilates)
    sin_phi, limit = strengths_at_rate(s1, s2, s3, strengths, lame, shear, features)
    sin_psi, strength = strengths[1], strengths[2]
    t1, t2, t3 = on_hexagon(s1, s2, s3, sin_phi, sin_psi, strength, lame, shear, dilates)
    open_ = t1 + t2 + t3 >= 0.0
    if ti.static(features.cohesive):
        open_ = t1 > limit
        low2, low3 = on_cutoff(s1, s2, s3, sin_phi, strength, limit, lame, shear)
        t1, t2, t3 = ti.select(open_, limit, t1), ti.select(open_, low2, t2), ti.select(open_, low3, t3)
    else:
        # Without cohesion the apex is 0; rounding must not leave a tension.
        t1, t2, t3 = [ti.select(open_, 0.0, minimum(t, 0.0)) for t in ti.static((t1, t2, t3))]
    d1, d2, d3 = s1 - t1, s2 - t2, s3 - t3
    opened = (d1 + d2 + d3) / 3.0
    if ti.static(dilates):
        # Only the hexagon's flow shortens an axis, by 1 - sin psi for every 1 + sin psi that it lengthens another; so
        # its share of the volume is 2 sin psi / (1 - sin psi) of the plastic shortening, e_i = (d_i - share) / (2 mu).
        bulk3 = 3.0 * lame + 2.0 * shear
        share = lame / bulk3 * (d1 + d2 + d3)
        shorter = maximum(share - d1, 0.0) + maximum(share - d2, 0.0) + maximum(share - d3, 0.0)
        opened = opened - bulk3 * sin_psi / (3.0 * shear * (1.0 - sin_psi)) * shorter
    return t1, t2, t3, ti.select(open_, maximum(opened, 0.0), 0.0)


@ti.func
def elastic_at(s: ti.template(), strengths: ti.template(), features: ti.template()):
    """Whether nothing yields at the principal stresses `s`; without cohesion zero stress, the apex, yields."""
    below = excess_over(s[0], s[2], strengths[0], strengths[2]) <= 0.0
    if ti.static(features.cohesive):
        return below & (s[0] <= strengths[3])
    else:
        return below & (s[0] + s[1] + s[2] < 0.0)


@ti.func
def fell_alike(s: ti.template(), t: ti.template(), strengths: ti.template(), lame, shear, features: ti.template()):
    """Whether s1 opened while s2 and s3 only relaxed, both alike (B)."""
    if ti.static(features.cohesive):
        sin_phi, limit = strengths_at_rate(s[0], s[1], s[2], strengths, lame, shear, features)
        lowest = (limit * (1.0 + sin_phi) - strengths[2]) / (1.0 - sin_phi)
        return (t[0] >= limit) & (t[1] < limit) & (t[2] > lowest)
    else:
        return t[0] != t[0]
