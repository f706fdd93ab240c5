"""Von Mises plasticity with linear isotropic hardening: undrained clay, snow slabs; no friction, any tension.

The shear stress tau = sqrt(J2) is at most the strength, which grows with the plastic shear strain (von Mises 1913):

    F = tau - (s_u + H gamma_p),     J2 = s : s / 2,     gamma_p = sqrt(3) e_p,     e_p = int sqrt(2/3 de : de)

with s the deviator of the stress. In plane strain the strength in shear is s_u, as Tresca's; in triaxial compression
the deviator stress is sqrt(3) s_u at yield, where Tresca's is 2 s_u. gamma_p is the plastic shear strain in simple
shear. The return is radial, the backward Euler step in closed form (de Souza Neto, Peric & Owen 2008, box 7.4, where
sigma_y = sqrt(3) (s_u + H gamma_p), so their hardening modulus is 3 H):

    dgamma = max(0, tau_trial - s_u - H gamma_p) / (G + H),     s = (1 - G dgamma / tau_trial) s_trial

and the mean stress stays. The law does not open: no code for cracks or gaps is compiled with it.

| symbol | variable |
|---|---|
| s_u + H gamma_p at the start of the step | strength |
| H, G | hardening, shear |
| dgamma | slip |
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, auto
from typing import Annotated, Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.scene import Stage
from datasets.scene.material import STIFFEST, Material
from datasets.schema import Bounds, Record
from mpm.arrays.access import TINY, maximum
from mpm.arrays.layout import Property
from mpm.laws import parameters_of

Floats = NDArray[np.float64]

OPENS = False


@dataclass(frozen=True, kw_only=True)
class Parameters(Record):
    """The keys of `[material]` with `law = "von-mises"`, beside density and elasticity."""

    strength: Annotated[float, Bounds(f"a shear strength in Pa, above 0 up to {STIFFEST:g}", gt=0.0, le=STIFFEST)]
    """Shear strength s_u [Pa] before any plastic strain."""
    hardening: Annotated[float, Bounds(f"a modulus in Pa, at least 0 up to {STIFFEST:g}", ge=0.0, le=STIFFEST)] = 0.0
    """H [Pa], growth of the strength with the plastic shear strain."""


class Column(IntEnum):
    """The properties of a particle for the law."""

    STRENGTH = len(Property)  # s_u [Pa]
    HARDENING = auto()  # H [Pa]; only with hardening


def features(materials: Sequence[Material], stages: Sequence[Stage]) -> dict[str, bool]:
    """Strength at zero pressure; with hardening also the plastic strain."""
    return {"cohesive": True, "softens": any(parameters_of(material).hardening for material in materials)}


def columns(features: Any) -> list[Column]:
    """The columns that `strengths` reads."""
    return [Column.STRENGTH, *([Column.HARDENING] if features.softens else [])]


def properties(material: Material, depth: Floats, friction_deg: Floats | None) -> Floats:
    """Columns of N particles, shape [N, 2]. Raises InputError for particles with a friction of their own."""
    if friction_deg is not None:
        raise InputError(f"expected no field of friction beside law = {material.law!r}, which has none", key="fields")
    parameters = parameters_of(material)
    return np.tile([parameters.strength, parameters.hardening], (len(depth), 1))


def weakened(material: Material, factor: float) -> Material:
    """`material` with its strength, and so its hardening, divided by `factor`."""
    parameters = dataclasses.asdict(parameters_of(material))
    return dataclasses.replace(material, constants={key: value / factor for key, value in parameters.items()})


def limit(rows: Floats) -> Floats:
    """Largest tension [Pa] of particles with these rows of properties: none, shape [N]."""
    return np.full(len(rows), np.inf)


def admitted_share(mean: Floats, deviators: Floats, rows: Floats) -> Floats:
    """The factor by which a deviator is admitted, shape [N]; principal values [Pa], shape [N, 3]."""
    tau = np.sqrt(0.5 * (deviators**2).sum(axis=1))
    return np.divide(rows[:, Column.STRENGTH], tau, out=np.full_like(tau, np.inf), where=tau > 0.0)


def nearest(principal: Floats, rows: Floats) -> Floats:
    """The admitted principal stresses [Pa] nearest to given ones, shape [N, 3]."""
    mean = principal.mean(axis=1, keepdims=True)
    share = np.minimum(admitted_share(mean[:, 0], principal - mean, rows), 1.0)
    return mean + share[:, None] * (principal - mean)


@ti.func
def strengths(values: ti.template(), strain: ti.template(), cell, dt, features: ti.template()):
    """The strength at the start of a step [Pa] and H [Pa], from s_u, H and, with hardening, the plastic strain e_p."""
    if ti.static(features.softens):
        return values[0] + values[1] * (3.0**0.5 * strain[0]), values[1]
    else:
        return values[0], 0.0 * values[0]


@ti.func
def return_tensor(trial: ti.template(), strengths: ti.template(), lame, shear, features: ti.template()):
    """The admitted stress [Pa], component by component, the increment of e_p [-], and an opening of zero."""
    strength, hardening = strengths
    mean = (trial[0] + trial[1] + trial[2]) / 3.0
    xx, yy, zz = trial[0] - mean, trial[1] - mean, trial[2] - mean
    square = 0.5 * (xx * xx + yy * yy + zz * zz)
    for k in ti.static(range(3, features.stresses)):
        square = square + trial[k] * trial[k]
    tau = ti.sqrt(square)
    yields = tau > strength
    slip = maximum(tau - strength, 0.0) / (shear + hardening)
    # tau - G dgamma over tau, without a difference of large numbers.
    share = (shear * strength + hardening * tau) / ((shear + hardening) * maximum(tau, TINY))
    normal = [mean + share * xx, mean + share * yy, mean + share * zz]
    admitted = normal + [share * trial[k] for k in ti.static(range(3, features.stresses))]
    stress = [ti.select(yields, admitted[k], trial[k]) for k in ti.static(range(features.stresses))]
    strain_and_opening = [slip / 3.0**0.5, 0.0 * slip]
    return stress + strain_and_opening
