"""A single material element: the constitutive law of the solver, driven without a grid."""

from collections.abc import Callable

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from scipy.optimize import root

from datasets.material import Material
from mpm import runtime
from mpm.layout import Property
from mpm.mohr_coulomb import return_principal
from mpm.simulate import properties_row
from mpm.stress import plastic_return, trial_stress

Vector = NDArray[np.float64]

XX, YY, XY, ZZ = range(4)


@ti.kernel
def follow_path(
    stress: ti.types.ndarray(), gradients: ti.types.ndarray(), history: ti.types.ndarray(), m: ti.types.ndarray()
):
    for _ in range(1):
        s = ti.Vector([stress[k] for k in range(4)])
        for step in range(gradients.shape[0]):
            g = ti.Matrix(
                [[gradients[step, 0, 0], gradients[step, 0, 1]], [gradients[step, 1, 0], gradients[step, 1, 1]]]
            )
            s = trial_stress(s, g, m[Property.LAME], m[Property.SHEAR])
            s = plastic_return(
                s,
                m[Property.SIN_PHI],
                m[Property.SIN_PSI],
                m[Property.STRENGTH],
                m[Property.LIMIT],
                m[Property.LAME],
                m[Property.SHEAR],
                True,
            )
            for k in ti.static(range(4)):
                history[step, k] = s[k]


@ti.kernel
def return_all(stresses: ti.types.ndarray(), m: ti.types.ndarray(), dilates: ti.template()):
    for e in range(stresses.shape[0]):
        s1, s2, s3, _ = return_principal(
            stresses[e, 0],
            stresses[e, 1],
            stresses[e, 2],
            m[Property.SIN_PHI],
            m[Property.SIN_PSI],
            m[Property.STRENGTH],
            m[Property.LAME],
            m[Property.SHEAR],
            dilates,
        )
        stresses[e, 0], stresses[e, 1], stresses[e, 2] = s1, s2, s3


def follow(
    material: Material, gradients: Vector, start: Vector | None = None, precision: runtime.Precision = "f64"
) -> Vector:
    """Stress (xx, yy, xy, zz) [Pa] after each displacement-gradient increment [-] of shape [S, 2, 2]; shape [S, 4]."""
    runtime.start(precision)
    real = np.float64 if precision == "f64" else np.float32
    history = np.zeros((len(gradients), 4), real)
    initial = np.zeros(4, real) if start is None else np.array(start, real)
    follow_path(initial, np.ascontiguousarray(gradients, real), history, np.array(properties_row(material), real))
    return history


def follow_controlled(
    material: Material, *, start: Vector, steps: int, gradient: Callable[[Vector], Vector], held: dict[int, float]
) -> Vector:
    """Drive an element with some stress components held at given values; shape [steps, 4].

    `gradient` makes an increment of the free strains, as many as there are held components, which Newton finds.
    """
    stress, history = np.array(start, float), []
    for _ in range(steps):

        def miss(free: Vector, now: Vector = stress) -> Vector:
            after = follow(material, gradient(free)[None], now)[0]
            return np.array([after[k] - value for k, value in held.items()]) / material.young

        found = root(miss, np.zeros(len(held)), tol=1e-14)
        stress = follow(material, gradient(found.x)[None], stress)[0]
        history.append(stress)
    return np.array(history)


def returned(material: Material, stresses: Vector) -> Vector:
    """Sorted principal stresses [Pa], shape [E, 3], returned to the hexagon."""
    runtime.start("f64")
    result = np.array(stresses, float)
    return_all(result, np.array(properties_row(material)), material.dilation_deg > 0.0)
    return result


def yield_function(material: Material, stresses: Vector) -> Vector:
    """F = s1 (1 + sin phi) - s3 (1 - sin phi) - 2 c cos phi [Pa] of sorted principal stresses, shape [E]."""
    phi = np.radians(material.friction_deg)
    return stresses[:, 0] * (1 + np.sin(phi)) - stresses[:, 2] * (1 - np.sin(phi)) - 2 * material.cohesion * np.cos(phi)
