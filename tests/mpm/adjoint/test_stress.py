"""The reverse of the stress step: against central differences on every piece of the return, finite where they meet."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mpm.arrays.features import Features
from tests.mpm.adjoint.element import CONSTANTS, reversed_step, stepped

pytestmark = pytest.mark.double

Array = NDArray[Any]

YOUNG = 100.0
"""Lame's constants of the elements [Pa]: that of the cohesion is 1."""
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
]


def inputs_of(
    stress: Array, random: np.random.Generator, *, dilates: bool, cohesive: bool, size: float, fast: bool = False
) -> Array:
    """Elements with these stresses [4 or 6, E], increments of `size` [-] and constants drawn anew for each."""
    count, dimension = stress.shape[1], 2 if len(stress) == 4 else 3
    phi = np.radians(random.uniform(5.0, 45.0, count))
    psi = phi * random.uniform(0.1, 1.0, count) if dilates else 0.0 * phi
    cohesion = np.ones(count) if cohesive else np.zeros(count)
    limit = np.minimum(0.5, cohesion / np.tan(phi)) * random.uniform(0.1, 0.9, count) * cohesion
    return np.concatenate(
        [
            stress,
            size * random.normal(size=(dimension**2, count)),
            [np.sin(phi), np.sin(psi), 2.0 * cohesion * np.cos(phi), limit],
            [np.sin(phi) + 0.2, 10.0 ** random.uniform(-2.0, 0.0, count)] if fast else np.zeros((2, count)),
            YOUNG * random.uniform(0.5, 2.0, (2, count)),
        ]
    )


def random_stresses(width: int, count: int, random: np.random.Generator) -> Array:
    """Around the yield surface, inside it and far out: mean and deviator from a tenth to thirty [Pa]."""
    scale = 10.0 ** random.uniform(-1.0, 1.5, count)
    stress = scale * random.normal(size=(width, count))
    stress[:3] += scale * random.normal(size=count)
    return stress


@pytest.mark.parametrize("features", KINDS)
def test_the_reverse_is_that_of_central_differences(features: Features) -> None:
    """To 1e-6 of the bars of an element, for each of its numbers; but where a difference spans two pieces."""
    random = np.random.default_rng(1)
    strong = features.cohesive
    stress = random_stresses(features.stresses, 2000, random)
    inputs = inputs_of(stress, random, dilates=strong, cohesive=strong, size=0.05, fast=features.inertial)
    bar = random.normal(size=stress.shape)
    ours = reversed_step(features, inputs, bar)
    assert np.isfinite(ours).all()
    first = len(inputs) - CONSTANTS
    absent = set() if strong else {first + 1, first + 2, first + 3}
    absent |= set() if features.inertial else {first + 4, first + 5}
    apart = []
    for row in sorted(set(range(len(inputs))) - absent):
        values = []
        for factor in (1.0, 0.5):
            step = factor * 1.0e-4 * np.maximum(np.abs(inputs[row]), 0.1)
            ahead, behind = inputs.copy(), inputs.copy()
            ahead[row] += step
            behind[row] -= step
            values.append(((stepped(features, ahead) - stepped(features, behind)) * bar).sum(axis=0) / (2.0 * step))
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
    """Nothing yields: the bar of the trial is that of the new stress, whatever the axes, to rounding."""
    random = np.random.default_rng(2)
    features = Features(dimension=dimension, precision="f64", dilates=True, cohesive=True)
    stress = same_axes(features.stresses, values, 64, random)
    inputs = inputs_of(stress, random, dilates=True, cohesive=True, size=0.0)
    inputs[len(inputs) - CONSTANTS + 2] = 50.0
    bar = random.normal(size=stress.shape)
    np.testing.assert_allclose(reversed_step(features, inputs, bar)[: features.stresses], bar, atol=1e-12)


@pytest.mark.parametrize(("pair", "single"), [(-1.0, -9.0), (-9.0, -1.0)])
@pytest.mark.parametrize("dimension", [2, 3])
def test_on_an_edge_two_stresses_stay_equal(dimension: int, pair: float, single: float) -> None:
    """A bar that would part the two equal stresses of an edge, by turning or by stretching, gives none to the trial."""
    features = Features(dimension=dimension, precision="f64", dilates=True, cohesive=True)
    random = np.random.default_rng(4)
    stress = np.zeros((features.stresses, 16))
    stress[0], stress[1], stress[2] = pair, pair, single
    inputs = inputs_of(stress, random, dilates=True, cohesive=True, size=0.0)
    inputs[len(inputs) - CONSTANTS] = 0.7
    inputs[len(inputs) - CONSTANTS + 2] = 0.1
    assert not np.allclose(stepped(features, inputs)[2], single)
    for parting in ([1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]):
        bar = np.zeros_like(stress)
        bar[:4] = np.array(parting)[:, None]
        found = reversed_step(features, inputs, bar)
        np.testing.assert_allclose(found[: features.stresses], 0.0, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_beside_a_crack_equal_stresses_turn_freely(dimension: int) -> None:
    """One stress opens, the other two fall alike: between them the derivative of turning is 1, not 0 / 0."""
    features = Features(dimension=dimension, precision="f64", dilates=True, cohesive=True)
    stress = np.zeros((features.stresses, 8))
    stress[0], stress[1], stress[2] = (-1.0, -1.0, 3.0)
    random = np.random.default_rng(5)
    inputs = inputs_of(stress, random, dilates=False, cohesive=True, size=0.0)
    first = len(inputs) - CONSTANTS
    inputs[first], inputs[first + 2], inputs[first + 3] = 0.3, 20.0, 0.5
    bar = np.zeros_like(stress)
    bar[3] = 1.0
    found = reversed_step(features, inputs, bar)
    np.testing.assert_allclose(found[3], 1.0, atol=1e-12)
    np.testing.assert_allclose(found[:3], 0.0, atol=1e-12)
