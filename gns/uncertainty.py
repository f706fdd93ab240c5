"""How far a rollout may be from the MPM: the spread of a small ensemble, calibrated on flows that training never saw.

    prediction = predict("column-tall-42", level=0.95)
    prediction.front, prediction.half_width      # [m]; 95 of 100 fronts of the MPM are within

Models that were trained apart agree where the data say enough and differ where they say little (Lakshminarayanan,
Pritzel & Blundell, Simple and scalable predictive uncertainty estimation using deep ensembles, NeurIPS 2017). What
they have in common none of them shows: members of one line of training err alike. So the half-width of a prediction is

    w = q u,    u = sqrt(s^2 + (b L)^2)

| symbol | variable   | meaning                                                                               |
| s      | `spread`   | how far the members' predictions are apart, standard deviation                        |
| L      | `extent`   | of the flow, from its rear at the start to the predicted front                        |
| b      | `floor`    | what members err in common, over the extent; by maximum likelihood of N(0, (a u)^2)   |
| a      | `deviation` | standard deviation of the errors over u                                              |
| q      | `quantiles` | split conformal prediction: of n flows the ceil((n + 1) level)-th smallest |error| / u |

A new flow that is drawn as those n were is within w with a probability of at least `level`, whatever the errors are
distributed like (Angelopoulos & Bates, Conformal prediction: a gentle introduction, Foundations and Trends in Machine
Learning 16, 2023, chapter 1); b is found on the same flows, one number, which costs about 1 / n of it. Outside of the
training ranges (`gns.card`) nothing is promised.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.library import read_scene
from datasets.scene import Scene
from gns import card, inference
from gns.card import Calibration
from gns.initial import initial_state
from gns.model import checkpoint
from gns.model.simulator import Simulator
from gns.model.state import Conditions, State
from gns.unroll import unroll

Floats = NDArray[np.float64]
LEVELS = (0.5, 0.8, 0.95)
"""Of the bands that a card has quantiles for."""
FLOORS = np.geomspace(1.0e-4, 1.0, 161)
"""Values of b that are tried [-]."""


@dataclass(frozen=True, kw_only=True)
class Ensemble:
    """A model, whose prediction counts, and the members whose spread says how far it may be off."""

    model: Simulator
    members: tuple[Simulator, ...]

    @staticmethod
    def load(path: Path) -> "Ensemble":
        """The model at `path` and its members beside it. Raises InputError where there are less than two."""
        paths = inference.members(path)
        if len(paths) < 2:
            message = f"expected at least two members, such as {inference.member_path(path, 1).name}, got {len(paths)}"
            raise InputError(f"{message} (python -m gns.average --members)", where=str(path))
        model, *others = (checkpoint.load(each).simulator.requires_grad_(False) for each in (path, *paths))
        for each, other in zip(paths, others, strict=True):
            if other.settings != model.settings:
                raise InputError(f"expected the settings of {path.name}", where=str(each), key="settings")
        return Ensemble(model=model, members=tuple(others))

    def values(self, state: State, conditions: Conditions, steps: int, observe: Callable[[Tensor], Tensor]) -> Floats:
        """What each member predicts of an observation, for `standard_deviation`, shape [M, K].

        observe: positions at the start and after each step [m], shape [steps + 1, n, D], to K numbers.
        """
        with torch.no_grad():
            found = [observe(unroll(each, state, conditions, steps)).reshape(-1) for each in self.members]
        return torch.stack(found).double().numpy()

    def outcome(self, state: State, conditions: Conditions, steps: int) -> "Outcome":
        """Roll out all of them from one state of a single flow."""
        volume = conditions.volume.numpy()
        with torch.no_grad():
            model, *others = (
                unroll(each, state, conditions, steps)[-1].numpy() for each in (self.model, *self.members)
            )
        front = measures.front(model)
        fronts = np.array([measures.front(deposit) for deposit in others])
        apart = [measures.transport_distance(deposit, volume, model, volume) for deposit in others]
        return Outcome(
            deposit=model,
            volume=volume,
            front=front,
            extent=front - float(state.positions[:, 0].min()),
            spreads={"front": float(fronts.std(ddof=1)), "transport": float(np.sqrt(np.mean(np.square(apart))))},
        )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What an ensemble predicts of a flow."""

    deposit: NDArray[np.float32]
    """By the model itself [m], shape [n, D]."""
    volume: NDArray[np.float32]
    """Initial volume of its particles [m^D], shape [n]."""
    front: float
    """Front of that deposit [m]."""
    extent: float
    """From the rear at the start to that front [m]."""
    spreads: Mapping[str, float]
    """`front`: standard deviation of the members' fronts [m]; `transport`: rms over the members of how far the parts of
    their deposits lie from those of the model's [m]."""


def uncertain(spread: Floats | float, extent: Floats | float, floor: float) -> Floats:
    """u, the error [m] that spread [m] and extent [m] let expect, before it is calibrated."""
    return np.hypot(spread, floor * np.asarray(extent))


def calibrated(errors: Floats, spreads: Floats, extents: Floats, command: str = "") -> Calibration:
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
        u = uncertain(spreads, extents, floor)
        return 0.5 * math.log(max(float(np.mean((errors / u) ** 2)), 1.0e-30)) + float(np.mean(np.log(u)))

    floor = float(min(FLOORS, key=misfit))
    ratios = np.sort(np.abs(errors) / uncertain(spreads, extents, floor))
    ranks = {level: math.ceil((count + 1) * level - 1.0e-9) for level in LEVELS}
    return Calibration(
        floor=floor,
        deviation=float(np.sqrt(np.mean(ratios**2))),
        quantiles={f"{level:g}": float(ratios[rank - 1]) for level, rank in ranks.items()},
        flows=count,
        command=command,
    )


def half_width(calibration: Calibration, spread: Floats | float, extent: Floats | float, level: float) -> Floats:
    """w [m] of the band of a level, from spread and extent [m], numbers or arrays. Raises InputError."""
    return quantile(calibration, level) * uncertain(spread, extent, calibration.floor)


def quantile(calibration: Calibration, level: float) -> float:
    """q of the band of a level. Raises InputError."""
    key = f"{level:g}"
    if key not in calibration.quantiles:
        raise InputError(f"expected one of {', '.join(calibration.quantiles)}, got {key}", key="level")
    return calibration.quantiles[key]


def standard_deviation(calibration: Calibration, values: Floats, extent: Floats | float) -> Floats:
    """Standard deviation of the error of each number of an observation, for a likelihood; in its unit, shape [K].

    values: what each member predicts, shape [M, K]; extent: that of the flow where the observation is a length, else
    the size that the numbers have, such as the greatest of them.
    """
    return calibration.deviation * uncertain(values.std(axis=0, ddof=1), extent, calibration.floor)


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """The deposit of a scene, and how far the MPM's may be from it."""

    front: float
    """Predicted front [m]."""
    half_width: float
    """The MPM's front is within this distance of it, at the level asked for [m]."""
    transport: float
    """So are the parts of its deposit along x, rms [m]; `measures.transport_distance`."""
    level: float
    """Share of such flows for which that holds [-]."""
    outcome: Outcome
    warning: str | None
    """Why it may not hold here: the scene is outside of the training data."""


def predict(
    scene: Scene | str | Path, *, model: str | Path | None = None, level: float = 0.95, seed: int = 0
) -> Prediction:
    """Roll out a scene by a model and its members; their spread, calibrated, is how far the MPM may be.

    scene: a scene, the path of one in TOML, or the name of a shipped one; model: a file or a shipped name, that of the
    scene's dimension where absent; level: one of `LEVELS`; seed: of the choice of particles. Raises InputError.
    """
    scene = scene if isinstance(scene, Scene) else read_scene(str(scene))
    path = inference.model_path(model or inference.shipped(scene.dimension))
    known = calibrations(path)
    ensemble = Ensemble.load(path)
    initial = initial_state(scene, ensemble.model.settings, seed=seed)
    outcome = ensemble.outcome(initial.state, initial.conditions, initial.steps)
    front, transport = (
        float(half_width(known[name], outcome.spreads[name], outcome.extent, level)) for name in ("front", "transport")
    )
    return Prediction(
        front=outcome.front,
        half_width=front,
        transport=transport,
        level=level,
        outcome=outcome,
        warning=card.warning(path, scene),
    )


def calibrations(path: Path) -> Mapping[str, Calibration]:
    """Those on the card of the model at `path`. Raises InputError where there are none."""
    known = card.read(path)
    if known is None or known.calibration is None:
        message = "expected a calibration on the model's card, which python -m gns.calibrate writes"
        raise InputError(message, where=str(card.card_path(path)), key="calibration")
    return known.calibration


def covered(calibration: Calibration, errors: Floats, spreads: Floats, extents: Floats, level: float) -> float:
    """Share of flows within the band of a level [-]; errors, spreads and extents [m], shape [n]."""
    ratios = np.abs(errors) / uncertain(spreads, extents, calibration.floor)
    return float(np.mean(ratios <= quantile(calibration, level)))
