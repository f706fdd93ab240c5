"""How good a model is: whole rollouts of held-out flows. `python -m gns.score DATASET... --model MODEL`.

The half-width of a prediction (`gns.predict`) is a share of the extent of its deposit, the quantile of the absolute
errors e over the extent on n held-out flows (split conformal prediction, Angelopoulos & Bates, Conformal prediction: a
gentle introduction, Foundations and Trends in Machine Learning 16, 2023, chapter 1):

    q = the ceil((n + 1) level)-th smallest e        where there are so many: whatever their distribution
    q = rms(e) t_n((1 + level) / 2)                  of fewer flows: Gaussian errors of unknown variance, by Student

A new flow that is drawn as those n were is within q with a probability of at least `level`. Which quantiles count:
`gns.card.Card.calibration`.
"""

import dataclasses
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from tabulate import tabulate

from datasets import command_line, measures
from datasets.errors import InputError
from gns import card
from gns.card import LEVELS, Calibration
from gns.library import model_path

if TYPE_CHECKING:
    from gns.samples import Flow
    from gns.simulator import Simulator


@dataclass(frozen=True, kw_only=True)
class Score:
    """Errors of one rollout against the MPM, on the same thinned particles."""

    released: bool
    """Whether the flow starts at rest."""
    front_error: float
    """Front of the deposit beyond the MPM's, over the deposit's extent from its rear to its front [-].

    The front is the end that has moved farther, to the left or to the right.
    """
    profile_error: float
    """Distance along x of equal shares of the two deposits, rms, over the extent [-]; `measures.transport_distance`."""


@dataclass(frozen=True, kw_only=True)
class Deposit:
    """Where the MPM's deposit of a flow ends, beside which others are measured."""

    positions: measures.Positions
    """[m], shape [N, D]."""
    volume: NDArray[np.floating]
    """Of the particles [m^D], shape [N]."""
    x: tuple[float, float]
    """Of its ends, at smaller and at larger x [m]."""
    side: int
    """Which of them the flow has moved farther, 0 or 1: the front."""

    @staticmethod
    def of_positions(start: measures.Positions, end: measures.Positions, volume: NDArray[np.floating]) -> "Deposit":
        """That of particles that moved from `start` to `end` [m], both [N, D]."""
        before, after = measures.ends(start, volume), measures.ends(end, volume)
        return Deposit(positions=end, volume=volume, x=after, side=int(after[1] - before[1] >= before[0] - after[0]))

    @property
    def extent(self) -> float:
        """Distance of the two ends [m]."""
        return self.x[1] - self.x[0]

    @property
    def front(self) -> float:
        """The x of the front [m]."""
        return self.x[self.side]

    def errors(self, positions: measures.Positions, volume: NDArray[np.floating]) -> tuple[float, float]:
        """Those of front and profile of another deposit of the same scene: see `Score`."""
        beyond = measures.ends(positions, volume)[self.side] - self.front
        apart = measures.transport_distance(positions, volume, self.positions, self.volume)
        return (beyond if self.side == 1 else -beyond) / self.extent, apart / self.extent


def evaluate(simulator: "Simulator", flows: "Sequence[Flow]") -> list[Score]:
    """Roll out `flows` from their starts. The deposits are compared with all particles that the flows have."""
    # Here, because torch takes seconds, which --help should not.
    import torch

    from gns.samples import stretch
    from gns.unroll import unroll

    settings, rng = simulator.settings, np.random.default_rng(0)
    scores: list[Score] = []
    for flow in flows:
        steps = len(flow.positions) - 1
        sample = stretch(flow, settings, now=0, steps=steps, rng=rng)
        there = sample.to(simulator.displacement_scale.device)
        with torch.no_grad():
            deposit = unroll(simulator, there.state, there.conditions, steps)[-1].cpu().numpy()
        truth = Deposit.of_positions(flow.positions[0], flow.positions[-1], flow.volume)
        front, profile = truth.errors(deposit, sample.conditions.volume.numpy())
        scores.append(Score(released=flow.released, front_error=front, profile_error=profile))
    return scores


def validation_score(scores: Sequence[Score]) -> float:
    """Mean absolute front error plus mean profile error [-]: the smaller, the better."""
    return float(np.mean([abs(score.front_error) + score.profile_error for score in scores]))


def calibrated(scores: Sequence[Score]) -> Calibration:
    """The calibration by the scores of flows that no training saw."""
    errors = {name: np.sort([abs(getattr(each, name)) for each in scores]) for name in ("front_error", "profile_error")}
    front, profile = ({f"{level:g}": quantile(each, level) for level in LEVELS} for each in errors.values())
    return Calibration(front=front, profile=profile, flows=len(scores))


def quantile(errors: NDArray[np.float64], level: float) -> float:
    """q of absolute errors in ascending order, shape [n]."""
    count = len(errors)
    rank = math.ceil((count + 1) * level - 1.0e-9)
    if rank <= count:
        return float(errors[rank - 1])
    return float(np.sqrt(np.mean(errors**2)) * student.ppf(0.5 * (1.0 + level), count))


def table(scores: Sequence[Score]) -> str:
    """Markdown: releases and moving starts apart, mean over the flows of each and the worst front."""
    rows = []
    for title, released in (("released at rest", True), ("moving", False)):
        group = [score for score in scores if score.released == released]
        if not group:
            continue
        front = 100.0 * np.array([score.front_error for score in group])
        rows.append(
            {
                "start": title,
                "flows": len(group),
                "front error, mean of absolute values": f"{np.abs(front).mean():.1f} %",
                "their median": f"{np.median(np.abs(front)):.1f} %",
                "mean": f"{front.mean():+.1f} %",
                "worst": f"{front[np.abs(front).argmax()]:+.1f} %",
                "profile error": f"{100.0 * np.mean([score.profile_error for score in group]):.1f} %",
            }
        )
    return tabulate(rows, "keys", "github", disable_numparse=True) + "\n"


def score(*datasets: Path, model: Path, split: str = "test", threads: int = 1, keep: bool = False) -> None:
    """Score a model by whole rollouts.

    Parameters
    ----------
    datasets
        Folders that `python -m mpm.generate` made.
    model
        The model's file, or the name of a shipped one.
    split
        train, valid or test.
    threads
        Threads of torch.
    keep
        Write the table onto the model's card, and how far it may be from the MPM by the flows of the valid split.
    """
    import torch

    from gns import checkpoint
    from gns.samples import flows_of

    torch.set_num_threads(threads)
    path = model_path(model)
    loaded = checkpoint.load(path)
    settings = loaded.simulator.settings
    if not datasets:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")
    described = card.read(path) if keep else None
    if described is not None:
        for other in (each.name for each in datasets if each.name not in described.datasets):
            message = f"expected datasets that the model was trained on, {', '.join(described.datasets)}, got {other}"
            raise InputError(message, key="DATASET")
    elif keep:
        raise InputError("expected the model's card, which a training writes", where=str(card.card_path(path)))
    lines = []
    for dataset in datasets:
        flows = flows_of(dataset, split, settings, progress=True)
        lines.append(f"{dataset.name}, {split}\n\n" + table(evaluate(loaded.simulator, flows)))
    text = "\n".join(lines)
    print(text)
    if described is not None:
        scores: dict[str, list[Score]] = {}
        for dataset in datasets:
            valid = flows_of(dataset, "valid", settings, progress=True)
            # Folders of a name are parts of one dataset.
            scores.setdefault(dataset.name, []).extend(evaluate(loaded.simulator, valid))
        found = {name: calibrated(each) for name, each in scores.items()}
        card.write(path, dataclasses.replace(described, scores=text).keeping(found))
        print(f"bands by {sum(each.flows for each in found.values())} flows are on {card.card_path(path)}")


if __name__ == "__main__":
    sys.exit(command_line.run(score, "python -m gns.score"))
