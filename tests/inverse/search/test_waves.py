"""The search in waves with a forward model that is a formula and a knowledge that counts."""

from dataclasses import dataclass

import numpy as np

from inverse.posterior import Matrix
from inverse.search.waves import ModelRun, WaveSearch, filling


@dataclass(frozen=True, kw_only=True)
class Count:
    """How many runs there are."""

    runs: int = 0

    def updated(self, search: WaveSearch[ModelRun, "Count"]) -> "Count":
        return Count(runs=len(search.every))


def squared(points: Matrix, first: int) -> list[ModelRun]:
    """The squares of the parameters, and the number of the run."""
    return [ModelRun(point=each, numbers=np.append(each**2, first + row)) for row, each in enumerate(points)]


def test_waves_follow_until_there_is_no_next_one_or_the_budget_is_spent() -> None:
    known = tuple(squared(np.full((3, 2), 0.5), 100))
    search = WaveSearch(model=squared, knowledge=Count(), seed=1, budget=10, known=known)
    search = search.ran(filling(2, 3, search.generator(0), repeats=1))
    found = search.in_waves(lambda state: state.generator().random((4, 2)) if state.left else None)
    # Of the third wave two runs are left over; the known ones are no part of the budget.
    assert [each.runs for each in found.waves] == [7, 11, 13]
    assert found.left == 0
    np.testing.assert_array_equal(found.numbers[:, 2], [100, 101, 102, *range(10)])
    np.testing.assert_array_equal(found.numbers[:, :2], found.points**2)
    again = search.in_waves(lambda state: state.generator().random((4, 2)) if state.left else None)
    np.testing.assert_array_equal(again.points, found.points)
