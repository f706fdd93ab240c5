"""How far a rollout may be from the MPM, by flows that training never saw.

    prediction = predict("column-tall-42", level=0.95)
    prediction.front, prediction.half_width      # [m]; 95 of 100 fronts of the MPM are within

The half-width of a prediction is a share of the extent of its deposit, the quantile of the absolute errors e over the
extent on n held-out flows (split conformal prediction, Angelopoulos & Bates, Conformal prediction: a gentle
introduction, Foundations and Trends in Machine Learning 16, 2023, chapter 1):

    q = the ceil((n + 1) level)-th smallest e        where there are so many
    q = rms(e) t_n((1 + level) / 2)                  of fewer flows

A new flow that is drawn as those n were is within q with a probability of at least `level`, whatever the errors are
distributed like; by Student's t_n, the law of a Gaussian error of unknown variance over the rms of n others, where they
are Gaussian. A model has such quantiles for each dataset that it was trained on; those of the narrowest one whose
ranges hold the scene count (`gns.card.Card.calibration`). Outside of all ranges nothing is promised.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets import measures
from datasets.errors import InputError
from datasets.library import read_scene
from datasets.scene import Scene
from gns import card, library
from gns.inference import simulate
from gns.score import LEVELS


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """The deposit of a flow, and how far the MPM's may be from it."""

    deposit: NDArray[np.floating]
    """Positions of the particles [m], shape [n, D]."""
    front: float
    """Front of that deposit [m]."""
    extent: float
    """From its rear to its front [m]."""
    half_width: float
    """The MPM's front is within this distance of it, at the level asked for [m]."""
    profile_error: float
    """Distance along x of equal shares of the two deposits, rms, at most, at that level [m]."""
    warning: str | None = None
    """Why it may not be: the scene is outside of the training data."""


def predict(scene: Scene | str | Path, *, model: str | Path | None = None, level: float = 0.95) -> Prediction:
    """Roll out a scene, with how far the MPM may be.

    scene: a scene, the path of one in TOML, or the name of a shipped one; model: a file or a shipped name, that of the
    scene's dimension where absent; level: one of `LEVELS`. Raises InputError.
    """
    scene = scene if isinstance(scene, Scene) else read_scene(str(scene))
    path = library.model_path(model or library.shipped(scene.dimension))
    if level not in LEVELS:
        raise InputError(f"expected one of {', '.join(map(str, LEVELS))}, got {level:g}", key="level")
    described, key = card.read(path), f"{level:g}"
    known = described.calibration(scene, key) if described is not None else None
    if known is None:
        message = "expected a calibration on the model's card, which python -m gns.score --keep writes"
        raise InputError(message, where=str(card.card_path(path)), key="calibration")
    rollout = simulate(scene, model=path)
    rear, front = measures.ends(rollout.positions[-1], rollout.volumes)
    return Prediction(
        deposit=rollout.positions[-1],
        front=front,
        extent=front - rear,
        half_width=known.front[key] * (front - rear),
        profile_error=known.profile[key] * (front - rear),
        warning=card.warning(path, scene),
    )
