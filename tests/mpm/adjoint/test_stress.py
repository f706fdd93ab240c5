"""The reverse of the stress step: against central differences on every piece of the return, finite where they meet."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
import taichi as ti
from numpy.typing import NDArray

from mpm.adjoint.pullback import Pullback
from mpm.adjoint.stress import plastic_return_reverse
from mpm.arrays.features import Features
from mpm.physics.stress import midpoint_increment, plastic_return, trial_stress
from tests.mpm.element import of_elements

pytestmark = pytest.mark.double

Array = NDArray[Any]

STRENGTHS = 6  # as `mpm.laws.mohr_coulomb.return_principal` takes them; the last two are 0 where friction has no growth
CONSTANTS = STRENGTHS + 2  # then lambda, mu
VON_MISES = "von-mises"  # its strengths are the first two: the yield stress in shear and the hardening modulus


def strength_count(features: Features) -> int:
    """How many strengths the law takes."""
    return 2 if features.law_name == VON_MISES else STRENGTHS if features.inertial else 4


def trial_after(stress: Any, a: Any, lame: Any, shear: Any, dimension: int) -> Any:
    """The trial stress after the increment `a`, traced."""
    return trial_stress(stress, midpoint_increment(a, dimension), lame, shear, dimension)


@cache
def kernels(features: Features) -> tuple[Callable[..., None], Callable[..., None]]:
    """Forwards (inputs, returned stress) and backwards (inputs, adjoint of that stress, adjoints of the inputs).

    Inputs: stress, increment A row by row, CONSTANTS; a block of lanes each."""
    real = ti.f32 if features.precision == "f32" else ti.f64
    blocks = ti.types.ndarray(dtype=ti.types.vector(features.lanes, real), ndim=1)
    stresses, gradients, dimension = features.stresses, features.dimension**2, features.dimension
    count = strength_count(features)

    @ti.kernel
    def forwards(x: blocks, y: blocks):
        for e in range(y.shape[0] // stresses):
            at = e * (stresses + gradients + CONSTANTS)
            increment = midpoint_increment([x[at + stresses + k] for k in ti.static(range(gradients))], dimension)
            p = [x[at + stresses + gradients + k] for k in ti.static(range(CONSTANTS))]
            old = [x[at + k] for k in ti.static(range(stresses))]
            trial = trial_stress(old, increment, p[6], p[7], dimension)
            new = plastic_return(trial, [p[k] for k in ti.static(range(count))], p[6], p[7], features)
            for k in ti.static(range(stresses)):
                y[e * stresses + k] = new[k]

    @ti.kernel
    def backwards(x: blocks, y: blocks, result: blocks):
        for e in range(y.shape[0] // stresses):
            at = e * (stresses + gradients + CONSTANTS)
            old = [x[at + k] for k in ti.static(range(stresses))]
            a = [x[at + stresses + k] for k in ti.static(range(gradients))]
            p = [x[at + stresses + gradients + k] for k in ti.static(range(CONSTANTS))]
            elastic = ti.static([Pullback(trial_after, (old, a, p[6], p[7]), (dimension,))])[0]
            adj = [y[e * stresses + k] for k in ti.static(range(stresses))]
            strengths = [p[k] for k in ti.static(range(count))]
            others = [0.0 * adj[0], 0.0 * adj[0]]
            adj_trial, adj_strengths, adj_moduli = plastic_return_reverse(
                adj + others, elastic.values, strengths, p[6], p[7], features
            )
            adj_inputs = ti.static(elastic(adj_trial))
            for k in ti.static(range(stresses)):
                result[at + k] = adj_inputs[0][k]
            for k in ti.static(range(gradients)):
                result[at + stresses + k] = adj_inputs[1][k]
            at = at + stresses + gradients
            for k in ti.static(range(count)):
                result[at + k] = adj_strengths[k]
            for k in ti.static(range(2)):
                result[at + STRENGTHS + k] = adj_moduli[k] + adj_inputs[2 + k]

    return forwards, backwards


def stepped(features: Features, inputs: Array) -> Array:
    """Returned stresses of E elements, shape [4 or 6, E]."""
    return of_elements(kernels(features)[0], features, inputs, rows=features.stresses)


def reversed_step(features: Features, inputs: Array, adj: Array) -> Array:
    """Adjoints of `inputs` from those of the returned stresses, the shape of `inputs`."""
    return of_elements(kernels(features)[1], features, inputs, adj, rows=len(inputs))


dense = partial(Features, precision="f64", dilates=True, cohesive=True)
YOUNG = 100.0  # Lame's constants of the elements [Pa]: that of the cohesion is 1
KINDS = [
    pytest.param(Features(dimension=size, precision="f64", dilates=strong, cohesive=strong, inertial=fast), id=name)
    for size, strong, fast, name in (
        (2, False, False, "2D sand"),
        (2, True, False, "2D cohesive and dilating"),
        (2, True, True, "2D cohesive and dilating, friction of the rate"),
        (3, False, False, "3D sand"),
        (3, True, False, "3D cohesive and dilating"),
        (3, False, True, "3D sand, friction of the rate"),
    )
] + [
    pytest.param(Features(dimension=size, precision="f64", law_name=VON_MISES, softens=True), id=f"{size}D von Mises")
    for size in (2, 3)
]


def inputs_of(stress: Array, random: np.random.Generator, features: Features, size: float = 0.0) -> Array:
    """Elements with these stresses [4 or 6, E], increments of `size` [-] and constants drawn anew for each."""
    count, dimension = stress.shape[1], 2 if len(stress) == 4 else 3
    phi = np.radians(random.uniform(5.0, 45.0, count))
    psi = phi * random.uniform(0.1, 1.0, count) if features.dilates else 0.0 * phi
    cohesion = np.full(count, float(features.cohesive))
    limit = np.minimum(0.5, cohesion / np.tan(phi)) * random.uniform(0.1, 0.9, count) * cohesion
    strengths = [np.sin(phi), np.sin(psi), 2.0 * cohesion * np.cos(phi), limit]
    if features.law_name == VON_MISES:
        strengths = [*random.uniform(0.5, 50.0, (2, count)), 0.0 * phi, 0.0 * phi]
    increments, rates = size * random.normal(size=(dimension**2, count)), np.zeros((2, count))
    if features.inertial:
        rates[:] = np.sin(phi) + 0.2, 10.0 ** random.uniform(-2.0, 0.0, count)
    return np.concatenate([stress, increments, strengths, rates, YOUNG * random.uniform(0.5, 2.0, (2, count))])


def random_stresses(width: int, count: int, random: np.random.Generator) -> Array:
    """Around the yield surface, inside it and far out: mean and deviator from a tenth to thirty [Pa]."""
    scale = 10.0 ** random.uniform(-1.0, 1.5, count)
    stress = scale * random.normal(size=(width, count))
    stress[:3] += scale * random.normal(size=count)
    return stress


@pytest.mark.parametrize("features", KINDS)
def test_the_reverse_is_that_of_central_differences(features: Features) -> None:
    """To 1e-6 of the adjoints of an element, for each of its numbers; but where a difference spans two pieces."""
    random = np.random.default_rng(1)
    stress = random_stresses(features.stresses, 2000, random)
    inputs = inputs_of(stress, random, features, size=0.05)
    adj = random.normal(size=stress.shape)
    ours = reversed_step(features, inputs, adj)
    assert np.isfinite(ours).all()
    first = len(inputs) - CONSTANTS
    read = strength_count(features) if features.cohesive or features.law_name == VON_MISES else 1
    absent = set(range(first + read, first + 4)) | (set() if features.inertial else {first + 4, first + 5})
    apart = []
    for row in sorted(set(range(len(inputs))) - absent):
        values = []
        for factor in (1.0, 0.5):
            step = factor * 1.0e-4 * np.maximum(np.abs(inputs[row]), 0.1)
            ahead, behind = inputs.copy(), inputs.copy()
            ahead[row] += step
            behind[row] -= step
            values.append(((stepped(features, ahead) - stepped(features, behind)) * adj).sum(axis=0) / (2.0 * step))
        coarse, fine = values
        # Of two steps on one piece the difference falls to a quarter: Richardson's value is of fourth order.
        best = fine + (fine - coarse) / 3.0
        scale = np.abs(best) + np.abs(ours[row]) + 0.1 * np.abs(ours[row]).mean()
        apart.append(np.abs(best - ours[row]) / scale)
    share = (np.array(apart) < 1.0e-6).mean()
    assert share > 0.985
    assert np.median(np.array(apart)) < 1.0e-8


def same_axes(width: int, values: tuple[float, float, float], count: int, random: np.random.Generator) -> Array:
    """Stresses with these principal values [Pa] in random axes; in 2D the last is out of plane."""
    if width == 4:
        angle = random.uniform(0.0, np.pi, count)
        centre, radius = 0.5 * (values[0] + values[1]), 0.5 * (values[0] - values[1])
        turned = radius * np.cos(2.0 * angle), radius * np.sin(2.0 * angle)
        return np.stack([centre + turned[0], centre - turned[0], np.full(count, values[2]), turned[1]])
    axes, _ = np.linalg.qr(random.normal(size=(count, 3, 3)))
    full = axes @ (np.array(values)[:, None] * np.swapaxes(axes, 1, 2))
    return np.stack([full[:, 0, 0], full[:, 1, 1], full[:, 2, 2], full[:, 0, 1], full[:, 1, 2], full[:, 2, 0]])


@pytest.mark.parametrize("values", [(-3.0, -3.0, -3.0), (-3.0, -3.0, -1.0), (-3.0, -3.0, -5.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("dimension", [2, 3])
def test_elastic_stresses_that_are_equal_have_the_derivative_of_elasticity(
    dimension: int, values: tuple[float, float, float]
) -> None:
    """Nothing yields: the adjoint of the trial is that of the new stress, whatever the axes, to rounding."""
    random = np.random.default_rng(2)
    features = dense(dimension=dimension)
    stress = same_axes(features.stresses, values, 64, random)
    inputs = inputs_of(stress, random, features)
    inputs[2 - CONSTANTS] = 50.0
    adj = random.normal(size=stress.shape)
    np.testing.assert_allclose(reversed_step(features, inputs, adj)[: features.stresses], adj, atol=1e-12)


@pytest.mark.parametrize(("pair", "single"), [(-1.0, -9.0), (-9.0, -1.0)])
@pytest.mark.parametrize("dimension", [2, 3])
def test_on_an_edge_two_stresses_stay_equal(dimension: int, pair: float, single: float) -> None:
    """An adjoint that would part the equal stresses of an edge, by a turn or a stretch, gives none to the trial."""
    features = dense(dimension=dimension)
    stress = np.zeros((features.stresses, 16))
    stress[0], stress[1], stress[2] = pair, pair, single
    inputs = inputs_of(stress, np.random.default_rng(4), features)
    inputs[[-CONSTANTS, 2 - CONSTANTS]] = np.array([[0.7], [0.1]])
    assert not np.allclose(stepped(features, inputs)[2], single)
    for parting in ([1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]):
        adj = np.zeros_like(stress)
        adj[:4] = np.array(parting)[:, None]
        adjoints = reversed_step(features, inputs, adj)
        np.testing.assert_allclose(adjoints[: features.stresses], 0.0, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_beside_a_crack_equal_stresses_turn_freely(dimension: int) -> None:
    """One stress opens, the other two fall alike: between them the derivative of turning is 1, not 0 / 0."""
    features = dense(dimension=dimension)
    stress = np.zeros((features.stresses, 8))
    stress[0], stress[1], stress[2] = (-1.0, -1.0, 3.0)
    inputs = inputs_of(stress, np.random.default_rng(5), features)
    inputs[-CONSTANTS : 4 - CONSTANTS] = np.array([0.3, 0.0, 20.0, 0.5])[:, None]
    adj = np.zeros_like(stress)
    adj[3] = 1.0
    adjoints = reversed_step(features, inputs, adj)
    np.testing.assert_allclose(adjoints[3], 1.0, atol=1e-12)
    np.testing.assert_allclose(adjoints[:3], 0.0, atol=1e-12)
