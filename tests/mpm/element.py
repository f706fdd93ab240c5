"""A single material element: the solver's constitutive law, driven without a grid, in vectors of lanes as there."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from scipy.optimize import root

from datasets.material import Material
from mpm import runtime
from mpm.batch import aligned, properties_row
from mpm.layout import Features, Precision, Property
from mpm.mohr_coulomb import return_principal
from mpm.stress import plastic_return, trial_stress

Vector = NDArray[np.float64]

XX, YY, ZZ, XY, YZ, ZX = range(6)


@cache
def path_kernel(needs: Features) -> Callable[..., None]:
    """(stress, gradients, history, properties): one element along a path of displacement-gradient increments."""
    real = ti.f32 if needs.precision == "f32" else ti.f64
    blocks = ti.types.ndarray(dtype=ti.types.vector(needs.lanes, real), ndim=1)

    @ti.kernel
    def follow_path(stress: blocks, gradients: ti.types.ndarray(), history: blocks, m: ti.types.ndarray()):
        for _ in range(1):
            for step in range(gradients.shape[0]):
                trial = trial_stress(
                    [stress[k] for k in ti.static(range(needs.stresses))],
                    [gradients[step, k] + 0.0 * stress[0] for k in ti.static(range(needs.dimension**2))],
                    m[Property.LAME],
                    m[Property.SHEAR],
                    needs.dimension,
                )
                new = plastic_return(
                    trial,
                    m[Property.SIN_PHI],
                    m[Property.SIN_PSI],
                    m[Property.STRENGTH],
                    m[Property.LIMIT],
                    m[Property.LAME],
                    m[Property.SHEAR],
                    needs,
                )
                for k in ti.static(range(needs.stresses)):
                    stress[k] = new[k]
                    history[step * ti.static(needs.stresses + 1) + k] = new[k]
                history[step * ti.static(needs.stresses + 1) + ti.static(needs.stresses)] = new[needs.stresses]

    return follow_path


@cache
def return_kernel(dilates: bool) -> Callable[..., None]:
    """(stresses, properties): principal stresses, three blocks of eight lanes after another, returned in place."""
    blocks = ti.types.ndarray(dtype=ti.types.vector(8, ti.f64), ndim=1)

    @ti.kernel
    def return_all(s: blocks, m: ti.types.ndarray()):
        for e in range(s.shape[0] // 3):
            t1, t2, t3, _ = return_principal(
                s[3 * e],
                s[3 * e + 1],
                s[3 * e + 2],
                m[Property.SIN_PHI],
                m[Property.SIN_PSI],
                m[Property.STRENGTH],
                m[Property.LIMIT],
                m[Property.LAME],
                m[Property.SHEAR],
                dilates,
            )
            s[3 * e], s[3 * e + 1], s[3 * e + 2] = t1, t2, t3

    return return_all


def follow_whole(
    material: Material, gradients: Vector, start: Vector | None = None, precision: Precision = "f64"
) -> tuple[Vector, Vector]:
    """Stress [Pa], shape [S, 4 or 6], and plastic strain increment [-], shape [S], along increments [S, D, D] [-]."""
    runtime.start(precision)
    needs = Features(
        dimension=gradients.shape[1], precision=precision, dilates=True, cohesive=True, strain_recorded=True
    )
    real: np.dtype[Any] = np.dtype(np.float64 if precision == "f64" else np.float32)
    stress = aligned((needs.stresses, needs.lanes), real)
    if start is not None:
        stress[:] = np.asarray(start)[:, None]
    history = aligned((len(gradients) * (needs.stresses + 1), needs.lanes), real)
    increments = np.ascontiguousarray(gradients.reshape(len(gradients), -1), real)
    path_kernel(needs)(stress, increments, history, np.array(properties_row(material), real))
    assert np.all(history == history[:, :1])
    series = history[:, 0].reshape(len(gradients), needs.stresses + 1).astype(np.float64)
    return series[:, :-1], series[:, -1]


def follow(material: Material, gradients: Vector, start: Vector | None = None, precision: Precision = "f64") -> Vector:
    """Stress [Pa] after each displacement-gradient increment [-] of shape [S, D, D]; shape [S, 4 or 6]."""
    return follow_whole(material, gradients, start, precision)[0]


def follow_controlled(
    material: Material, *, start: Vector, steps: int, gradient: Callable[[Vector], Vector], held: dict[int, float]
) -> Vector:
    """Drive an element with some stress components held at given values; shape [steps, 4 or 6].

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


def returned(material: Material, stresses: Vector, *, limit: float = np.inf) -> Vector:
    """Sorted principal stresses [Pa], shape [E, 3], returned to the hexagon; tension stops at `limit` [Pa]."""
    runtime.start("f64")
    blocks = aligned((-(-len(stresses) // 8), 3, 8), np.dtype(np.float64))
    padded = np.concatenate([stresses, np.zeros((8 * len(blocks) - len(stresses), 3))])
    blocks[:] = np.moveaxis(padded.reshape(-1, 8, 3), 1, 2)
    properties = np.array(properties_row(material))
    properties[Property.LIMIT] = limit
    return_kernel(material.dilation_deg > 0.0)(blocks.reshape(-1, 8), properties)
    return np.moveaxis(blocks, 1, 2).reshape(-1, 3)[: len(stresses)].copy()


def yield_function(material: Material, stresses: Vector) -> Vector:
    """F = s1 (1 + sin phi) - s3 (1 - sin phi) - 2 c cos phi [Pa] of sorted principal stresses, shape [E]."""
    phi = np.radians(material.friction_deg)
    return stresses[:, 0] * (1 + np.sin(phi)) - stresses[:, 2] * (1 - np.sin(phi)) - 2 * material.cohesion * np.cos(phi)
