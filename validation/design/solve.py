"""A robust design by the MPM, from a problem to the files of its result."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.flow.trajectory import Trajectory
from datasets.lock import locked
from inverse.forward import Simulate
from inverse.posterior import Matrix, Row
from inverse.search.waves import jitter_seed
from mpm import ALL, LAST, simulate_many
from validation.design.problem import DesignProblem, read_design
from validation.design.report import save
from validation.design.search import Design, designed
from validation.runs import RunStore, caveats


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
    limit = asked.limit
    with tempfile.TemporaryDirectory() as temporary, locked(Path(out or temporary)) as folder:
        store = RunStore(folder / "mpm" / limit.folder, simulate, label="design-", reduce=limit.kept)
        flows = list[Trajectory]()

        def respond(points: Matrix, first: int) -> Row:
            values = asked.box.at(np.round(points, 6))
            jitters = [jitter_seed(asked.scene.seed, first + index) for index in range(len(points))]
            scenes = [asked.scene_at(row, jitter) for row, jitter in zip(values, jitters, strict=True)]
            flows[:] = store(scenes, record=ALL if limit.force else LAST)
            return np.array([each.summary[limit.quantity] for each in flows])

        found = designed(asked, respond)
        # The last flows are those of the check.
        remarks = caveats(flows)
        # On deposits, which a force does not depend on.
        if remarks and not limit.force:
            found = replace(found, remark=remarks[0])
        if out is not None:
            save(found, folder)
    return found
