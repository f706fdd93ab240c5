"""`python -m validation.bench.stability --out docs`: scenes that break other solvers, a verdict for each."""

import difflib
import sys
import time
from pathlib import Path

from tqdm import tqdm

from datasets.command_line import WorkFailed, run
from datasets.errors import InputError
from datasets.files import write_text
from mpm.arrays.layout import Precision
from validation.bench.stability.case import Case
from validation.bench.stability.cases import CASES
from validation.bench.stability.critical_height import CRITICAL, bracket
from validation.bench.stability.deposit import AGREEMENT, DEVIATIONS
from validation.bench.stability.flows import Flow, front_scatter, simulate_scenes
from validation.bench.stability.probes import probe
from validation.bench.stability.report import document
from validation.bench.stability.verdict import PRECISIONS, judge


def command(*names: str, out: Path | None = None) -> None:
    """Run the hard cases in f32 and f64 and check what has to hold; exit status 1 if a row is red.

    Parameters
    ----------
    names
        Rows to run, named as their scenes in validation/hard_cases; all unless given.
    out
        Folder for stability.md.
    """
    began = time.perf_counter()
    cases = chosen(names)
    scenes = {case.name: case.scene for case in cases}
    until_rest = {case.name for case in cases if case.until_rest}
    with tqdm(total=2 * len(cases), unit="row", desc="hard cases") as bar:
        flows: dict[Precision, dict[str, Flow]] = {precision: {} for precision in PRECISIONS}
        for precision in PRECISIONS:
            for dimension in (2, 3):
                alike = {name: scene for name, scene in scenes.items() if scene.dimension == dimension}
                flows[precision] |= simulate_scenes(alike, precision, bar, until_rest)
        within = {case.name: DEVIATIONS * front_scatter(case.scene) for case in cases if case.sprays}
        verdicts = [judge(case, flows, within=within.get(case.name, AGREEMENT)) for case in cases]
        red = [verdict.case for verdict in verdicts if not verdict.all_green]
        probes = probe(cases, red, bar)
    heights = [bracket(case.scene) for case in cases if case.name in CRITICAL]
    asked = " ".join(["python -m validation.bench.stability", *names])
    text = document(verdicts, probes, heights, asked, time.perf_counter() - began)
    print(text, end="")
    if out is not None:
        write_text(out / "stability.md", text)
    if red:
        raise WorkFailed(f"red rows: {', '.join(case.name for case in red)}")


def chosen(names: tuple[str, ...]) -> list[Case]:
    """The rows of these names, all where there are none, and those that they are compared with. Raises InputError."""
    known = {case.name: case for case in CASES}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(known)}"
            raise InputError(f"expected the name of a row: {hint}", where=name)
    wanted = {*names, *(known[name].beside for name in names)} if names else known.keys()
    return [case for case in CASES if case.name in wanted]


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.stability"))
