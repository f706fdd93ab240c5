"""The return of all yield surfaces together: against enumeration, and continuous everywhere."""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets.scene.material import Material
from tests.mpm.element import returned

pytestmark = pytest.mark.double

Vector = NDArray[np.float64]


def surfaces(material: Material) -> tuple[Vector, Vector, Vector]:
    """Normals [9, 3], flows [9, 3] and limits [9] [Pa] of the planes 12, 13, 21, 23, 31, 32, then of the cutoff."""
    phi, psi = np.radians(material.friction_deg), np.radians(material.dilation_deg)
    pairs = list(itertools.permutations(range(3), 2))
    normals, flows, limits = np.zeros((9, 3)), np.zeros((9, 3)), np.zeros(9)
    for row, (i, j) in enumerate(pairs):
        normals[row, [i, j]] = 1.0 + np.sin(phi), np.sin(phi) - 1.0
        flows[row, [i, j]] = 1.0 + np.sin(psi), np.sin(psi) - 1.0
    normals[6:] = flows[6:] = np.eye(3)
    limits[:6] = 2.0 * material.cohesion * np.cos(phi)
    limits[6:] = material.tension_limit
    return normals, flows, limits


def elasticity(material: Material) -> Vector:
    """D in principal axes [Pa], shape [3, 3]."""
    return material.lame * np.ones((3, 3)) + 2.0 * material.shear_modulus * np.eye(3)


def lcp_return(material: Material, trial: Vector) -> tuple[Vector, Vector]:
    """The solution [Pa] for principal stresses of any order, shape [E, 3], by trying every set of active surfaces.

    For the planes F_ij and the cutoff, with normals n_a, flows m_a and elasticity D (de Souza Neto et al. 2008, 8.2):

        s = s_trial - sum_a g_a D m_a,    g >= 0,  n_a s <= k_a,  g_a (n_a s - k_a) = 0

    Beside it how far apart the solutions of all sets lie that pass [Pa], shape [E]; where none passes it is infinite.
    """
    normals, flows, limits = surfaces(material)
    stiff = elasticity(material)
    scale = np.abs(trial).max(axis=1) + limits.max()
    excess = trial @ normals.T - limits
    best, miss = np.zeros_like(trial), np.full(len(trial), np.inf)
    low, high = np.full(trial.shape, np.inf), np.full(trial.shape, -np.inf)
    for size in range(4):
        for active in map(list, itertools.combinations(range(9), size)):
            matrix = normals[active] @ stiff @ flows[active].T
            if size and np.linalg.cond(matrix) > 1e10:
                continue
            rates = np.linalg.solve(matrix, excess[:, active].T).T if size else np.zeros((len(trial), 0))
            state = trial - rates @ flows[active] @ stiff
            wrong = (state @ normals.T - limits).max(axis=1)
            if size:
                wrong = np.maximum(wrong, -material.shear_modulus * rates.min(axis=1))
            wrong = np.maximum(wrong, 0.0) / scale
            better = wrong < miss
            best[better], miss[better] = state[better], wrong[better]
            passes = (wrong < 1e-11)[:, None]
            low = np.minimum(low, np.where(passes, state, np.inf))
            high = np.maximum(high, np.where(passes, state, -np.inf))
    return best, np.where(np.isfinite(low[:, 0]), (high - low).max(axis=1), np.inf)


def materials() -> Iterator[Material]:
    """Friction, dilation, cohesion, cutoff from none to the apex, and Poisson's ratio, each with each."""
    for friction, share, cohesion, cutoff, poisson in itertools.product(
        (0.0, 5.0, 20.0, 33.0, 50.0), (0.0, 0.3, 1.0), (0.0, 1.0e3, 1.0e6), (0.0, 0.02, 0.5, 1.0), (0.0, 0.2, 0.45)
    ):
        if friction == 0.0 and (cohesion == 0.0 or share > 0.0):
            continue
        if cohesion == 0.0 and cutoff > 0.0:
            continue
        apex = cohesion / np.tan(np.radians(friction)) if friction > 0.0 else 4.0 * cohesion
        soil = Material(friction_deg=friction, cohesion=cohesion, tension_cutoff=cutoff * apex, poisson=poisson)
        yield dataclasses.replace(soil, dilation_deg=share * friction)


MATERIALS = list(materials())


@pytest.fixture(params=[MATERIALS[::5], pytest.param(MATERIALS, marks=pytest.mark.slow)], ids=["a fifth", "all"])
def table(request: pytest.FixtureRequest) -> list[Material]:
    """Every fifth material, which has all values of each property; the slow tests have all materials."""
    return request.param


def unit(material: Material) -> float:
    """A stress in which the yield surface is neither large nor small [Pa]."""
    return max(material.cohesion, 1.0e3)


def trials(material: Material, random: np.random.Generator, count: int) -> Vector:
    """Sorted trial stresses [Pa], shape [about `count`, 3], at many scales: anywhere, about the corner of the tension
    limit, and about the returned ones, that is faces, edges and corners."""
    size = unit(material) * 10.0 ** random.uniform(-2.0, 2.0, (count // 2, 1))
    anywhere = size * (random.normal(size=(count // 2, 3)) + random.normal(size=(count // 2, 1)))
    corner = material.tension_limit + 0.1 * anywhere[: count // 6]
    landed, _ = returned(material, -np.sort(-anywhere[: count // 3], axis=1))
    near = 10.0 ** random.uniform(-8.0, 0.0, (len(landed), 1))
    landed = landed + near * unit(material) * random.normal(size=landed.shape)
    return -np.sort(-np.concatenate([anywhere, corner, landed]), axis=1)


def scale_of(material: Material, stresses: Vector) -> Vector:
    """The stresses that a difference is to be small against [Pa], shape [E]."""
    return np.abs(stresses).max(axis=1) + surfaces(material)[2].max()


def test_the_return_is_the_one_solution_of_the_complementarity_problem(table: list[Material]) -> None:
    """Enumeration finds a solution everywhere, only one, and it is the closed form; to 1e-9 of the stress."""
    random, corners = np.random.default_rng(1), set()
    for material in table:
        trial = trials(material, random, 240)
        scale = scale_of(material, trial)
        exact, apart = lcp_return(material, trial)
        ours, _ = returned(material, trial)
        assert (apart / scale).max() < 1e-8, material
        assert (np.abs(ours - exact).max(axis=1) / scale).max() < 1e-9, material
        normals, _, limits = surfaces(material)
        active = np.isclose(exact @ normals.T, limits, rtol=0.0, atol=1e-9 * unit(material))
        corners |= {tuple(row) for row in active.tolist()}
    # Every kind of corner was there: none, plane, edges, cutoff with one, two, three stresses, and their meetings.
    assert len(corners) >= 12


def test_what_opening_cost_is_the_mean_that_dilation_did_not_take(table: list[Material]) -> None:
    """K times the sum of the cutoff's multipliers, where these are unique; all of the mean's change where psi = 0."""
    random = np.random.default_rng(6)
    for material in table:
        trial = trials(material, random, 600)
        ours, opened = returned(material, trial)
        scale, lost = scale_of(material, trial), (trial - ours).mean(axis=1)
        assert opened.min() >= 0.0
        assert np.all(opened[ours[:, 0] < material.tension_limit] == 0.0)
        assert (opened - lost)[lost > 0.0].max() < 1e-11 * scale.max()
        if material.dilation_deg == 0.0:
            np.testing.assert_allclose(opened, lost, atol=1e-11 * scale.max())
            continue
        # Inside the edge of plane 13 and cutoff, plastic strain is gM (1 + sin psi, 0, sin psi - 1) + gT (1, 0, 0).
        edge = (ours[:, 0] == material.tension_limit) & (np.diff(ours, axis=1).max(axis=1) < -1e-6 * unit(material))
        strain = np.linalg.solve(elasticity(material), (trial - ours)[edge].T).T
        sin_psi = np.sin(np.radians(material.dilation_deg))
        plane = -strain[:, 2] / (1.0 - sin_psi)
        bulk = material.lame + 2.0 / 3.0 * material.shear_modulus
        opening = bulk * (strain[:, 0] - (1.0 + sin_psi) * plane)
        np.testing.assert_allclose(opened[edge], opening, atol=1e-10 * scale.max())
