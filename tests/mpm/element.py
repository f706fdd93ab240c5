"""A single material element: the solver's constitutive law, driven without a grid, in vectors of lanes as there."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from scipy.optimize import root

from datasets.scene.material import MOHR_COULOMB, Material
from mpm import runtime
from mpm.arrays.batch import put_vectors
from mpm.arrays.features import Features, Recorded
from mpm.arrays.kernel_arguments import aligned
from mpm.arrays.layout import Precision, Property
from mpm.arrays.properties import properties_row
from mpm.laws import law_of
from mpm.laws.mohr_coulomb import Column, return_principal
from mpm.physics.stress import stress_step

Vector = NDArray[np.float64]

XX, YY, ZZ, XY, YZ, ZX = range(6)


def tensor(components: Vector) -> Vector:
    """Symmetric tensors, shape [..., 3, 3], of components xx, yy, zz, xy and, in 3D, yz, zx, shape [..., 4 or 6]."""
    full = np.zeros((*components.shape[:-1], 3, 3))
    for number, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)][: components.shape[-1]]):
        full[..., i, j] = full[..., j, i] = components[..., number]
    return full


@cache
def path_kernel(features: Features) -> Callable[..., None]:
    """(stress, gradients, history, properties, cell, dt): one element along a path of displacement-gradient increments.

    `stress` ends with the plastic strain and what is remembered of opened cracks."""
    real = ti.f64 if features.precision == "f64" else ti.f32
    blocks = ti.types.ndarray(dtype=ti.types.vector(features.lanes, real), ndim=1)
    width, law = features.stresses + 2, features.law

    @ti.kernel
    def follow_path(
        stress: blocks, gradients: ti.types.ndarray(), history: blocks, m: ti.types.ndarray(), cell: real, dt: real
    ):
        for _ in range(1):
            for step in range(gradients.shape[0]):
                zero = 0.0 * stress[0]
                strain, gap = stress[ti.static(features.stresses)], stress[ti.static(features.stresses + 1)]
                values = [m[column] + zero for column in ti.static(list(law.Column))]
                strengths = law.strengths(values, [strain], cell, dt, features)
                old = [stress[k] for k in ti.static(range(features.stresses))]
                lame, shear = m[Property.LAME], m[Property.SHEAR]
                increment = [gradients[step, k] + zero for k in ti.static(range(features.dimension**2))]
                new = stress_step(old, increment, gap, strengths, lame, shear, features)
                for k in ti.static(range(features.stresses)):
                    stress[k] = new[k]
                stress[ti.static(features.stresses)] = strain + new[features.stresses]
                stress[ti.static(features.stresses + 1)] = new[features.stresses + 1]
                for k in ti.static(range(width)):
                    history[step * width + k] = stress[k]

    return follow_path


@cache
def return_kernel(features: Features) -> Callable[..., None]:
    """(properties, principal stresses, these returned and what opening cost): three and four blocks after another."""
    blocks = ti.types.ndarray(dtype=ti.types.vector(features.lanes, ti.f64), ndim=1)

    @ti.kernel
    def return_all(m: ti.types.ndarray(), s: blocks, t: blocks):
        for e in range(s.shape[0] // 3):
            columns = ti.static((Column.SIN_PHI, Column.SIN_PSI, Column.STRENGTH, Column.LIMIT))
            strengths, lame, shear = [m[column] for column in columns], m[Property.LAME], m[Property.SHEAR]
            s1, s2, s3 = s[3 * e], s[3 * e + 1], s[3 * e + 2]
            t1, t2, t3, opened = return_principal(s1, s2, s3, strengths, lame, shear, features)
            t[4 * e], t[4 * e + 1], t[4 * e + 2], t[4 * e + 3] = t1, t2, t3, opened

    return return_all


def of_elements(function: Callable[..., None], features: Features, *matrices: NDArray[Any], rows: int) -> NDArray[Any]:
    """What `function` makes in lanes of E elements, each a column of `matrices`, in its last argument, [rows, E]."""
    runtime.start(features.precision, enough=1)
    lanes, count = features.lanes, matrices[0].shape[1]
    blocks = -(-count // lanes)
    real: np.dtype[Any] = np.dtype(np.float64 if features.precision == "f64" else np.float32)
    source = np.minimum(np.arange(blocks * lanes), count - 1)

    def packed(columns: NDArray[Any]) -> NDArray[Any]:
        memory = aligned((blocks, len(columns), lanes), real)
        put_vectors(memory, 0, columns[:, source].T)
        return memory.reshape(-1, lanes)

    result = aligned((blocks * rows, lanes), real)
    function(*map(packed, matrices), result)
    return np.moveaxis(result.reshape(blocks, rows, lanes), 1, 0).reshape(rows, -1)[:, :count].astype(np.float64)


def follow_states(
    material: Material,
    gradients: Vector,
    start: Vector | None = None,
    *,
    corrected: bool = False,
    cohesive: bool = True,
    cell: float = 1.0,
    dt: float = 1.0,
    precision: Precision = "f64",
) -> tuple[Vector, Vector, Vector]:
    """Stress [Pa], shape [S, 4 or 6], accumulated plastic strain [-] and opening remembered [Pa], shape [S] each, along
    increments [S, D, D] [-]; `cell` [m] is the thickness of a band where the material softens, `dt` [s] the time of an
    increment where friction grows with the rate of shear."""
    runtime.start(precision, enough=1)
    flags = law_of([material]).features([material], [])
    if material.law == MOHR_COULOMB:
        flags |= {"dilates": True, "cohesive": cohesive}
    flags |= {"law_name": material.law, "recorded": Recorded(strain=True), "volume_correction": corrected}
    features = Features(dimension=gradients.shape[1], precision=precision, **flags)
    real = np.dtype(np.float64 if precision == "f64" else np.float32)
    width = features.stresses + 2
    stress = aligned((width, features.lanes), real)
    if start is not None:
        stress[: features.stresses] = np.asarray(start)[:, None]
    history = aligned((len(gradients) * width, features.lanes), real)
    increments = np.ascontiguousarray(gradients.reshape(len(gradients), -1), real)
    path_kernel(features)(stress, increments, history, np.array(properties_row(material, 1.0), real), cell, dt)
    assert np.all(history == history[:, :1])
    series = history[:, 0].reshape(len(gradients), width)
    return series[:, :-2], series[:, -2], series[:, -1]


def follow(material: Material, gradients: Vector, start: Vector | None = None) -> Vector:
    """Stress [Pa] after each displacement-gradient increment [-] of shape [S, D, D]; shape [S, 4 or 6]."""
    return follow_states(material, gradients, start)[0]


def follow_controlled(
    material: Material, *, start: Vector, steps: int, gradient: Callable[[Vector], Vector], held: dict[int, float]
) -> Vector:
    """Drive an element with some stress components held at given values; shape [steps, 4 or 6].

    `gradient` makes an increment of the free strains, as many as there are held components, which Newton finds."""
    stress, history = np.array(start, float), []
    for _ in range(steps):

        def miss(free: Vector, now: Vector = stress) -> Vector:
            after = follow(material, gradient(free)[None], now)[0]
            return np.array([after[k] - value for k, value in held.items()]) / material.modulus

        solution = root(miss, np.zeros(len(held)), tol=1e-14)
        stress = follow(material, gradient(solution.x)[None], stress)[0]
        history.append(stress)
    return np.array(history)


def returned(material: Material, stresses: Vector) -> tuple[Vector, Vector]:
    """Sorted principal stresses [Pa], shape [E, 3], returned, and the mean stress that opening cost [Pa], shape [E]."""
    features = Features(dimension=2, precision="f64", dilates=material.dilation_deg > 0.0, cohesive=True)
    runtime.start("f64", enough=1)
    kernel = partial(return_kernel(features), np.array(properties_row(material, 1.0), np.float64))
    result = of_elements(kernel, features, stresses.T, rows=4)
    return result[:3].T, result[3]
