"""Problems for fields: what ships is read, nodes and priors are what was stated, mistakes are named in a line."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from datasets.errors import InputError
from inverse.fields.problem import PROBLEMS, FieldTarget, SearchSettings, read_problem
from inverse.fields.unknown import BAND, FieldSettings
from tests.inverse.fields.tiny import PROBLEM, SCENE, files, tiny


@pytest.mark.parametrize("name", sorted(path.stem for path in PROBLEMS.glob("*.toml")))
def test_what_ships_is_read(name: str) -> None:
    problem = read_problem(name)
    assert problem.truth is not None
    assert 100 <= sum(int(each.inside.sum()) for each in problem.unknowns) <= 400


def test_nodes_cover_the_body_and_do_not_vary_along_a_short_axis(tmp_path: Path) -> None:
    friction, velocity = tiny(tmp_path).unknowns
    assert friction.grid.nodes == (7, 3)
    np.testing.assert_allclose(friction.grid.positions[[0, -1]], [[0.1, 0.0], [0.22, 0.04]])
    assert velocity.grid.nodes == (7, 1)
    assert velocity.grid.origin == pytest.approx((0.1, 0.02))
    assert friction.inside.all()


def test_the_stated_median_and_band_of_a_field_between_bounds(tmp_path: Path) -> None:
    friction, velocity = tiny(tmp_path).unknowns
    zero = np.zeros(friction.grid.count)
    assert friction.values(zero) == pytest.approx(28.0)
    ends = [friction.values(zero + sign * BAND * friction.prior.deviation)[0] for sign in (1.0, -1.0)]
    assert ends[0] - ends[1] == pytest.approx(2.0 * BAND * 5.0)
    assert friction.values(zero + 1e3) == pytest.approx(45.0)
    slope = (friction.values(zero + 0.5 + 1e-6) - friction.values(zero + 0.5 - 1e-6)) / 2e-6
    np.testing.assert_allclose(friction.slope(zero + 0.5), slope, rtol=1e-7)
    assert velocity.values(np.array([0.1])) == pytest.approx(0.7)


def test_the_unknown_kinds_of_a_scene_are_a_truth_alone(tmp_path: Path) -> None:
    problem = tiny(tmp_path)
    zero = [np.zeros(each.grid.count) for each in problem.unknowns]
    friction, velocity = problem.scene_at(zero, seed=7).fields
    np.testing.assert_allclose(friction.values, 28.0, rtol=1e-9)
    np.testing.assert_allclose(velocity.values, 0.6, rtol=1e-9)
    assert problem.scene_at(zero, seed=7).seed == 7
    assert problem.truth == list(problem.scene.fields)
    used = {*problem.seeds, *problem.scatter_seeds, problem.target.seed}
    assert len(used) == 2 + 6 + 1


def test_a_truth_that_is_drawn_has_the_prior(tmp_path: Path) -> None:
    problem = tiny(tmp_path)
    drawn = []
    for draw in range(60):
        target = dataclasses.replace(problem.target, draw=draw)
        drawn.append((dataclasses.replace(problem, target=target).truth or [])[1].values)
    assert np.mean(drawn) == pytest.approx(0.6, abs=0.1)
    assert np.std(drawn) == pytest.approx(0.3, rel=0.15)


@pytest.mark.parametrize(
    ("before", "after", "key"),
    [
        ('quantity = "friction_deg"', 'quantity = "porosity"', "fields[0].quantity"),
        ('quantity = "friction_deg"', 'kind = "friction_deg"', "fields[0].kind"),
        ("spacing = [0.02, 0.02]", "spacing = [0.02]", "fields[0].spacing"),
        ("spacing = [0.02, 0.02]", "spacing = [0.04, 0.02]", "fields[0].length"),
        ("mean = 28.0", "mean = 50.0", "fields[0].mean"),
        ("deviation = 5.0", "deviation = 0.0", "fields[0].deviation"),
        ("deviation = 5.0", "deviation = 9.0", "fields[0].deviation"),
        ("lower = 10.0", "lower = -1.0", "fields[0].lower"),
        ("lower = 10.0\n", "", "fields[0].lower"),
        ("upper = 45.0", "upper = 95.0", "fields[0].upper"),
        ("mean = 0.6", "mean = 0.6\nmass = 1", "fields[1].mass"),
        ("times = [0.0525]", "times = [0.02, 0.04]", "observations[0].times"),
        ("times = [0.0525]", "times = [0.2]", "observations[0].times"),
        ('kind = "height"', 'kind = "depth"', "observations[1].kind"),
        ("twin = true", "", "observations[0]"),
        ("twin = true", "twin = true\nseed = 1", "target.seed"),
        ("twin = true", 'twin = true\ntrajectory = "run.npz"', "target"),
        ("twin = true", 'draw = 3\ntrajectory = "run.npz"', "target.draw"),
        ("ensemble = 6", "ensemble = 2", "search.ensemble"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, before: str, after: str, key: str) -> None:
    with pytest.raises(InputError) as error:
        read_problem(files(tmp_path, PROBLEM.replace(before, after, 1)))
    assert error.value.key == key
    assert str(tmp_path / "problem.toml") in str(error.value)


def test_a_force_is_refused(tmp_path: Path) -> None:
    scene = SCENE + '[[solids]]\nname = "block"\nkind = "box"\nlower = [0.4, 0.0]\nsize = [0.05, 0.1]\n'
    observed = '[[observations]]\nkind = "impulse"\nsolid = "block"\nnoise = 1.0\n'
    with pytest.raises(InputError) as error:
        read_problem(
            files(tmp_path, PROBLEM.split("[[observations]]")[0] + observed + "[target]\ntwin = true\n", scene)
        )
    assert error.value.key == "observations[0].kind"


def test_a_twin_has_a_truth(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        read_problem(files(tmp_path, scene=SCENE.split("[[fields]]")[0]))
    assert error.value.key == "fields[0].quantity"


def test_initial_stress_beside_an_unknown_friction_is_refused(tmp_path: Path) -> None:
    scene = SCENE.replace("velocity = [0.5, 0.0]", "k0 = 0.5")
    with pytest.raises(InputError) as error:
        read_problem(files(tmp_path, scene=scene))
    assert error.value.key == "scene.masses[0].k0"


def test_bounds_above_the_dilation(tmp_path: Path) -> None:
    scene = SCENE.replace("friction_deg = 30.0\n", "friction_deg = 30.0\ndilation_deg = 12.0\n")
    with pytest.raises(InputError, match="dilation") as error:
        read_problem(files(tmp_path, scene=scene))
    assert error.value.key == "fields[0].lower"


PAGE = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")


def test_every_key_is_on_the_page_and_its_problem_is_read(tmp_path: Path) -> None:
    section = PAGE.split("\n## A problem for fields\n")[1].split("\n## ")[0]
    (text,) = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)
    (tmp_path / "mine.toml").write_text(text)
    assert len(read_problem(str(tmp_path / "mine.toml")).observations) == 2
    for kind in (FieldSettings, FieldTarget, SearchSettings):
        for each in dataclasses.fields(kind):
            assert f"`{each.name}" in section, each.name
            if kind is SearchSettings:
                assert f"`{each.name}` ({each.default})" in section
