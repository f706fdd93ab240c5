"""The loop with a flow whose truth is a formula: it finds it although the surrogate is wrong, and says so when not."""

from pathlib import Path

import pytest

from inverse.problem import Observable
from inverse.result import Purpose, Result, Verdict
from validation.loop import Solved, solve


def solved(case, out: Path) -> Solved:  # type: ignore[no-untyped-def]
    return solve(case.problem, case.target, case.observation, out, case.source, case.mpm)


def checks(result: Result) -> int:
    return sum(run.purpose is Purpose.CHECK for run in result.mpm_runs)


@pytest.mark.parametrize("kind", list(Observable))
@pytest.mark.parametrize("truth", [16.0, 24.0, 42.0])
@pytest.mark.parametrize(("steepness", "offset"), [(1.0, 1.0), (3.0, 1.1), (1.0 / 3.0, 0.9), (1.0 / 3.0, 1.1)])
def test_a_wrong_surrogate_still_finds_the_truth(make_case, tmp_path, kind, truth, steepness, offset) -> None:  # type: ignore[no-untyped-def]
    case = make_case(truth=truth, kind=kind, steepness=steepness, offset=offset)
    result = solved(case, tmp_path).result
    print(
        result.answer, result.certainty, checks(result), result.front_error_pct, [r.unknowns for r in result.mpm_runs]
    )
    assert result.verdict is Verdict.CONFIRMED
    assert checks(result) <= case.problem.loop.mpm_runs
    assert result.unknowns["friction_deg"] == pytest.approx(truth, rel=0.01)
