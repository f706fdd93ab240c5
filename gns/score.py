"""Score a model by whole rollouts of held-out flows: `python -m gns.score DATASET... --model MODEL`.

The error of a prediction (`gns.predict`) is at most q times the extent of its deposit with a probability of at least
`level`. With e the absolute errors over the extent on n held-out flows (split conformal prediction, Angelopoulos &
Bates, Conformal prediction: a gentle introduction, Foundations and Trends in Machine Learning 16, 2023, chapter 1):

    q = the ceil((n + 1) level)-th smallest e        for n large enough; any distribution
    q = rms(e) t_n((1 + level) / 2)                  for fewer flows; Gaussian errors of unknown variance (Student's t)
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cyclopts.types import PositiveInt
from numpy.typing import NDArray
from scipy.stats import t as student

from datasets import command_line
from datasets.errors import InputError
from datasets.flow import measures
from datasets.markdown import markdown_table
from gns import card
from gns.card import LEVELS, Calibration
from gns.library import model_path

if TYPE_CHECKING:
    from gns.simulator import StepModel
    from gns.training.samples import Flow


@dataclass(frozen=True, kw_only=True)
class Score(measures.Errors):
    """Errors of one rollout against the MPM."""

    released: bool
    """Whether the flow starts at rest."""
    at_wall: bool
    """Whether a wall stops the MPM's front, which then says little about the model's front."""


def evaluate(simulator: "StepModel", flows: "Sequence[Flow]") -> list[Score]:
    """Compare rollouts of `flows` from their starts, by Talus's network or another, with all particles of the flows."""
    # Imported here, so that --help need not load torch, which takes seconds.
    import torch

    from gns.simulator import Simulator, checked, placed, unroll
    from gns.training.samples import stretch

    settings, rng = checked(simulator).settings, np.random.default_rng(0)
    scores: list[Score] = []
    for flow in flows:
        steps = len(flow.positions) - 1
        sample = stretch(flow, settings, now=0, steps=steps, rng=rng)
        there = sample.to(placed(simulator).device)
        rests = not flow.moves(steps - 1)
        with torch.no_grad():
            more = measures.AFTER if rests else 1
            rolled = unroll(simulator, there.state, there.conditions, more * steps, corrected=False)
            end, ended = there.state.after(rolled, steps), rolled[: steps + 1]
            if isinstance(simulator, Simulator):
                ended = simulator.corrected(there.state, end, ended, there.conditions)
            deposit = ended[-1].cpu().numpy()
        scene, length = flow.scene, flow.units.length
        truth = measures.Deposit.of_positions(
            flow.positions[0], flow.positions[-1], flow.volume, scene.domain.size, measures.ground_of(scene)
        )
        errors = truth.errors(length * deposit, length**scene.dimension * sample.conditions.volume.numpy())
        if rests:
            errors = replace(errors, creep=measures.creep(length * rolled.cpu().numpy(), flow.step))
        scores.append(Score(**vars(errors), released=not flow.velocity0.any(), at_wall=truth.at_wall))
    return scores


def validation_score(scores: Sequence[Score]) -> float:
    """Mean of |front| + profile + thickness [-]; without thickness, a network whose sand lies flat would score best."""
    return float(np.mean([abs(score.front) + score.profile + score.thickness for score in scores]))


def calibrated(scores: Sequence[Score]) -> Calibration:
    """The calibration by scores of flows that no training saw. Flows whose front a wall stops count only if all are
    such: the wall stops the model's front at the same place, which would make all other bands too narrow."""
    counted = [flow for flow in scores if not flow.at_wall] or scores
    errors = [np.sort([abs(getattr(flow, name)) for flow in counted]) for name in ("front", "profile")]
    front, profile = ({f"{level:g}": quantile(ordered, level) for level in LEVELS} for ordered in errors)
    means = {name: mean for name, mean in measures.amounts(counted).items() if not math.isnan(mean)}
    return Calibration(front=front, profile=profile, flows=len(counted), errors=means)


def quantile(errors: NDArray[np.float64], level: float) -> float:
    """q of absolute errors in ascending order, shape [n]."""
    count = len(errors)
    rank = math.ceil((count + 1) * level - 1.0e-9)
    if rank <= count:
        return float(errors[rank - 1])
    return float(np.sqrt(np.mean(errors**2)) * student.ppf(0.5 * (1.0 + level), count))


def table(scores: Sequence[Score]) -> str:
    """Markdown: mean and worst errors of flows released at rest and of moving ones; without fronts stopped by walls."""
    rows = []
    for title, released in (("released at rest", True), ("moving", False)):
        if group := [score for score in scores if score.released == released]:
            held = sum(score.at_wall for score in group)
            # Every model is right about a front that a wall stops.
            free = [replace(score, front=math.nan) if score.at_wall else score for score in group]
            rows.append({"start": title, "flows": len(group), "held by a wall": held} | measures.summary(free))
    return markdown_table(rows, "keys", "github") + "\n"


def score(*datasets: Path, model: Path, split: str = "test", threads: PositiveInt = 1, keep: bool = False) -> None:
    """Score a model by whole rollouts.

    Args:
        datasets: Dataset folders made by `python -m mpm.generate`.
        model: The model's file, or the name of a shipped one.
        split: train, valid or test.
        threads: Number of torch threads.
        keep: Write the table, and error bands from the flows of the valid split, to the model's card.
    """
    import torch

    from gns import checkpoint
    from gns.training.samples import flows_of

    torch.set_num_threads(threads)
    path = model_path(model)
    simulator = checkpoint.load(path).simulator
    if not datasets:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")
    described = card.read(path) if keep else None
    if described is not None:
        for other in (dataset.name for dataset in datasets if dataset.name not in described.datasets):
            message = f"expected datasets that the model was trained on, {', '.join(described.datasets)}, got {other}"
            raise InputError(message, key="DATASET")
    elif keep:
        raise InputError("expected the model's card, which a training writes", where=str(card.card_path(path)))

    def scored(dataset: Path, split: str) -> list[Score]:
        return evaluate(simulator, flows_of(dataset, split, simulator.settings, progress=True))

    text = "\n".join(f"{dataset.name}, {split}\n\n" + table(scored(dataset, split)) for dataset in datasets)
    print(text)
    if described is not None:
        scores: dict[str, list[Score]] = {}
        for dataset in datasets:
            # Folders of the same name are parts of one dataset.
            scores.setdefault(dataset.name, []).extend(scored(dataset, "valid"))
        bands = {name: calibrated(group) for name, group in scores.items()}
        card.write(path, replace(described, scores=text).keeping(bands))
        print(f"wrote bands by {sum(band.flows for band in bands.values())} flows to {card.card_path(path)}")


if __name__ == "__main__":
    sys.exit(command_line.run(score, "python -m gns.score"))
