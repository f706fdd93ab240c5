"""The return of all yield surfaces together: against enumeration, and continuous everywhere."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest

from datasets.material import Material
from tests.mpm.element import returned, returned_tensors, returned_whole
from tests.mpm.lcp import elasticity, lcp_return, lipschitz, surfaces

pytestmark = pytest.mark.double

Array = np.ndarray


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
        yield Material(
            friction_deg=friction,
            dilation_deg=share * friction,
            cohesion=cohesion,
            tension_cutoff=cutoff * apex,
            poisson=poisson,
        )


MATERIALS = list(materials())


@pytest.fixture(params=[MATERIALS[::5], pytest.param(MATERIALS, marks=pytest.mark.slow)], ids=["a fifth", "all"])
def table(request: pytest.FixtureRequest) -> list[Material]:
    """Every fifth material, which has all values of each property; the slow tests have all materials."""
    found: list[Material] = request.param
    return found


def unit(material: Material) -> float:
    """A stress in which the yield surface is neither large nor small [Pa]."""
    return max(material.cohesion, 1.0e3)


def trials(material: Material, random: np.random.Generator, count: int) -> Array:
    """Sorted trial stresses [Pa], shape [about `count`, 3], at many scales: anywhere, about the corner of the tension
    limit, and about the returned ones, that is faces, edges and corners."""
    size = unit(material) * 10.0 ** random.uniform(-2.0, 2.0, (count // 2, 1))
    anywhere = size * (random.normal(size=(count // 2, 3)) + random.normal(size=(count // 2, 1)))
    corner = material.tension_limit + 0.1 * anywhere[: count // 6]
    landed = returned(material, -np.sort(-anywhere[: count // 3], axis=1))
    near = 10.0 ** random.uniform(-8.0, 0.0, (len(landed), 1))
    landed = landed + near * unit(material) * random.normal(size=landed.shape)
    return -np.sort(-np.concatenate([anywhere, corner, landed]), axis=1)


def scale_of(material: Material, stresses: Array) -> Array:
    """The stresses that a difference is to be small against [Pa], shape [E]."""
    return np.abs(stresses).max(axis=1) + surfaces(material)[2].max()


def test_the_return_is_the_one_solution_of_the_complementarity_problem(table: list[Material]) -> None:
    """Enumeration finds a solution everywhere, only one, and it is the closed form; to 1e-9 of the stress."""
    random, found = np.random.default_rng(1), set()
    for material in table:
        trial = trials(material, random, 240)
        scale = scale_of(material, trial)
        exact, apart = lcp_return(material, trial)
        ours = returned(material, trial)
        assert (apart / scale).max() < 1e-8, material
        assert (np.abs(ours - exact).max(axis=1) / scale).max() < 1e-9, material
        normals, _, limits = surfaces(material)
        active = np.isclose(exact @ normals.T, limits, rtol=0.0, atol=1e-9 * unit(material))
        found |= {tuple(row) for row in active.tolist()}
    # Every kind of corner was there: none, plane, edges, cutoff with one, two, three stresses, and their meetings.
    assert len(found) >= 12


def test_the_return_is_continuous(table: list[Material]) -> None:
    """|s(a) - s(b)| <= L |a - b| for pairs (of all materials two million), L the stretch of a piece (below 2.1).

    The pairs are from 1e-9 to 10 of the stress apart, so a jump by a part in 1e8 of the stress would be seen.
    """
    random, pairs = np.random.default_rng(3), 0
    for material in table:
        bound = lipschitz(material)
        assert 1.0 <= bound < 2.1
        one = trials(material, random, 6000)
        apart = unit(material) * 10.0 ** random.uniform(-9.0, 1.0, (len(one), 1)) * random.normal(size=one.shape)
        other = -np.sort(-(one + apart), axis=1)
        change = np.linalg.norm(returned(material, one) - returned(material, other), axis=1)
        rounding = 1e-13 * (scale_of(material, one) + scale_of(material, other))
        over = change - bound * np.linalg.norm(one - other, axis=1) - rounding
        worst = int(np.argmax(over))
        assert over[worst] <= 0.0, (material, one[worst], other[worst])
        pairs += len(one)
    assert pairs > 5_900 * len(table)


@pytest.mark.parametrize("dilation_deg", [0.0, 12.0])
def test_without_cohesion_the_cheap_form_is_the_same(dilation_deg: float) -> None:
    sand = Material(friction_deg=33.0, dilation_deg=dilation_deg)
    trial = trials(sand, np.random.default_rng(5), 20_000)
    general, opened = returned_whole(sand, trial)
    cheap, cheap_opened = returned_whole(sand, trial, cohesive=False)
    scale = scale_of(sand, trial)
    assert (np.abs(general - cheap).max(axis=1) / scale).max() < 1e-12
    assert (np.abs(opened - cheap_opened) / scale).max() < 1e-12
    assert cheap.max() <= 0.0


def test_what_opening_cost_is_the_mean_that_dilation_did_not_take(table: list[Material]) -> None:
    """K times the sum of the cutoff's multipliers, where these are unique; all of the mean's change where psi = 0."""
    random = np.random.default_rng(6)
    for material in table:
        trial = trials(material, random, 600)
        ours, opened = returned_whole(material, trial)
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


def spun(principal: Array, width: int, random: np.random.Generator) -> Array:
    """Components of stresses with these principal values [E, 3] in random axes, out of plane fixed in 2D."""
    if width == 4:
        order = random.permuted(np.tile(np.arange(3), (len(principal), 1)), axis=1)
        a, b, z = np.take_along_axis(principal, order, axis=1).T
        angle = random.uniform(0.0, np.pi, len(a))
        radius, centre = (a - b) / 2, (a + b) / 2
        turned = radius * np.cos(2 * angle), radius * np.sin(2 * angle)
        return np.stack([centre + turned[0], centre - turned[0], z, turned[1]], axis=1)
    axes, _ = np.linalg.qr(random.normal(size=(len(principal), 3, 3)))
    full = axes @ (principal[:, :, None] * np.swapaxes(axes, 1, 2))
    return np.stack([full[:, 0, 0], full[:, 1, 1], full[:, 2, 2], full[:, 0, 1], full[:, 1, 2], full[:, 2, 0]], axis=1)


def norm(components: Array) -> Array:
    """Frobenius norm of the tensors [E, 4 or 6]."""
    return np.sqrt((components[:, :3] ** 2).sum(axis=1) + 2 * (components[:, 3:] ** 2).sum(axis=1))


@pytest.mark.parametrize("width", [4, 6])
def test_the_return_of_tensors_is_continuous(width: int) -> None:
    """The same bound: an isotropic function stretches as its principal values do, or as the ratio of gaps, below 1.

    In 3D, where principal stresses meet, these are known to half the digits: 1e-7 of the deviator is allowed.
    """
    random = np.random.default_rng(7)
    for material in MATERIALS[::2]:
        principal = trials(material, random, 1500)
        # Of a third two stresses are equal, or all.
        third = len(principal) // 3
        principal[:third, 1] = principal[:third, 0]
        principal[third // 2 : third, 2] = principal[third // 2 : third, 1]
        one = spun(principal, width, random)
        apart = unit(material) * 10.0 ** random.uniform(-9.0, 1.0, (len(one), 1)) * random.normal(size=one.shape)
        other = one + apart
        change = norm(returned_tensors(material, one) - returned_tensors(material, other))
        scale = norm(one) + norm(other) + surfaces(material)[2].max()
        over = change - lipschitz(material) * norm(apart) - (1e-12 if width == 4 else 1e-7) * scale
        assert over.max() <= 0.0, material


@pytest.mark.parametrize(("width", "digits"), [(4, 2e-6), (6, 2e-3)])
def test_single_precision_returns_tensors_as_double_does(width: int, digits: float) -> None:
    """Of the stress; near yield surfaces and where principal stresses meet alike."""
    random, cases = np.random.default_rng(8), []
    for material in MATERIALS[::5]:
        principal = trials(material, random, 1000)
        third = len(principal) // 3
        principal[:third, 1] = principal[:third, 0]
        one = spun(principal, width, random).astype(np.float32).astype(np.float64)
        cases.append((material, one, returned_tensors(material, one)))
    for material, one, exact in cases:
        single = returned_tensors(material, one, precision="f32")
        error = norm(single - exact) / (norm(one) + surfaces(material)[2].max())
        assert error.max() < digits, material
