"""A robust design by the MPM, from a problem to the files of its result."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.lock import locked
from inverse.forward import Simulate
from inverse.posterior import Matrix, Row
from inverse.search.waves import jitter_seed
from mpm import ALL, LAST, simulate_many
from validation.design.problem import DesignProblem, read_design
from validation.design.report import save
from validation.design.search import Design, designed
from validation.runs import RunStore


class Mpm:
    """Responses by the MPM, each flow with a jitter seed of its own, kept in `folder`."""

    def __init__(self, problem: DesignProblem, folder: Path, simulate: Simulate) -> None:
        limit = problem.limit
        self.problem, self.record = problem, ALL if limit.force else LAST
        self.store = RunStore(folder / limit.folder, simulate, label="design-", reduce=limit.kept)
        self.remarks: list[list[str]] = []
        """Of every flow so far."""

    def __call__(self, points: Matrix, first: int) -> Row:
        """Responses at points [n, K + Q] in fractions of the ranges, shape [n]; first: number of the first flow."""
        problem, values = self.problem, self.problem.box.at(np.round(points, 6))
        jitters = [jitter_seed(problem.scene.seed, first + index) for index in range(len(points))]
        scenes = [problem.scene_at(row, jitter) for row, jitter in zip(values, jitters, strict=True)]
        flows = self.store(scenes, record=self.record)
        self.remarks += [list(each.summary.get("remarks", [])) for each in flows]
        return np.array([each.summary[problem.limit.quantity] for each in flows])


def find_design(
    problem: DesignProblem | str | Path, out: Path | str | None = None, *, simulate: Simulate = simulate_many
) -> Design:
    """The cheapest design that keeps the limit as often as asked, checked by the MPM.

    >>> from validation import find_design
    >>> found = find_design("two-barriers", "out/design")
    >>> print(found.verdict, found.design, found.exceeding, found.interval)

    problem: one built in Python, the path of a TOML file or the name of a shipped one. out: folder for `design.json`,
    `report.md`, a picture and every flow, where an interrupted command goes on; without it nothing is written.
    simulate: in place of the MPM. Raises InputError, and WorkFailed where a run of the MPM blows up or another process
    writes into `out`.
    """
    asked = problem if isinstance(problem, DesignProblem) else read_design(problem)
    with tempfile.TemporaryDirectory() as temporary, locked(Path(out or temporary)) as folder:
        mpm = Mpm(asked, folder / "mpm", simulate)
        found = designed(asked, mpm)
        remarks = [lines[0] for lines in mpm.remarks[-asked.budget.checks :] if lines]
        # On deposits, which a force does not depend on.
        if remarks and not asked.limit.force:
            found = replace(found, remark=f"of {len(remarks)} flows of the check, such as: {remarks[0]}")
        if out is not None:
            save(found, folder)
    return found
