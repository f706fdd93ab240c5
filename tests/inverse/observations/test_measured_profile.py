"""Measured profiles: one deposit written down in many ways is one target; what is none is refused with the reason."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from datasets import Baffle, Mass, Solid
from inverse import Parameter, Problem, TargetSettings, read_problem
from inverse.observations import ProfileSettings
from inverse.observations.measured_profile import Heights
from inverse.observations.profile import REPRESENTATION
from inverse.observations.target import Target
from inverse.target import read_target
from tests.inverse.observations.test_observations import never
from tests.refusals import refused
from tests.scenes import scene_of

X = np.linspace(0.0, 0.48, 25)
HEIGHT = np.maximum(0.0, 0.4 * (1.0 - X / 0.42))
"""A triangle of 0.084 m^2, a twentieth more than the column of 0.2 m x 0.4 m that was released."""


def measured(folder: Path, x: np.ndarray = X, height: np.ndarray = HEIGHT, **settings: object) -> Problem:
    """The problem whose target is a CSV of these rows."""
    rows = "".join(f"{a:.9g},{b:.9g}\n" for a, b in zip(x, height, strict=True))
    (folder / "profile.csv").write_text("x,height\n" + rows)
    seen = {"observations": (ProfileSettings(csv="profile.csv", **settings),), "target": TargetSettings()}
    return dataclasses.replace(read_problem("friction-tall-42"), folder=folder, **seen)


def target_of(problem: Problem) -> Target:
    return read_target(problem, never)


@pytest.mark.parametrize(
    ("x", "height", "settings"),
    [
        (100.0 * X, 100.0 * HEIGHT, {"unit": "cm"}),
        (X / 0.3048, HEIGHT / 0.3048 - 3.0, {"unit": "ft", "datum": -3.0}),
        (X[:21], HEIGHT[:21], {}),
        (X, HEIGHT, {"heights": Heights.SURFACE}),
    ],
)
def test_a_profile_is_the_same_target_however_it_is_written(
    x: np.ndarray, height: np.ndarray, settings: dict[str, object], tmp_path: Path
) -> None:
    plain = target_of(measured(tmp_path))
    np.testing.assert_allclose(target_of(measured(tmp_path, x, height, **settings)).values, plain.values, atol=1e-6)


def test_the_area_is_one_that_the_bounds_allow(tmp_path: Path) -> None:
    """Of an unknown height; other units are other areas, or higher than the box."""
    height = Parameter(name="masses[0].height", initial=0.4, lower=0.2, upper=0.5)

    def of(factor: float) -> Target:
        settings = measured(tmp_path, height=factor * HEIGHT)
        return target_of(dataclasses.replace(settings, parameters=(height,)))

    assert np.isfinite(of(0.5).values).all()
    refused(of, 0.1, said="0.9 to 1.1 times the area that was released, 0.04 to 0.1 m^2 within the bounds")
    refused(of, 100.0, said="heights up to that of the box")


def test_a_table_is_read_once(tmp_path: Path) -> None:
    problem = measured(tmp_path)
    (operator,) = problem.operators
    (tmp_path / "profile.csv").unlink()
    assert target_of(problem).observation is operator


@pytest.mark.parametrize(
    ("x", "height", "settings", "message"),
    [
        (1000.0 * X, 1000.0 * HEIGHT, {}, "got 480 m; check `unit`"),
        (X, 2.0 * HEIGHT, {}, "0.08 m^2, for equivalent heights, got 0.168 m^2, 2.1 times"),
        (X, HEIGHT, {"datum": 1.0}, "expected a height above the floor, got none"),
        (X[:12], HEIGHT[:12], {}, "ends at x = 0.22 m"),
        (np.array([0.0]), np.array([0.4]), {}, "at least two rows"),
    ],
)
def test_what_is_no_profile_of_this_flow_is_refused_with_the_reason(
    x: np.ndarray, height: np.ndarray, settings: dict[str, object], message: str, tmp_path: Path
) -> None:
    error = refused(lambda: target_of(measured(tmp_path, x, height, **settings)), said=message)
    assert error.where.endswith("profile.csv")


def test_noise_on_the_heights_is_that_of_what_is_compared(tmp_path: Path) -> None:
    """Deposits whose heights are drawn with it, and with the error of representation, scatter as the target says."""
    problem = measured(tmp_path, noise="3%")
    observation = problem.operators[0]
    target = target_of(problem)
    rng, seen = np.random.default_rng(7), []
    deviation = np.where(X < 0.43, np.hypot(0.03 * HEIGHT, REPRESENTATION * problem.scene.domain.cell), 0.0)
    for _ in range(400):
        heights = np.maximum(0.0, HEIGHT + deviation * rng.standard_normal(len(X)))
        seen.append(observation.of_heights(np.interp(observation.stations, X, heights, right=0.0)))
    drawn = np.cov(seen, rowvar=False)
    np.testing.assert_allclose(target.deviation, np.sqrt(np.diag(drawn)), rtol=0.15)
    np.testing.assert_allclose(target.deviation**2, np.diag(target.errors.matrix))


def test_a_surface_is_compared_with_the_deposits_surface(tmp_path: Path) -> None:
    """A deposit that lies looser where it is thin: its surface is not in proportion to its equivalent height."""
    observation = measured(tmp_path, heights=Heights.SURFACE).operators[0]
    rng = np.random.default_rng(6)
    x = 0.42 * (1.0 - np.sqrt(1.0 - rng.random(40_000)))
    surface = 0.4 * (1.0 - x / 0.42) * (1.0 + x / 0.42)
    deposit = np.stack([x, surface * rng.random(40_000)], axis=1)
    rows = observation.stations
    expected = np.maximum(0.0, 0.4 * (1.0 - rows / 0.42) * (1.0 + rows / 0.42))
    np.testing.assert_allclose(observation.heights(deposit), expected, atol=0.02)
    exact = observation.exact(deposit)
    np.testing.assert_allclose(exact, observation.of_heights(expected), atol=0.012)
    equivalent = ProfileSettings().operator(observation.scene, rows)
    assert np.abs(equivalent.exact(deposit) - exact).max() > 0.02


def test_a_lattice_between_the_stations_has_a_surface_at_each(tmp_path: Path) -> None:
    observation = measured(tmp_path, heights=Heights.SURFACE).operators[0]
    between = (0.5 * (observation.fine[1:] + observation.fine[:-1])).astype(np.float32)
    layer = np.stack([between, np.full_like(between, 0.1)], axis=1)
    heights = observation.heights(layer)[1:]
    np.testing.assert_allclose(heights, 0.1, rtol=1e-6)


def test_elevations_over_terrain_are_heights_above_it(tmp_path: Path) -> None:
    plain = measured(tmp_path, heights=Heights.SURFACE)
    line = Solid(kind="terrain", points=((0.0, 0.3), (1.0, 0.1)), friction=0.4)
    raised = Mass(lower=(0.0, 0.32), size=(0.2, 0.4))
    scene = dataclasses.replace(plain.scene, solids=(line,), masses=(raised,))
    expected = target_of(plain)
    (tmp_path / "slope").mkdir()
    over = measured(tmp_path / "slope", X, HEIGHT + 0.3 - 0.2 * X + 5.0, heights=Heights.ELEVATION, datum=5.0)
    over = dataclasses.replace(over, scene=scene)
    np.testing.assert_allclose(target_of(over).values, expected.values, atol=1e-6)
    rng = np.random.default_rng(8)
    deposit = np.stack([0.4 * rng.random(20_000), 0.05 * rng.random(20_000)], axis=1)
    moved = deposit + np.stack([np.zeros(20_000), 0.3 - 0.2 * deposit[:, 0]], axis=1)
    seen = over.operators[0].exact(moved)
    np.testing.assert_allclose(seen, plain.operators[0].exact(deposit), atol=1e-6)


def test_a_gap_in_the_rows_is_no_mistake(tmp_path: Path) -> None:
    """A straight slope is the same with a gap in it, of blank cells or blank rows."""
    whole = target_of(measured(tmp_path))
    text = (tmp_path / "profile.csv").read_text().splitlines()
    for blank in ("", ",", f"{X[8]:.9g},"):
        lines = [line if not 6 <= number - 1 <= 12 else blank for number, line in enumerate(text)]
        (tmp_path / "profile.csv").write_text("\n".join(lines) + "\n")
        scene = read_problem("friction-tall-42").scene
        gapped = ProfileSettings(csv="profile.csv").read(scene, tmp_path, (0.08, 0.08))
        assert gapped.profile.gaps.sum() == 1
        np.testing.assert_allclose(gapped.values, whole.values, atol=1e-9)


@pytest.mark.parametrize("heights", [Heights.EQUIVALENT, Heights.SURFACE])
def test_a_profile_ends_at_a_solid(heights: Heights, tmp_path: Path) -> None:
    """A level layer 0.1 m high that leans on a plate at x = 0.6 m, over which a part of the material went."""
    mass, plate = Mass(lower=(0.0, 0.0), size=(0.2, 0.4)), Baffle(lower=(0.6, 0.0), size=(0.01, 0.12))
    scene = scene_of(mass, size=(1.0, 0.5), baffles=(plate,), cell=0.01)
    x = np.array([*np.arange(0.0, 0.3, 0.02), *np.arange(0.4, 0.6, 0.02)])
    rows = np.stack([x, np.full(len(x), 0.1)], axis=1)
    np.savetxt(tmp_path / "profile.csv", rows, delimiter=",", header="x,height", comments="")
    target = ProfileSettings(csv="profile.csv", heights=heights).read(scene, tmp_path, (0.08, 0.08))
    expected = 0.6 * np.array([*(0.025 + 0.05 * np.arange(20)), 0.995])
    np.testing.assert_allclose(target.values, expected, atol=1e-9)
    x, y = np.meshgrid(np.linspace(0.0005, 0.5995, 600), np.linspace(0.0005, 0.0995, 100), indexing="ij")
    held = np.stack([x.ravel(), y.ravel()], axis=1)
    over = np.random.default_rng(1).random((20_000, 2)) * [0.2, 0.05] + [0.75, 0.0]
    seen = target.observation.exact(np.concatenate([held, over]))
    np.testing.assert_allclose(seen, expected, atol=1e-3)
    # Without the plate such rows end in the middle of a deposit.
    bare = dataclasses.replace(scene, baffles=())
    read = ProfileSettings(csv="profile.csv").read
    refused(read, bare, tmp_path, 0.08, said="expected rows as far as the wall at x = 1 m")
