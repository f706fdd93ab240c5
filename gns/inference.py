"""Load a learned simulator, and roll a scene out with it: `gns.load`, `gns.simulate`."""

import dataclasses
import itertools
import re
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from datasets import measures
from datasets.library import read_scene
from datasets.scene import Scene
from datasets.trajectory import Floats, Trajectory
from gns.initial import initial_state
from gns.model import checkpoint
from gns.model.simulator import Simulator
from gns.unroll import unroll

WEIGHTS = Path(__file__).parent / "weights"
"""The models that ship."""
MEMBER = re.compile(r".*-\d+")
"""How a member of the ensemble of a model is called: its name and a number."""


def shipped(dimension: int) -> Path:
    """The model that is used in 2D or 3D where none is named."""
    return WEIGHTS / f"{'flow2d' if dimension == 2 else 'obstacle3d'}{checkpoint.ENDING}"


SHIPPED = shipped(2)
"""The model that is used in 2D where none is named."""


def models(folder: Path = WEIGHTS) -> list[Path]:
    """The models in a folder, by name; without the members of ensembles."""
    found = [path for path in folder.glob(f"*{checkpoint.ENDING}") if not MEMBER.fullmatch(path.stem)]
    return sorted(found, key=lambda path: path.stem)


def members(model: Path) -> list[Path]:
    """The members of the ensemble of a model, NAME-1, NAME-2 and so on beside it."""
    return list(itertools.takewhile(Path.exists, (member_path(model, number) for number in itertools.count(1))))


def member_path(model: Path, number: int) -> Path:
    """The file of a member of the ensemble of a model, counted from 1."""
    return model.with_name(f"{model.stem}-{number}{checkpoint.ENDING}")


def model_path(model: str | Path) -> Path:
    """The file of a model: a path, or the name of one that ships (flow2d, obstacle3d)."""
    named = WEIGHTS / f"{model}{checkpoint.ENDING}"
    return named if named.is_file() and not Path(model).exists() else Path(model)


def load(model: str | Path) -> Simulator:
    """A trained simulator, ready for inference: a file, or the name of a model that ships.

        simulator = gns.load("flow2d")

    Raises InputError, which names the file.
    """
    return checkpoint.load(model_path(model)).simulator


def simulate(
    scene: Scene | str | Path,
    *,
    model: Simulator | str | Path | None = None,
    start: Trajectory | None = None,
    seed: int = 0,
    device: torch.device | str = "cpu",
    progress: bool = False,
) -> Trajectory:
    """Roll a scene out with the learned simulator.

        trajectory = gns.simulate("column-tall-42")
        trajectory.positions[-1]                    # the deposit [m], shape [N, D]
        trajectory.volume                           # what each particle stands for [m^D], shape [N]

    Parameters
    ----------
    scene
        A scene, the path of one in TOML, or the name of a shipped one.
    model
        A simulator, its file, or the name of a shipped one; the shipped one of the scene's dimension unless given.
    start
        A run of the scene by the MPM, from whose last frame the rollout goes on; at rest (time 0) unless given.
    seed
        Seed of the choice of the particles that stay, of all the scene's.
    device
        Where the model runs.
    progress
        Show a progress bar.

    Returns the trajectory at the model's step, the frames of `start` included; its summary has what
    `python -m gns.rollout` writes. Raises InputError.
    """
    scene = scene if isinstance(scene, Scene) else read_scene(str(scene))
    simulator = model if isinstance(model, Simulator) else load(model or shipped(scene.dimension))
    initial = initial_state(scene, simulator.settings, start, seed=seed)
    there = initial.to(device)
    clock = time.perf_counter()
    with torch.no_grad():
        moved = unroll(simulator.to(device), there.state, there.conditions, there.steps, progress=progress)
    positions = np.concatenate((initial.known, moved[1:].cpu().numpy()))
    wall = time.perf_counter() - clock
    deposit, volume = positions[-1], initial.conditions.volume.numpy()
    # A model runs only scenes whose masses are of one density.
    mass = scene.material_of(scene.masses[0]).density * volume.astype(np.float64)
    summary = {
        "runout": measures.runout(deposit),
        "front": measures.front(deposit),
        "toe": list(measures.toe(deposit)),
        "steps": initial.steps,
        "particles": len(initial.indices),
        "energy": energies(positions, initial.velocity0, mass, step=initial.step, gravity=scene.gravity_vector),
        "wall_s": wall,
        "device": str(device),
        "start": initial.start.value,
    }
    return Trajectory(
        positions=positions,
        time=initial.times,
        velocity0=initial.velocity0,
        friction=initial.conditions.friction.numpy(),
        volume=volume,
        mass=initial.mass,
        scene=dataclasses.replace(scene, frame_dt=initial.step, duration=initial.step * max(len(positions) - 1, 1)),
        summary=summary,
    )


def energies(
    positions: Floats, velocity0: Floats, mass: NDArray[np.float64], *, step: float, gravity: Sequence[float]
) -> dict[str, list[float]]:
    """Kinetic and potential energy at each time [J, in 2D per metre of width], by name as the MPM's.

    positions: `step` [s] apart [m], shape [T, n, D]; velocity0: at the first [m/s], [n, D]; mass: [kg], [n];
    gravity: [m/s^2], [D]. Velocities are central differences, at the end one-sided; a particle in the lower corner of
    the box has no potential energy.
    """
    velocities = np.gradient(positions, step, axis=0) if len(positions) > 1 else np.empty_like(positions)
    velocities[0] = velocity0
    kinetic = 0.5 * np.square(velocities).sum(axis=2) @ mass
    potential = -(positions @ np.array(gravity)) @ mass
    series = {"kinetic": kinetic, "potential": potential}
    return {name: [float(f"{value:.6g}") for value in values] for name, values in series.items()}
