"""Runout, front, toe and profile of known deposits; what is said of a flow that is not what it seems."""

import dataclasses

import numpy as np
import pytest

from datasets.library import read_scene
from datasets.measures import FEWEST, fitted_front, front, height_profile, runout, toe, transport_distance
from datasets.particles import initial_particles
from datasets.remarks import remarks
from datasets.scene import Scene

SPACING = 0.005


def block(length: float, height: float) -> np.ndarray:
    """Points at the centres of squares of `SPACING` that fill a box at the left wall; positions [m], shape [N, 2]."""
    x = np.arange(SPACING / 2, length, SPACING)
    y = np.arange(SPACING / 2, height, SPACING)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def test_one_point_moves_the_runout_but_not_the_front() -> None:
    points = block(0.4, 0.2)
    before = front(points)
    points[0, 0] = 0.9
    assert runout(points) == pytest.approx(0.9)
    assert front(points) == pytest.approx(before, abs=1e-9)


@pytest.mark.parametrize("power", [1.0, 2.0, 3.0])
def test_of_few_particles_the_fitted_front_is_nearer_to_that_of_all(power: float) -> None:
    # Of deposits whose volume ahead of x falls with this power of the distance to the tip, at x = 1.
    stream, exact = np.random.default_rng(0), 1.0 - 0.005 ** (1.0 / power)
    fitted, plain = [], []
    for _ in range(400):
        points = 1.0 - stream.random((400, 2)) ** (1.0 / power)
        # Half of the particles stand for three quarters of the volume: each of those is there three times.
        volume = np.where(np.arange(400) < 200, 1.0, 3.0)
        fitted.append(fitted_front(points, volume) - exact)
        plain.append(float(np.quantile(np.repeat(points[:, 0], volume.astype(int)), 0.995)) - exact)
    assert abs(np.mean(fitted)) < 0.9 * abs(np.mean(plain)) < 0.02
    assert np.std(fitted) < 0.95 * np.std(plain)


def test_the_fitted_front_moves_with_the_deposit_and_needs_some_particles() -> None:
    points = block(0.4, 0.2)
    one = np.ones(len(points))
    assert fitted_front(points, one) == pytest.approx(front(points), abs=0.5 * SPACING)
    assert fitted_front(points + 0.1, one) == pytest.approx(fitted_front(points, one) + 0.1)
    few = np.random.default_rng(0).random((FEWEST - 1, 2))
    assert few[:, 0].min() < fitted_front(few, np.ones(len(few))) <= few[:, 0].max()
    assert fitted_front(points[:1], one[:1]) == points[0, 0]


def test_toe_of_a_uniform_block() -> None:
    # The last tenth of a block 0.4 m long is centred at 0.38 m, and at half its height.
    assert toe(block(0.4, 0.2)) == pytest.approx((0.38, 0.1))


def test_profile_conserves_volume() -> None:
    stream = np.random.default_rng(0)
    stations = np.linspace(0.0, 1.0, 21)
    points = stream.random((1000, 2))
    points[:3, 0] = [0.0, 1.0, 1.0 + 1e-7]
    assert np.trapezoid(height_profile(points, 2e-5, stations), stations) == pytest.approx(1000 * 2e-5)


def test_the_distance_of_deposits_is_that_of_their_parts() -> None:
    deposit = block(0.4, 0.1)
    one = np.ones(len(deposit))
    assert transport_distance(deposit, one, deposit + np.array([0.03, 0.0]), one) == pytest.approx(0.03)
    # Twice as long: each part is as far again from the wall, rms 0.4 / sqrt(3).
    long = deposit * np.array([2.0, 0.5])
    assert transport_distance(long, one, deposit, one) == pytest.approx(0.4 / np.sqrt(3.0), rel=0.02)
    # Each second column of particles, of twice the volume, is the same deposit to half a spacing; heights do not count.
    some = deposit[np.isin((deposit[:, 0] / SPACING).astype(int) % 2, 0)]
    assert transport_distance(some * np.array([1.0, 3.0]), np.full(len(some), 2.0), deposit, one) < SPACING
    # A quarter of the volume that flew on by 0.2 m.
    ahead = deposit.copy()
    ahead[deposit[:, 0] > 0.3, 0] += 0.2
    assert transport_distance(ahead, one, deposit, one) == pytest.approx(0.1, rel=0.02)


SCENE = read_scene("column-short-21")


def said(scene: Scene = SCENE, *, x: float = 0.0, energy: float = 0.0, outflow: dict[str, float] | None = None) -> str:
    """Remarks on the column moved by `x` [m], whose kinetic energy ends at `energy` [J/m]."""
    particles = initial_particles(scene)
    deposit = particles.positions + np.array([x] + [0.0] * (scene.dimension - 1))
    kinetic = np.array([0.0, 10.0, energy])
    return "\n".join(remarks(scene, particles, deposit, kinetic=kinetic, end_time=1.0, outflow=outflow or {}))


def test_of_a_deposit_at_rest_in_a_large_box_nothing_is_said() -> None:
    assert said(x=0.1) == ""


def test_a_flow_that_still_moves_is_said_with_its_speed() -> None:
    assert "not at rest: at t = 1 s" in said(energy=1.0)
    assert said(energy=1e-7) == ""


def test_a_wall_that_holds_the_front_is_named_but_not_the_one_it_stood_at() -> None:
    mass = SCENE.masses[0]
    room = SCENE.domain.size[0] - mass.lower[0] - mass.size[0]
    assert "the side x+ of the box holds" in said(x=room)
    assert "x-" not in said()
    opened = dataclasses.replace(SCENE, open_sides=("x+",))
    assert "x+" not in said(opened, x=room)
    assert "left the box through its open side x+" in said(opened, outflow={"x+": 1.0})


@pytest.mark.parametrize(("cells", "thin"), [(2.0, True), (5.0, False)])
def test_a_body_of_fewer_than_three_cells_is_said(cells: float, thin: bool) -> None:
    mass = dataclasses.replace(SCENE.masses[0], size=(SCENE.masses[0].size[0], cells * SCENE.domain.cell))
    assert ("masses[0]" in said(dataclasses.replace(SCENE, masses=(mass,)))) is thin
