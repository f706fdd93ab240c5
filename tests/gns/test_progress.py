"""The time left is estimated from the work done."""

import pytest

from gns.training.budget import Budget
from gns.training.progress import Bar


def bar(**budget: float) -> Bar:
    """A bar without output, of a run that was resumed after 30 s."""
    return Bar(Budget(**{"minutes": 2.0, **budget}), (1, 1, 4, 4), seconds=30.0, batch=3, shown=False)


def test_the_remaining_time_of_a_budget_in_minutes_is_that_of_the_clock() -> None:
    assert bar().seconds_left(0.5, 60.0, wall=30.0) == pytest.approx(60.0)
    # A processor that this run has half of.
    assert bar().seconds_left(0.5, 60.0, wall=60.0) == pytest.approx(120.0)


def test_later_updates_count_longer() -> None:
    of_updates = bar(updates=8)
    for _ in range(4):
        of_updates.show(0.5, seconds=60.0, steps=1, loss=1.0)
    # Four steps took 10 s; four updates of four steps are left.
    assert of_updates.seconds_left(0.5, 60.0, wall=10.0) == pytest.approx(40.0)
