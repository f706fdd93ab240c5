"""The result of a loop: what `result.json` holds, with the runs of the MPM and pictures of what was found."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from inverse import result as inverse_result
from inverse.problem import Problem
from inverse.result import Purpose, RunRecord
from validation.loop.check import Answer, Check, History
from validation.loop.uncertainty import Uncertainty
from validation.runs import SHARE

OBSERVED, FOUND = "black", "tab:red"


@dataclass(frozen=True, kw_only=True)
class Result(inverse_result.Result):
    """What a loop found.

    >>> result = solve("friction-tall-42")
    >>> result.verdict, result.unknowns, result.certainty
    (<Verdict.CONFIRMED: 'confirmed'>, {'friction_deg': 41.6...}, {'friction_deg': 0.9...})
    >>> result.plot().savefig("found.png")
    """

    found: Answer
    """The checks at the answer."""
    history: History
    """All that was proposed and checked."""
    uncertainty: Uncertainty | None
    """By the last ensemble; absent where the target is unreachable."""
    surrogate_deposit: NDArray[np.floating]
    """Deposit of the uncorrected surrogate at the answer [m], shape [n, D]."""
    without_surrogate: str | None = None
    """The reason why no learned surrogate proposed; None where one did."""

    @property
    def deposit(self) -> NDArray[np.floating]:
        """The MPM's deposit at the answer [m], shape [N, D]."""
        return np.asarray(self.found.checks[0].trajectory.positions[-1])

    @property
    def begun(self) -> Check | None:
        """Of a design: the check at the problem's own start."""
        return self.history.checks[1] if self.problem.target.minimise else None

    def save(self, folder: Path | str) -> None:
        """Write `result.json`, `report.md`, its pictures and, where they are not there yet, the MPM runs."""
        from validation.loop import report  # It draws results.

        folder = Path(folder)
        for record, check in zip(self.mpm_runs, (*self.history.checks, *self.history.members), strict=True):
            if not (folder / record.file).exists():
                check.trajectory.save(folder / record.file)
        self.write(folder)
        report.write(self, folder)

    def plot(self) -> Figure:
        """The deposit observed and found, and the parameters with their half-widths within their bounds."""
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
        truth, widths = self.target.truth or {}, self.certainty or {}
        for row, each in enumerate(self.problem.parameters):
            span, value = each.upper - each.lower, self.unknowns[each.name]

            def share(number: float, lower: float = each.lower, span: float = span) -> float:
                return (number - lower) / span

            axis.plot([0.0, 1.0], [row, row], color="lightgrey", zorder=0)
            axis.errorbar(share(value), row, xerr=widths.get(each.name, 0.0) / span, fmt="o", color=FOUND, capsize=4)
            if each.name in truth:
                axis.plot(share(truth[each.name]), row, "x", color=OBSERVED)
            axis.annotate(f"{each.kind.text(value)}", (1.02, row), va="center", annotation_clip=False)
        axis.set(xlim=(0.0, 1.0), xticks=[0.0, 1.0], xticklabels=["lower bound", "upper bound"])
        axis.set(ylim=(-0.6, len(self.problem.parameters) - 0.4))
        axis.set_yticks(range(len(self.problem.parameters)), self.problem.names)
        axis.invert_yaxis()


def record(problem: Problem, purpose: Purpose, check: Check, file: str) -> RunRecord:
    """An MPM run as `result.json` holds it."""
    return RunRecord(
        purpose=purpose,
        unknowns=problem.named(check.parameters),
        observation=check.observation,
        front=check.front,
        front_error_pct=100.0 * check.front_error,
        loss=check.misfit,
        seconds=float(check.trajectory.summary[SHARE]),
        file=file,
    )
