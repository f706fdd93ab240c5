"""`python -m validation.bench memory`: memory of a gradient over nodes and steps, each case in a process of its own."""

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from tqdm import tqdm

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from gns.inference import SHIPPED
from gns.model import checkpoint
from gns.model.simulator import Simulator
from gns.model.state import Conditions, State
from gns.unroll import step_activation_bytes, unroll
from validation.bench.speed import columns
from validation.bench.speed.columns import column
from validation.report.machine import GNS
from validation.report.memory import peak, reset_peak, resident
from validation.report.page import Page, Row
from validation.report.plots import ORANGE, figure, pane
from validation.report.process import OutOfMemory, isolated

PICTURE = "memory.png"
PAPER_NODES, PAPER_STEPS, PAPER_BYTES = 20_000, 400, 16.0e9
"""Where the reference paper's gradient no longer fits (its last figure and the discussion with it)."""


@dataclass(frozen=True, kw_only=True)
class GradientCase:
    """A gradient through a rollout."""

    nodes: int
    steps: int
    kept: int = 0
    """Steps whose activations stay in memory."""


@dataclass(frozen=True, kw_only=True)
class GradientCost:
    """Seconds and memory of a case; `left_out` says why it was not run to its end."""

    case: GradientCase
    forward: float = math.nan
    """[s]."""
    backward: float = math.nan
    """[s]."""
    before: int = 0
    """Held before: the interpreter, PyTorch, the model, the nodes [bytes]."""
    peak: int = 0
    """The most that was ever held, that included [bytes]."""
    activations: int = 0
    """Of one step, by `gns.unroll.step_activation_bytes` [bytes]."""
    left_out: str = ""

    @property
    def extra(self) -> int:
        """Peak above what was held before [bytes]."""
        return self.peak - self.before

    @property
    def seconds(self) -> float:
        """Forward and backward [s]."""
        return self.forward + self.backward


Run = Callable[[GradientCase], GradientCost]
CASES = (
    *(GradientCase(nodes=nodes, steps=10) for nodes in (1_000, 3_000, 10_000, 20_000, 50_000)),
    *(GradientCase(nodes=nodes, steps=50) for nodes in (1_000, 3_000, 10_000)),
    *(GradientCase(nodes=3_000, steps=40, kept=kept) for kept in (0, 10, 20, 40)),
    *(GradientCase(nodes=1_000, steps=steps) for steps in (100, 200, 400)),
    GradientCase(nodes=20_000, steps=50),
    GradientCase(nodes=3_000, steps=400),
)
"""The most informative first: what does not fit into the time is left out at the end."""
LONG = tuple(GradientCase(nodes=nodes, steps=400) for nodes in (10_000, PAPER_NODES))
QUICK = (*CASES[:2], GradientCase(nodes=1_000, steps=20), GradientCase(nodes=1_000, steps=20, kept=20))
BUDGET = 270.0
"""Seconds for `CASES`."""
START = 5.0
"""Seconds that a process takes to begin, about."""


def bench(out: Path, *, quick: bool, keep: Path, full: bool = False, threads: int = 1) -> str:
    """Measure what memory a gradient through a rollout takes, over nodes and steps; about five minutes.

    Parameters
    ----------
    out
        Folder for memory.md and its picture.
    quick
        Four small cases.
    keep
        Not used: times are of one run.
    full
        The gradients of many minutes too, 20,000 nodes through 400 steps among them.
    threads
        Threads of PyTorch.
    """
    if threads < 1:
        raise InputError(f"expected at least 1, got {threads}", key="--threads")
    cases = QUICK if quick else (*CASES, *(LONG if full else ()))
    run = partial(in_process, model=SHIPPED, threads=threads)
    found = study(cases, run, budget=math.inf if full else BUDGET)
    draw(out / PICTURE, [each for each in found if not each.left_out])
    command = f"python -m validation.bench memory{' --full' if full else ''} --threads {threads}"
    return page(found, model=SHIPPED.stem, command=command, quick=quick).write(out / "memory.md")


def study(cases: Iterable[GradientCase], run: Run, *, budget: float) -> list[GradientCost]:
    """Run the cases one after the other; those that would not end within `budget` seconds are left out.

    The seconds of a case are estimated from the slowest of the cases before, per node and step.
    """
    found: list[GradientCost] = []
    began = time.perf_counter()
    with tqdm(list(cases), desc="memory", unit="case", dynamic_ncols=True) as progress:
        for case in progress:
            progress.set_postfix_str(f"{case.nodes:,} nodes, {case.steps} steps")
            rates = [each.seconds / (each.case.nodes * each.case.steps) for each in found if not each.left_out]
            expected = START + max(rates, default=0.0) * case.nodes * case.steps
            if time.perf_counter() - began + expected > budget:
                found.append(GradientCost(case=case, left_out=f"not run, {expected:.0f} s"))
            else:
                found.append(run(case))
    return found


def in_process(case: GradientCase, *, model: Path, threads: int) -> GradientCost:
    """Run a case in a process of its own. Raises WorkFailed."""
    try:
        return isolated(run_case, case, model, threads)
    except OutOfMemory as error:
        return GradientCost(case=case, left_out=str(error))


def run_case(case: GradientCase, model: Path, threads: int) -> GradientCost:
    """Run one gradient in this process; kernels are compiled on a short rollout before."""
    torch.set_num_threads(threads)
    simulator = checkpoint.load(model).simulator.requires_grad_(False)
    gradient(simulator, *column(simulator.settings, min(case.nodes, 200)), 2, 1)
    state, conditions = column(simulator.settings, case.nodes)
    reset_peak()
    before = resident() or peak()
    forward, backward = gradient(simulator, state, conditions, case.steps, case.kept)
    most = peak()
    activations = step_activation_bytes(simulator, state, conditions)
    return GradientCost(
        case=case, forward=forward, backward=backward, before=before, peak=most, activations=activations
    )


def gradient(simulator: Simulator, state: State, conditions: Conditions, steps: int, kept: int) -> tuple[float, float]:
    """Seconds forward and backward of the gradient of the last mean position with respect to one friction for all."""
    began = time.perf_counter()
    friction = conditions.friction[0].clone().requires_grad_()
    unknown = dataclasses.replace(conditions, friction=friction.expand_as(conditions.friction))
    end = unroll(simulator, state, unknown, steps, kept_steps=kept)[-1, :, 0].mean()
    middle = time.perf_counter()
    end.backward()  # type: ignore[no-untyped-call]
    if friction.grad is None or not math.isfinite(friction.grad.item()):
        raise WorkFailed(f"the gradient through {steps} steps is no finite number")
    return middle - began, time.perf_counter() - middle


def page(found: Sequence[GradientCost], *, model: str, command: str, quick: bool = False) -> Page:
    """The page, from what was run and what was not."""
    done = [each for each in found if not each.left_out]
    text = Page(
        "Memory of a gradient through a rollout",
        command=command,
        conclusion=conclusion(done),
        packages=GNS,
        quick=quick,
    )
    text.text(f"""
        Model `{model}`: forward through a column's collapse, then the gradient of the last mean position with respect
        to the friction, weights frozen. The column is {columns.ACROSS[2]} nodes high and as long as its nodes require.
        Each case is a process of its own; its memory is the greatest resident size above what it held before
        (interpreter, PyTorch, model, nodes). A step leaves only its state; its activations are computed again in the
        backward pass, so that those of one step are held at a time.
    """)
    text.picture(PICTURE, "peak memory over nodes")
    text.section("Peak memory over nodes and steps")
    text.text("In MB, and the seconds of the whole gradient in brackets.")
    text.table(grid_rows(found))
    text.text("""
        The activations of a step, counted by `gns.unroll.step_activation_bytes`, and what a further step adds, between
        the fewest and the most steps that were run:
    """)
    text.table(step_rows(done))
    kept = kept_rows(done)
    if kept:
        text.section("Kept activations")
        text.text("Steps whose activations stay (`kept_steps`) are not computed again.")
        text.table(kept)
    return text


def conclusion(done: Sequence[GradientCost]) -> list[str]:
    """The largest case beside the paper's, and what nodes and steps add."""
    hardest = max(done, key=lambda each: each.case.nodes * each.case.steps)
    ours, process = hardest.extra / 1.0e9, hardest.peak / 1.0e9
    found = [
        f"The gradient through {hardest.case.steps} steps of {hardest.case.nodes:,} nodes takes {ours:.2g} GB"
        f" ({process:.2g} GB with the whole process) and {hardest.seconds / 60.0:.1f} minutes; the reference paper's"
        f" code exceeds {PAPER_BYTES / 1.0e9:g} GB at about {PAPER_NODES:,} nodes and up to {PAPER_STEPS} steps."
    ]
    if (hardest.case.nodes, hardest.case.steps) != (PAPER_NODES, PAPER_STEPS):
        found.append("That size itself was not run here (`--full` runs it).")
    widest = max(done, key=lambda each: each.case.nodes)
    found.append(
        f"At {widest.case.nodes:,} nodes the peak is {widest.extra / max(1, widest.activations):.1f} times the"
        " activations of one step."
    )
    return found


def grid_rows(found: Sequence[GradientCost]) -> list[Row]:
    """A line per number of nodes, a column per number of steps: megabytes and seconds."""
    plain = {(each.case.nodes, each.case.steps): each for each in found if each.case.kept == 0}
    steps = sorted({steps for _, steps in plain})

    def cell(nodes: int, number: int) -> str:
        each = plain.get((nodes, number))
        if each is None:
            return "-"
        return each.left_out or f"{each.extra / 1.0e6:,.0f} ({each.seconds:.0f} s)"

    return [
        {"nodes": f"{nodes:,}"} | {f"{number} steps": cell(nodes, number) for number in steps}
        for nodes in sorted({nodes for nodes, _ in plain})
    ]


def step_rows(done: Sequence[GradientCost]) -> list[Row]:
    """Per number of nodes: activations of a step, peak at the fewest steps, and what each further step adds."""
    rows: list[Row] = []
    plain = [each for each in done if each.case.kept == 0]
    for nodes in sorted({each.case.nodes for each in plain}):
        some = sorted((each for each in plain if each.case.nodes == nodes), key=lambda each: each.case.steps)
        fewest, most = some[0], some[-1]
        more = most.case.steps - fewest.case.steps
        rows.append(
            {
                "nodes": f"{nodes:,}",
                "activations of a step [MB]": f"{most.activations / 1.0e6:,.0f}",
                "peak at the fewest steps [MB]": f"{fewest.extra / 1.0e6:,.0f}",
                "each further step [MB]": f"{(most.extra - fewest.extra) / more / 1.0e6:.2f}" if more else "-",
            }
        )
    return rows


def kept_group(done: Sequence[GradientCost]) -> list[GradientCost]:
    """The cases of sizes that were run with kept activations too, by what is kept."""
    sizes = {(each.case.nodes, each.case.steps) for each in done if each.case.kept}
    some = [each for each in done if (each.case.nodes, each.case.steps) in sizes]
    return sorted(some, key=lambda each: (each.case.nodes, each.case.steps, each.case.kept))


def kept_rows(done: Sequence[GradientCost]) -> list[Row]:
    """Memory and seconds over the steps that are kept."""
    some = kept_group(done)
    none = {(each.case.nodes, each.case.steps): each.seconds for each in some if each.case.kept == 0}
    return [
        {
            "nodes": f"{each.case.nodes:,}",
            "steps": each.case.steps,
            "kept": each.case.kept,
            "peak memory [MB]": f"{each.extra / 1.0e6:,.0f}",
            "forward [s]": f"{each.forward:.1f}",
            "backward [s]": f"{each.backward:.1f}",
            "seconds over none kept": f"x {each.seconds / none[each.case.nodes, each.case.steps]:.2f}",
        }
        for each in some
    ]


def draw(path: Path, done: Sequence[GradientCost]) -> None:
    """Peak memory over nodes with a line per number of steps, and seconds over memory of kept activations."""
    with figure(path, columns=2, size=(5.2, 4.2)) as axes:
        left, right = pane(axes), pane(axes, 0, 1)
        plain = [each for each in done if each.case.kept == 0]
        for steps in sorted({each.case.steps for each in plain}):
            some = sorted((each for each in plain if each.case.steps == steps), key=lambda each: each.case.nodes)
            sizes = [each.extra / 1.0e9 for each in some]
            left.plot([each.case.nodes for each in some], sizes, "o-", ms=4, lw=1.2, label=f"{steps} steps")
        left.plot(PAPER_NODES, PAPER_BYTES / 1.0e9, "x", color=ORANGE, markersize=8, label="the paper's code fails")
        left.set_xscale("log")
        left.set_yscale("log")
        left.set_xlabel("nodes")
        left.set_ylabel("peak memory above the start [GB]")
        left.legend()
        some = kept_group(done)
        right.plot([each.extra / 1.0e9 for each in some], [each.seconds for each in some], "o-")
        for each in some:
            right.annotate(f"{each.case.kept} kept", (each.extra / 1.0e9, each.seconds), fontsize=8)
        right.set_xlim(left=0.0)
        right.set_ylim(bottom=0.0)
        right.set_xlabel("peak memory above the start [GB]")
        right.set_ylabel("seconds, forward and backward")
