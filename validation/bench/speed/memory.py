"""What `python -m validation.bench.speed.bench memory` measures: memory of a gradient over points and steps, each in a process."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.files import write_text
from gns.inference import SHIPPED
from validation.bench.speed.gradient_run import Took
from validation.bench.speed.memory_page import PICTURE, draw, page


@dataclass(frozen=True, kw_only=True)
class Case:
    """A gradient."""

    points: int
    steps: int
    kept: int = 0


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """A case that was not run to its end."""

    case: Case
    reason: str


Outcome = Took | LeftOut
Run = Callable[[Case], Outcome]

CASES = (
    *(Case(points=points, steps=10) for points in (1_000, 3_000, 10_000, 20_000, 50_000)),
    *(Case(points=points, steps=50) for points in (1_000, 3_000, 10_000)),
    *(Case(points=3_000, steps=40, kept=kept) for kept in (0, 10, 20, 40)),
    *(Case(points=1_000, steps=steps) for steps in (100, 200, 400)),
    Case(points=20_000, steps=50),
    Case(points=3_000, steps=400),
)
"""The most telling first: what does not fit into the time is left out at the end."""
LONG = tuple(Case(points=points, steps=400) for points in (10_000, 20_000))
BUDGET = 270.0
"""Seconds for `CASES`."""
START = 5.0
"""Seconds that a process takes to begin, about."""


def measure(out: Path, *, full: bool, model: Path = SHIPPED, threads: int = 1) -> str:
    """Run the cases, leave OUT/memory.md and its picture, and return the former; `full` runs the long ones too."""
    begin = time.perf_counter()

    def run(case: Case) -> Outcome:
        return apart(case, model, threads)

    outcomes = study([*CASES, *(LONG if full else ())], run, budget=float("inf") if full else BUDGET)
    done = [each for each in outcomes if isinstance(each, Took)]
    missing = [(each.case.points, each.case.steps, each.reason) for each in outcomes if isinstance(each, LeftOut)]
    text = page(done, missing, model=model.stem, threads=threads, full=full)
    text += f"All of this took {time.perf_counter() - begin:.0f} s.\n"
    draw(out / PICTURE, done)
    write_text(out / "memory.md", text)
    return text


def study(cases: Iterable[Case], run: Run, *, budget: float) -> list[Outcome]:
    """Run the cases one after the other; those that would not end within `budget` seconds are left out.

    What a case will take is judged by the cases before, per point and step.
    """
    outcomes: list[Outcome] = []
    begin = time.perf_counter()
    with tqdm(list(cases), desc="memory", unit="case", dynamic_ncols=True) as bar:
        for case in bar:
            bar.set_postfix_str(f"{case.points:,} points, {case.steps} steps")
            expected = START + rate(outcomes) * case.points * case.steps
            if time.perf_counter() - begin + expected > budget:
                outcomes.append(LeftOut(case=case, reason=f"not run, {expected:.0f} s"))
            else:
                outcomes.append(run(case))
    return outcomes


def rate(outcomes: Iterable[Outcome]) -> float:
    """Seconds per point and step, the slowest of what was run."""
    return max((each.seconds / (each.points * each.steps) for each in outcomes if isinstance(each, Took)), default=0.0)


def apart(case: Case, model: Path, threads: int) -> Outcome:
    """Run a case in a process of its own. Raises WorkFailed."""
    arguments = [str(case.points), str(case.steps), "--kept", str(case.kept), "--model", str(model)]
    done = subprocess.run(
        [sys.executable, "-m", "validation.bench.speed.gradient_run", *arguments, "--threads", str(threads)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == -signal.SIGKILL:
        return LeftOut(case=case, reason="killed, out of memory")
    if done.returncode != 0:
        raise WorkFailed(f"{case.points} points, {case.steps} steps: {done.stderr.strip().splitlines()[-1:]}")
    return Took(**json.loads(done.stdout))
