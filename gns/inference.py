"""Load a learned simulator, and roll a scene out with it: `gns.load`, `gns.simulate`, `gns.predict`."""

import time
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from datasets.errors import InputError, WorkFailed, require
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene
from datasets.scene.library import read_scene
from gns import card, checkpoint
from gns.library import model_path, shipped
from gns.simulator import Simulator, StepModel, checked, on_threads, unroll
from gns.surroundings.initial import initial_state
from gns.surroundings.state import in_model_units


def load(model: str | Path) -> Simulator:
    """A trained simulator with frozen weights, from a file or a shipped name such as `flow2d`. Raises InputError."""
    return checkpoint.load(model_path(model)).simulator


def simulate(
    scene: Scene | str | Path,
    *,
    model: StepModel | str | Path | None = None,
    start: Trajectory | None = None,
    threads: int = 1,
    device: torch.device | str = "cpu",
    progress: bool = False,
) -> Trajectory:
    """Roll a scene out with the learned simulator.

        trajectory = gns.simulate("column-tall-42")
        trajectory.positions[-1]                    # the deposit [m], shape [N, D]
        trajectory.volume                           # that each particle represents [m^D], shape [N]

    scene: a scene, the path of one in TOML, or the name of a shipped one; model: a simulator, your own network
    (`gns.simulator.StepModel`), a model's file or a shipped name; by default the shipped model for the scene; start: an
    MPM run of the scene, which the rollout continues from the last whole step of the model on, at least one; by default
    it begins at time 0; threads: of torch; device: where the model runs; progress: show a progress bar.

    Returns the trajectory at the model's step, the frames of `start` included; its summary has what
    `python -m gns.rollout` writes. Raises InputError, and WorkFailed if positions are not finite.
    """
    scene = scene if isinstance(scene, Scene) else read_scene(str(scene))
    model = shipped(scene) if model is None else model
    simulator = load(model) if isinstance(model, str | Path) else checked(model)
    initial = initial_state(scene, simulator.settings, start)
    there = initial.to(device)
    clock = time.perf_counter()
    given = simulator.to(device), there.state, there.conditions, there.steps
    with torch.no_grad():
        moved = on_threads(threads, unroll, *given, progress=progress)
    positions, volume = np.concatenate((initial.known, moved[1:].cpu().numpy())), initial.conditions.volume.numpy()
    wall = time.perf_counter() - clock
    if not np.isfinite(positions).all():
        raise WorkFailed("the model's positions are not finite")
    if isinstance(simulator, Simulator) and initial.steps > 0 and bool((moved[-1] == moved[0]).all()):
        with torch.no_grad():
            stands = bool(simulator.moment(*in_model_units(there.state, there.conditions)).stands().all())
        if not stands:
            message = "the surrogate predicts rest on a bed too smooth or too steep to hold the mass: ask the MPM"
            warnings.warn(message, stacklevel=2)
    summary: dict[str, Any] = {**measures.extents(scene, positions[-1], volume), "steps": initial.steps}
    summary |= {"particles": len(initial.indices), "wall_s": wall, "device": str(device)}
    summary["start"] = "rest" if start is None else "frames"
    return Trajectory(
        positions=positions,
        time=initial.times,
        velocity0=initial.velocity0,
        friction=initial.conditions.friction.numpy(),
        volume=volume,
        mass=initial.mass,
        scene=replace(scene, frame_dt=initial.step, duration=initial.step * max(len(positions) - 1, 1)),
        summary=summary,
    )


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """The predicted deposit of a flow, and how far the MPM's deposit may be from it."""

    deposit: NDArray[np.floating] = field(repr=False)
    """Positions of the particles [m], shape [n, D]."""
    front: float
    """Front of that deposit [m]."""
    extent: float
    """Distance from its rear to its front [m]."""
    half_width: float
    """The MPM's front is within this distance of `front`, at the level asked for [m]."""
    profile_error: float
    """Bound at that level on the rms distance along x between equal shares of the two deposits [m]."""
    warning: str | None = None
    """Why these bounds may not hold: the scene lies outside the training range."""


def predict(
    scene: Scene | str | Path,
    *,
    model: StepModel | str | Path | None = None,
    level: float = 0.95,
    calibration: card.Calibration | None = None,
) -> Prediction:
    """Roll out a scene, with error bands of flows that training never saw (`gns.score`).

        prediction = gns.predict("column-tall-42", level=0.95)
        prediction.front, prediction.half_width     # [m]; 95 of 100 MPM fronts lie within the band

    scene, model: as in `simulate`; level: one of `gns.card.LEVELS`; calibration: by default that of the model's card;
    for your own network, the result of `gns.score.calibrated`. Raises InputError.
    """
    scene = scene if isinstance(scene, Scene) else read_scene(str(scene))
    model = shipped(scene) if model is None else model
    path = model_path(model) if isinstance(model, str | Path) else None
    require(level in card.LEVELS, "level", f"one of {', '.join(map(str, card.LEVELS))}", repr(level))
    described, key = None if path is None else card.read(path), f"{level:g}"
    if calibration is None and described is not None:
        calibration = described.calibration(scene, key)
    if calibration is None:
        message = "expected a calibration, from gns.score.calibrated or on the card, where gns.score --keep writes it"
        raise InputError(message, where="" if path is None else str(card.card_path(path)), key="calibration")
    rollout = simulate(scene, model=model)
    rear, front = measures.ends(rollout.positions[-1], rollout.volumes)
    return Prediction(
        deposit=rollout.positions[-1],
        front=front,
        extent=front - rear,
        half_width=calibration.front[key] * (front - rear),
        profile_error=calibration.profile[key] * (front - rear),
        warning="the training range of this network is unknown" if path is None else card.warning(path, scene),
    )
