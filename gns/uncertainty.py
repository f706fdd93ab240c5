"""How far a rollout may be from the MPM: the spread of a small ensemble, calibrated on flows that training never saw.

    prediction = predict("column-tall-42", level=0.95)
    prediction.front, prediction.half_width      # [m]; 95 of 100 fronts of the MPM are within

Models that were trained apart agree where the data say enough and differ where they say little (Lakshminarayanan,
Pritzel & Blundell, Simple and scalable predictive uncertainty estimation using deep ensembles, NeurIPS 2017). What
they have in common none of them shows: members of one line of training err alike. So the half-width of a prediction is

    w = q u,    u = sqrt(s^2 + (b L)^2)

| symbol | variable    | meaning                                                                               |
| s      | `spread`    | standard deviation of the members' fronts                                             |
| L      | `extent`    | of the flow, from its rear at the start to the predicted front                        |
| b      | `floor`     | what members err in common, over the extent; most likely for N(0, (a u)^2) of any a   |
| q      | `quantiles` | split conformal prediction: of n flows the ceil((n + 1) level)-th smallest |error| / u |

A new flow that is drawn as those n were is within w with a probability of at least `level`, whatever the errors are
distributed like (Angelopoulos & Bates, Conformal prediction: a gentle introduction, Foundations and Trends in Machine
Learning 16, 2023, chapter 1); b is found on the same flows, one number, which costs about 1 / n of it. Outside of the
training ranges (`gns.card`) nothing is promised.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from datasets import measures
from datasets.errors import InputError
from datasets.library import read_scene
from datasets.scene import Scene
from datasets.training.samples import Flow
from gns import card, checkpoint, library
from gns.card import Calibration
from gns.initial import initial_state
from gns.samples import batched, stretch
from gns.simulator import Simulator
from gns.state import Conditions, State
from gns.unroll import unroll

Floats = NDArray[np.float64]
LEVELS = (0.5, 0.8, 0.95)
"""Of the bands that a card has quantiles for."""
FLOORS = np.geomspace(1.0e-4, 1.0, 161)
"""Values of b that are tried [-]."""


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """The deposit of a flow, and how far the MPM's front may be from its own."""

    deposit: NDArray[np.float32]
    """By the model itself [m], shape [n, D]."""
    front: float
    """Front of that deposit [m]."""
    extent: float
    """From the rear at the start to that front [m]."""
    spread: float
    """Standard deviation of the members' fronts [m]."""
    half_width: float = math.nan
    """The MPM's front is within this distance of it, at the level asked for [m]."""
    warning: str | None = None
    """Why it may not be: the scene is outside of the training data."""


def ensemble(path: Path) -> list[Simulator]:
    """The model at `path`, whose prediction counts, and the members beside it. Raises InputError for less than two."""
    paths = library.members(path)
    if len(paths) < 2:
        message = f"expected at least two members, such as {library.member_path(path, 1).name}, got {len(paths)}"
        raise InputError(message, where=str(path))
    models = [checkpoint.load(each).simulator for each in (path, *paths)]
    for each, other in zip(paths, models[1:], strict=True):
        if other.settings != models[0].settings:
            raise InputError(f"expected the settings of {path.name}", where=str(each), key="settings")
    return models


def rolled_out(models: Sequence[Simulator], state: State, conditions: Conditions, steps: int) -> Prediction:
    """Roll out an ensemble from one state of a single flow; without a band."""
    with torch.no_grad():
        deposit, *others = (unroll(each, state, conditions, steps)[-1].numpy() for each in models)
    front = measures.front(deposit)
    return Prediction(
        deposit=deposit,
        front=front,
        extent=front - float(state.positions[:, 0].min()),
        spread=float(np.std([measures.front(each) for each in others], ddof=1)),
    )


def calibrated(errors: Floats, spreads: Floats, extents: Floats) -> Calibration:
    """The calibration by the errors of n flows, spread of the ensemble and extent of each, all [m] and of shape [n].

    Raises InputError where n is too small for the highest of `LEVELS`.
    """
    count = len(errors)
    fewest = math.ceil(max(LEVELS) / (1.0 - max(LEVELS)) - 1.0e-9)
    if count < fewest:
        raise InputError(
            f"expected at least {fewest} flows for a band of {max(LEVELS):.0%}, got {count}", key="DATASET"
        )

    def misfit(floor: float) -> float:
        """Negative logarithm of the likelihood over n, with the best a."""
        u = np.hypot(spreads, floor * extents)
        return 0.5 * math.log(max(float(np.mean((errors / u) ** 2)), 1.0e-30)) + float(np.mean(np.log(u)))

    floor = float(min(FLOORS, key=misfit))
    ratios = np.sort(np.abs(errors) / np.hypot(spreads, floor * extents))
    quantiles = {f"{level:g}": float(ratios[math.ceil((count + 1) * level - 1.0e-9) - 1]) for level in LEVELS}
    return Calibration(floor=floor, quantiles=quantiles, flows=count)


def half_width(calibration: Calibration, spread: Floats | float, extent: Floats | float, level: float) -> Floats:
    """w [m] of the band of a level, from spread and extent [m], numbers or arrays. Raises InputError."""
    key = f"{level:g}"
    if key not in calibration.quantiles:
        raise InputError(f"expected one of {', '.join(calibration.quantiles)}, got {key}", key="level")
    return calibration.quantiles[key] * np.hypot(spread, calibration.floor * np.asarray(extent))


def calibrate(path: Path, flows: Sequence[Flow]) -> Calibration:
    """Compare the rollouts of a model and its members with the MPM's `flows`, and write the calibration on its card.

    Raises InputError.
    """
    known, models = card.read(path), ensemble(path)
    if known is None:
        raise InputError("expected the model's card, which python -m gns.card writes", where=str(card.card_path(path)))
    settings, rng = models[0].settings, np.random.default_rng(0)
    found = []
    for flow in tqdm(flows, desc="bands", unit="flow"):
        steps = len(flow.positions) - 1
        sample = stretch(flow, settings, now=0, steps=steps, rng=rng)
        batch = batched([sample], settings)
        own = rolled_out(models, batch.state, batch.conditions, steps)
        found.append((own.front - measures.front(flow.positions[-1]), own.spread, own.extent))
    errors, spreads, extents = np.array(found, dtype=np.float64).reshape(-1, 3).T
    calibration = calibrated(errors, spreads, extents)
    card.write(path, dataclasses.replace(known, calibration=calibration))
    return calibration


def predict(scene: Scene | str | Path, *, model: str | Path | None = None, level: float = 0.95) -> Prediction:
    """Roll out a scene by a model and its members; their spread, calibrated, is how far the MPM may be.

    scene: a scene, the path of one in TOML, or the name of a shipped one; model: a file or a shipped name, that of the
    scene's dimension where absent; level: one of `LEVELS`. Raises InputError.
    """
    scene = scene if isinstance(scene, Scene) else read_scene(str(scene))
    path = library.model_path(model or library.shipped(scene.dimension))
    described = card.read(path)
    if described is None or described.calibration is None:
        message = "expected a calibration on the model's card, which python -m gns.score --keep writes"
        raise InputError(message, where=str(card.card_path(path)), key="calibration")
    models = ensemble(path)
    initial = initial_state(scene, models[0].settings)
    found = rolled_out(models, initial.state, initial.conditions, initial.steps)
    width = float(half_width(described.calibration, found.spread, found.extent, level))
    return dataclasses.replace(found, half_width=width, warning=card.warning(path, scene))
