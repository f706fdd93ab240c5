"""`report.md` of a single inversion."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets import files
from inverse import pictures
from inverse.observations import Values
from inverse.problem import Problem
from inverse.result import Result, peak_memory_mib
from inverse.target import Target
from inverse.unknowns import kind, with_unknowns


def write(result: Result, deposit: NDArray[np.floating], folder: Path) -> None:
    """Write `report.md` and its pictures into `folder`; `deposit` [m], shape [N, D], is the prediction's."""
    problem, target = result.problem, result.target
    deposits = {"surrogate": deposit}
    if target.deposit is not None:
        deposits = {"target": target.deposit, **deposits}
    scene = with_unknowns(problem.scene, problem.names, result.answer)
    pictures.draw_deposits(folder / "deposit.png", scene, deposits, observed(target))
    pictures.draw_iterations(folder / "iterations.png", problem, result.rounds, target.truth)
    lines = [
        f"# {problem.name}",
        "",
        question(problem),
        "",
        *table(
            ["unknown", "found", *(["truth", "error"] if target.truth else [])],
            [[name, quantity(name, value), *known(result, name)] for name, value in result.unknowns.items()],
        ),
        "",
        "The MPM has not checked this answer (verdict: unconfirmed). `python -m validation.loop` does.",
        "",
        "![deposits](deposit.png)",
        "",
        "![iterations](iterations.png)",
        "",
        *price(result),
    ]
    files.write_text(folder / "report.md", "\n".join(lines) + "\n")


def observed(target: Target) -> tuple[Values, Values] | float | None:
    """What a picture shows of a target whose deposit is not known."""
    if target.deposit is not None or (target.profile is None and math.isnan(target.edge)):
        return None
    return target.profile or target.edge


def question(problem: Problem) -> str:
    """What was asked, in a sentence."""
    names = ", ".join(f"`{unknown.name}` in [{unknown.lower:g}, {unknown.upper:g}]" for unknown in problem.unknowns)
    return f"Unknown: {names}. Observed: the deposit's {problem.observation.kind}."


def quantity(name: str, value: float) -> str:
    """A value of an unknown with its unit."""
    return f"{value:.{kind(name).digits}f} {kind(name).unit}"


def known(result: Result, name: str) -> list[str]:
    """Truth and error of an unknown, where the truth is known."""
    if not result.target.truth:
        return []
    error = f"{result.error_pct[name]:.2f} %" if name in result.error_pct else "-"
    return [quantity(name, result.target.truth[name]), error]


def price(result: Result) -> list[str]:
    """What it cost."""
    seconds = result.seconds
    return [
        "## Price",
        "",
        *table(
            ["gradients", "forward", "backward", "per iteration", "in the MPM", "total", "peak memory"],
            [
                [
                    str(len(result.evaluations)),
                    *(f"{seconds[key]:.2f} s" for key in ("forward", "backward", "per_iteration", "mpm", "total")),
                    f"{peak_memory_mib():.0f} MiB",
                ]
            ],
        ),
    ]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
