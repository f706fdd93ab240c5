"""`python -m gns.calibrate MODEL DATASET...`: how far a model may be from the MPM, onto its card."""

import dataclasses
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from tabulate import tabulate
from tqdm import tqdm

from datasets import command_line, measures
from datasets.errors import InputError
from datasets.training.samples import Flow
from gns import card
from gns.inference import model_path
from gns.training.batch import batched
from gns.training.flows import flows_of, stretch
from gns.uncertainty import LEVELS, Ensemble, Floats, calibrated, calibrations, covered, half_width


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """An observation of n flows, predicted and by the MPM."""

    errors: Floats
    """Model less MPM, or the distance of the two [m], shape [n]."""
    spreads: Floats
    """Of the ensemble [m], shape [n]."""
    extents: Floats
    """Of the flows, as predicted [m], shape [n]."""


def compare(ensemble: Ensemble, flows: Sequence[Flow], *, seed: int, progress: bool = False) -> dict[str, Comparison]:
    """Roll out `flows` from their starts: front, and transport of the deposit, against the MPM's; by observation."""
    settings = ensemble.model.settings
    rng = np.random.default_rng(seed)
    rows: dict[str, list[tuple[float, float, float]]] = {"front": [], "transport": []}
    for flow in tqdm(flows, desc="rollouts", unit="flow", disable=not progress):
        steps = len(flow.positions) - 1
        sample = stretch(flow, settings, now=0, steps=steps, rng=rng)
        batch = batched([sample], step=settings.step, history=settings.history)
        outcome = ensemble.outcome(batch.state, batch.conditions(settings.cell), steps)
        deposit = flow.positions[-1]
        errors = {
            "front": outcome.front - measures.front(deposit),
            "transport": measures.transport_distance(outcome.deposit, outcome.volume, deposit, flow.volume),
        }
        for name, error in errors.items():
            rows[name].append((error, outcome.spreads[name], outcome.extent))
    found = {}
    for name, row in rows.items():
        errors_of, spreads, extents = np.array(row, dtype=np.float64).T
        found[name] = Comparison(errors=errors_of, spreads=spreads, extents=extents)
    return found


def calibrate(
    model: Path, *datasets: Path, split: str = "valid", seed: int = 0, threads: int = 1, check: bool = False
) -> None:
    """Find how far a model may be from the MPM by flows that it was not trained on, and write it on the model's card.

    Parameters
    ----------
    model
        The model's file, or the name of a shipped one; its members NAME-1 and so on and its card lie beside it.
    datasets
        Folders that python -m mpm.generate made.
    split
        train, valid or test.
    seed
        Seed of the choice of particles.
    threads
        Threads of torch.
    check
        Write nothing: say how many flows of the split are within the bands that the card has.
    """
    torch.set_num_threads(threads)
    path = model_path(model)
    known = card.read(path)
    if known is None:
        raise InputError("expected the model's card, which python -m gns.card writes", where=str(card.card_path(path)))
    ensemble = Ensemble.load(path)
    settings = ensemble.model.settings
    flows = [flow for dataset in datasets for flow in flows_of(dataset, split, settings, progress=True)]
    if not flows:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")
    compared = compare(ensemble, flows, seed=seed, progress=True)
    if check:
        found = calibrations(path)
    else:
        command = " ".join(["python -m gns.calibrate", *sys.argv[1:]])
        found = {name: calibrated(each.errors, each.spreads, each.extents, command) for name, each in compared.items()}
        card.write(path, dataclasses.replace(known, calibration=found))
    rows = []
    for name, each in compared.items():
        for level in LEVELS:
            width = half_width(found[name], each.spreads, each.extents, level) / each.extents
            inside = covered(found[name], each.errors, each.spreads, each.extents, level)
            rows.append([name, f"{level:.0%}", f"{inside:.0%}", f"{100.0 * np.mean(width):.2f}"])
    print(tabulate(rows, ["observation", "level", f"of {len(flows)} flows", "half-width / extent [%]"], "github"))


if __name__ == "__main__":
    sys.exit(command_line.run(calibrate, "python -m gns.calibrate"))
