"""Observations: the smooth forms against the exact ones, and their gradients against central differences."""

import numpy as np
import pytest
import torch
from scipy.stats.mstats import hdquantiles

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from inverse.observations import Observation, build
from inverse.observations.deposit import Deposit
from inverse.observations.observation import harrell_davis
from inverse.observations.profile import SHARES
from inverse.observations.toe import Toe
from inverse.settings import ObservationSettings

SCENE = Scene(
    domain=Domain(size=(1.0, 0.5), cell=0.01),
    material=Material(friction_deg=30.0),
    masses=(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)),),
)
CELL_VOLUME = 1.0e-4


def deposit(points: int, seed: int = 0) -> np.ndarray:
    """A wedge 0.6 m long [m], shape [points, 2]."""
    stream = np.random.default_rng(seed)
    return np.stack([0.6 * (1.0 - np.sqrt(stream.random(points))), 0.1 * stream.random(points)], axis=1)


def made(kind: str) -> Observation:
    return build(ObservationSettings(kind=kind, line=0.3 if kind == "passed" else None), SCENE)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_quantile_is_harrell_and_davis(seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=300)
    ours = harrell_davis(torch.from_numpy(values), torch.ones(300), 0.995).item()
    assert ours == pytest.approx(float(hdquantiles(values, [0.995])[0]), rel=1e-9)


@pytest.mark.parametrize(
    ("kind", "within"),
    [("front", 0.005), ("runout", 0.01), ("toe", 0.003), ("passed", 0.005)],
)
def test_the_smooth_form_of_all_points_is_near_the_exact_one(kind: str, within: float) -> None:
    positions = deposit(3200)
    smooth = made(kind).smooth(torch.from_numpy(positions), torch.ones(3200)).numpy()
    assert smooth == pytest.approx(made(kind).exact(positions), abs=within)


def test_a_profile_says_behind_which_x_a_share_of_the_points_lies() -> None:
    positions = deposit(3200)
    required = np.quantile(positions[:, 0], SHARES)
    np.testing.assert_allclose(made("profile").exact(positions), required, atol=0.004)


def test_a_deposit_moved_is_a_profile_moved() -> None:
    """Heights of fronts that do not overlap would not tell how far they are apart."""
    positions, profile = deposit(3200) + np.array([0.1, 0.0]), made("profile")
    for distance in (0.02, 0.1, 0.2):
        moved = profile.exact(positions + np.array([distance, 0.0])) - profile.exact(positions)
        np.testing.assert_allclose(moved, distance, atol=1e-3)


def test_the_smooth_profile_is_the_exact_one() -> None:
    positions, profile = deposit(800), made("profile")
    smooth = profile.smooth(torch.from_numpy(positions), torch.full((800,), CELL_VOLUME)).numpy()
    np.testing.assert_allclose(smooth, profile.exact(positions), rtol=1e-9)


def test_a_profile_weighs_points_by_their_volume() -> None:
    x = torch.from_numpy(np.random.default_rng(3).random((400, 2)) * 0.6)
    volumes = torch.ones(400)
    volumes[:100] = 2.0
    profile = made("profile")
    twice = profile.smooth(torch.cat([x, x[:100]]), torch.ones(500)).numpy()
    np.testing.assert_allclose(profile.smooth(x, volumes).numpy(), twice, rtol=1e-9)


@pytest.mark.parametrize("kind", ["front", "runout", "profile", "toe", "deposit", "passed"])
def test_gradients_agree_with_central_differences(kind: str) -> None:
    observation, volumes = made(kind), torch.ones(300)
    weights = torch.from_numpy(np.random.default_rng(5).normal(size=len(observation.exact(deposit(300)))))

    def stretched(factor: torch.Tensor) -> torch.Tensor:
        return (weights * observation.smooth(torch.from_numpy(deposit(300)) * factor, volumes)).sum()

    factor = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(stretched(factor), factor)
    step = 1.0e-7
    difference = (stretched(factor.detach() + step) - stretched(factor.detach() - step)) / (2.0 * step)
    assert gradient.item() == pytest.approx(difference.item(), rel=1e-5)


def test_the_smooth_toe_is_a_tenth_of_the_volume() -> None:
    """Two piles of equal points, the further one a tenth of the volume: the toe is its centroid, whatever it weighs."""
    toe = Toe(SCENE)
    far = torch.rand(50, 2, dtype=torch.float64) * 0.01 + torch.tensor([0.8, 0.2])
    near = torch.rand(100, 2, dtype=torch.float64) * 0.01
    volumes = torch.cat([torch.full((50,), 1.0), torch.full((100,), 4.5)])
    seen = toe.smooth(torch.cat([far, near]), volumes)
    torch.testing.assert_close(seen, far.mean(dim=0), rtol=0.0, atol=1e-6)


def test_the_toe_depends_on_which_points_belong_to_it() -> None:
    """A point that is overtaken takes its height along: moving it along x alone moves the toe's y."""
    positions = torch.from_numpy(deposit(400)).requires_grad_()
    (gradient,) = torch.autograd.grad(Toe(SCENE).smooth(positions, torch.ones(400))[1], positions)
    assert gradient[:, 0].abs().max() > 1e-3


def test_the_loss_of_points_is_their_mean_squared_distance() -> None:
    required, found = deposit(200, seed=0), deposit(200, seed=1)
    whole = Deposit(SCENE)
    expected = np.mean(np.sum((found - required) ** 2, axis=1))
    assert whole.misfit(whole.exact(found), whole.exact(required)) == pytest.approx(expected)
    some = np.array([3, 17, 90])
    part = whole.of_particles(whole.exact(required), some)
    np.testing.assert_array_equal(part, required[some].ravel())
    toe = Toe(SCENE)
    apart = toe.exact(found) - toe.exact(required)
    assert toe.misfit(toe.exact(found), toe.exact(required)) == pytest.approx(float(apart @ apart))
