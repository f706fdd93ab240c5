"""The result of a loop: what `result.json` and `posterior.npz` hold, and pictures of what was found."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datasets import measures
from datasets.files import replacing, write_json
from inverse.posterior.answers import half_widths
from inverse.posterior.information import Information, information, measurements
from inverse.problem import Problem
from inverse.result import (
    Combination,
    Found,
    Purpose,
    RunRecord,
    Verdict,
    combinations_record,
    peak_memory_mib,
    plain,
)
from validation.loop.check import Check
from validation.loop.verdict import Outcome
from validation.runs import SHARE

OBSERVED, FOUND = "black", "tab:red"
SUGGESTED = 6
"""Measurements that are suggested."""


@dataclass(frozen=True, kw_only=True)
class Result(Found):
    """What a loop found.

    >>> result = solve("friction-tall-42")
    >>> result.verdict, result.unknowns, result.certainty
    (<Verdict.CONFIRMED: 'confirmed'>, {'friction_deg': 41.6...}, {'friction_deg': 0.9...})
    >>> result.plot().savefig("found.png")
    """

    outcome: Outcome
    """All runs, the posterior and its answers."""
    surrogate: str
    """Whether a learned surrogate helped, and why."""
    mpm_runs: list[RunRecord]
    mpm_seconds: float

    @property
    def deposit(self) -> NDArray[np.floating]:
        """The MPM's deposit at the answer [m], shape [N, D]."""
        return np.asarray(self.outcome.answers[0].checks[0].trajectory.positions[-1])

    @property
    def begun(self) -> list[Check]:
        """Of a design: the runs at the problem's own start."""
        return [each for each in self.outcome.state.runs if each.purpose is Purpose.START]

    @property
    def misfit(self) -> float:
        """Of the MPM at the answer."""
        return self.target.misfit(self.outcome.answers[0].observation)

    @property
    def samples(self) -> NDArray[np.float64]:
        """Of the posterior, in the units of the parameters' names, shape [S, U]."""
        return self.outcome.state.task.values(self.outcome.state.posterior.samples.points)

    @property
    def answers(self) -> list[dict[str, Any]]:
        """Every separate answer that the observation allows: unknowns, half-widths, weight and misfit in the MPM."""
        return [
            {
                "unknowns": self.problem.named(each.parameters),
                "half_widths": self.problem.named(each.half_widths),
                "weight": each.weight,
                "misfit": self.target.misfit(each.observation),
            }
            for each in self.outcome.answers
        ]

    @property
    def combinations(self) -> list[Combination]:
        """The principal directions of the posterior, best known first, in fractions of the ranges."""
        samples = self.outcome.state.posterior.samples
        _, vectors = np.linalg.eigh(samples.covariance)
        widths = half_widths(samples.points @ vectors, samples.weights, samples.mean @ vectors)
        return [
            Combination(
                weights=self.problem.named(vector * np.sign(vector[np.argmax(np.abs(vector))])), half_width=float(width)
            )
            for width, vector in zip(widths, vectors.T, strict=True)
        ]

    @cached_property
    def further(self) -> list[Information]:
        """Where the answer is ambiguous: the measurements of a deposit that would decide most."""
        if self.verdict is not Verdict.AMBIGUOUS:
            return []
        state, scene = self.outcome.state, self.problem.scene
        deposits = [
            run.trajectory.positions[-1] for run, near in zip(state.runs, state.posterior.near, strict=True) if near
        ]
        extent = max(measures.front(deposit) for deposit in deposits)
        shown = [measurements(scene, deposit, extent) for deposit in deposits]
        # That of the target is known.
        known = {"the front"} if math.isfinite(self.target.front) else set()
        found = information(
            state.points[state.posterior.near],
            {name: np.array([each[name] for each in shown]) for name in shown[0] if name not in known},
            state.posterior.samples,
            cell=scene.domain.cell,
            rng=state.task.generator(len(state.runs)),
        )
        return found[:SUGGESTED]

    def save(self, folder: Path | str) -> None:
        """Write `result.json`, `posterior.npz`, `report.md`, its pictures and, where they lack, the MPM runs."""
        from validation.loop import report  # It draws results.

        folder = Path(folder)
        state = self.outcome.state
        for record, check in zip(self.mpm_runs, (*state.runs, *state.coarse), strict=True):
            if not (folder / record.file).exists():
                check.trajectory.save(folder / record.file)
        self.write(folder)
        report.write(self, folder)

    def write(self, folder: Path) -> None:
        """Write `posterior.npz` and `result.json` into `folder`."""
        found, raw = self.outcome.state.posterior, self.target.observation.raw
        names = np.array(self.problem.names, dtype=np.str_)
        with replacing(folder / "posterior.npz") as part:
            np.savez_compressed(part, names=names, samples=self.samples, weights=found.samples.weights)
        fit, task = self.outcome.discrepancy, self.outcome.state.task
        write_json(
            folder / "result.json",
            {
                "problem": self.problem.name,
                "verdict": self.verdict.value,
                "unknowns": self.unknowns,
                "certainty": self.certainty,
                "answers": self.answers,
                "combinations": combinations_record(self.combinations),
                "discrepancy": None if fit is None else fit.factor,
                "truth": self.target.truth,
                "error_pct": self.error_pct,
                "observation": {
                    "target": plain(raw(self.target.values)),
                    "mpm": plain(raw(self.outcome.answers[0].observation)),
                }
                | self.target.observation.record(),
                "loss": {"mpm": self.misfit},
                "mpm_runs": [each.as_json() for each in self.mpm_runs],
                "iterations": [
                    {
                        "mpm_runs": each.runs,
                        "mean": self.problem.named(task.values(each.mean)),
                        "deviation": self.problem.named(each.deviation * task.bounds.range),
                        "emulator_share": each.emulator_share,
                        "with_surrogate": each.with_surrogate,
                    }
                    for each in self.outcome.state.waves
                ],
                "sampling": {
                    "difference": found.samples.difference,
                    "acceptance": found.samples.acceptance,
                    "log_evidence": found.samples.evidence,
                },
                "surrogate": self.surrogate,
                "seconds": {"mpm": self.mpm_seconds, "total": self.total_seconds},
                "peak_memory_mib": peak_memory_mib(),
            },
        )

    def plot(self) -> Figure:
        """The deposit observed and found, and the answers with their half-widths within their bounds."""
        rows = len(self.problem.parameters)
        figure, (above, below) = plt.subplots(
            2, 1, figsize=(8.0, 4.0 + 0.35 * rows), height_ratios=(3.0, 0.6 + 0.35 * rows), layout="constrained"
        )
        self._plot_deposits(above)
        self._plot_parameters(below)
        figure.suptitle(f"{self.problem.name}: {self.verdict}")
        return figure

    def _plot_deposits(self, axis: Axes) -> None:
        across = 1 if self.problem.scene.dimension == 2 else 2
        deposits = {"found (MPM)": (self.deposit, FOUND)}
        if self.target.deposit is not None:
            deposits = {"observed": (self.target.deposit, OBSERVED)} | deposits
        for label, (deposit, colour) in deposits.items():
            axis.scatter(deposit[:, 0], deposit[:, across], s=1.0, color=colour, alpha=0.5, linewidths=0, label=label)
        if self.target.profile is not None:
            axis.plot(*self.target.profile, color=OBSERVED, label="observed profile")
        elif self.target.deposit is None and np.isfinite(self.target.front):
            axis.axvline(self.target.front, color=OBSERVED, label="observed front")
        axis.set(xlabel="x [m]", ylabel=f"{'xyz'[across]} [m]", aspect="equal")
        axis.legend(markerscale=6.0, fontsize="small")

    def _plot_parameters(self, axis: Axes) -> None:
        truth, count = self.target.truth or {}, len(self.outcome.answers)
        for row, each in enumerate(self.problem.parameters):
            axis.plot([0.0, 1.0], [row, row], color="lightgrey", zorder=0)
            for number, answer in enumerate(self.outcome.answers):
                value, width = float(answer.parameters[row]), float(answer.half_widths[row])
                height = row + 0.25 * (number - 0.5 * (count - 1)) / max(1, count)
                share = (value - each.lower) / each.range
                axis.errorbar(share, height, xerr=width / each.range, fmt="o", color=FOUND, capsize=4)
            if each.name in truth:
                axis.plot((truth[each.name] - each.lower) / each.range, row, "x", color=OBSERVED)
            axis.annotate(
                f"{each.kind.text(self.unknowns[each.name])}", (1.02, row), va="center", annotation_clip=False
            )
        axis.set(xlim=(0.0, 1.0), xticks=[0.0, 1.0], xticklabels=["lower bound", "upper bound"])
        axis.set(ylim=(-0.6, len(self.problem.parameters) - 0.4))
        axis.set_yticks(range(len(self.problem.parameters)), self.problem.names)
        axis.invert_yaxis()


def record(problem: Problem, check: Check, file: str) -> RunRecord:
    """An MPM run as `result.json` holds it."""
    return RunRecord(
        purpose=check.purpose,
        unknowns=problem.named(check.parameters),
        observation=check.observation,
        front=check.front,
        front_error_pct=100.0 * check.front_error,
        loss=check.misfit,
        seconds=float(check.trajectory.summary[SHARE]),
        file=file,
    )
