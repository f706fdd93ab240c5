"""Searches by formulas: the inversion by one forward model, with its gradient and without; waves of runs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from datasets.scene.grid_field import Floats
from inverse.posterior import Matrix
from inverse.problem import Problem
from inverse.search.descent import inverted
from inverse.search.inference import Inversion
from inverse.search.waves import ModelRun, WaveSearch, filling
from tests.inverse.flows import problem_of, target_of

NAMES = ("friction_deg", "masses[0].velocity_x")


class Formula:
    """Many lengths [m] that are a matrix times the parameters in their ranges, and some of their square."""

    def __init__(self, problem: Problem, curvature: float = 0.3) -> None:
        self.box, self.curvature, self.runs = problem.box, curvature, 0
        self.matrix = torch.from_numpy(np.random.default_rng(0).normal(size=(12, len(problem.names))))

    def formula(self, parameters: Tensor) -> Tensor:
        share = (parameters - torch.from_numpy(self.box.lower)) / torch.from_numpy(self.box.range)
        return 0.1 * (share + self.curvature * share**2) @ self.matrix.T

    def observe(self, parameters: Sequence[Floats]) -> list[Floats]:
        self.runs += len(parameters)
        return [self.formula(torch.from_numpy(point)).numpy() for point in parameters]

    def select(self, target: Floats) -> Floats:
        return target

    def errors(self, parameters: Floats) -> Floats:
        return np.zeros((0, 1))


class WithGradient(Formula):
    def predict(self, parameters: Tensor) -> Tensor:
        self.runs += len(parameters)
        return self.formula(parameters)


class WithOneSlope(WithGradient):
    """As a parameter that makes other particles is none of torch's."""

    def predict(self, parameters: Tensor) -> Tensor:
        return super().predict(torch.cat([parameters[:, :1], parameters[:, 1:].detach()], dim=1))


def inversion(problem: Problem, forward: Formula, truth: Floats) -> Inversion:
    (values,) = forward.observe([truth])
    forward.runs = 0
    return inverted(forward, problem, target_of(values, 1e-3), np.zeros(len(values)), rough=1.0)


@pytest.mark.parametrize("made", [Formula, WithGradient, WithOneSlope])
@pytest.mark.parametrize("share", [(0.2, 0.9), (0.7, 0.05)])
def test_the_truth_in_few_runs(made: type[Formula], share: tuple[float, float]) -> None:
    problem = problem_of(2, *NAMES)
    truth = problem.box.lower + np.array(share) * problem.box.range
    forward = made(problem)
    result = inversion(problem, forward, truth)
    (answer,) = result.answers
    # The half-width of a linear fit of twelve numbers of 1 mm to slopes of some 0.1 m.
    np.testing.assert_array_less(np.abs(answer.point - share), np.maximum(answer.half_widths, 0.01))
    assert answer.half_widths.max() < 0.05
    assert forward.runs == len(result.runs) < 24


def test_both_roots_of_an_even_formula_are_answers() -> None:
    """y = (v - 1/2)^2 of one parameter."""

    class Even(Formula):
        def formula(self, parameters: Tensor) -> Tensor:
            share = (parameters - torch.from_numpy(self.box.lower)) / torch.from_numpy(self.box.range)
            return (share - 0.5) ** 2 * torch.ones(4, dtype=torch.float64)

    problem = problem_of(2, NAMES[0])
    result = inversion(problem, Even(problem), problem.box.lower + 0.25 * problem.box.range)
    assert sorted(answer.point[0] for answer in result.answers) == pytest.approx([0.25, 0.75], abs=0.02)


def test_parameters_beyond_the_bounds_end_on_them() -> None:
    problem = problem_of(2, *NAMES)
    forward = Formula(problem, curvature=0.0)
    result = inversion(problem, forward, problem.box.upper + 0.2 * problem.box.range)
    best = result.minima[int(np.argmin(result.misfits(result.minima)))]
    assert best.max() == pytest.approx(1.0, abs=0.01)


@dataclass(frozen=True, kw_only=True)
class Count:
    """How many runs there are."""

    runs: int = 0

    def updated(self, search: WaveSearch[ModelRun, "Count"]) -> "Count":
        return Count(runs=len(search.every))


def squared(points: Matrix, first: int) -> list[ModelRun]:
    """The squares of the parameters, and the number of the run."""
    return [ModelRun(point=point, numbers=np.append(point**2, first + row)) for row, point in enumerate(points)]


def test_waves_follow_until_there_is_no_next_one_or_the_budget_is_spent() -> None:
    earlier = tuple(squared(np.full((3, 2), 0.5), 100))
    search = WaveSearch(model=squared, knowledge=Count(), seed=1, budget=10, known=earlier)
    search = search.ran(filling(2, 3, search.generator(0), repeats=1))
    ended = search.in_waves(lambda state: state.generator().random((4, 2)) if state.left else None)
    # Of the third wave two runs are left over; the known ones are no part of the budget.
    assert [wave.runs for wave in ended.waves] == [7, 11, 13]
    assert ended.left == 0
    np.testing.assert_array_equal(ended.numbers[:, 2], [100, 101, 102, *range(10)])
    np.testing.assert_array_equal(ended.numbers[:, :2], ended.points**2)
    again = search.in_waves(lambda state: state.generator().random((4, 2)) if state.left else None)
    np.testing.assert_array_equal(again.points, ended.points)
