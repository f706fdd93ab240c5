"""`python -m gns.rollout`: run a scene with the learned simulator."""

import dataclasses
import sys
import time
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from datasets import command_line, files, measures
from datasets.errors import InputError
from datasets.exchange.vtk import write_vtk
from datasets.library import read_scene
from datasets.trajectory import Floats, Trajectory
from gns.model import card, checkpoint
from gns.model.grid import UP
from gns.start import after_frames, at_rest
from gns.unroll import unroll

WEIGHTS = Path(__file__).parent / "weights"
"""The models that ship."""
SHIPPED = WEIGHTS / "flow2d.pt"
"""The model that is used in 2D where none is named."""


def shipped(dimension: int) -> Path:
    """The model that is used in 2D or 3D where none is named."""
    return WEIGHTS / ("flow2d.pt" if dimension == 2 else "obstacle3d.pt")


def energies(
    positions: Floats, velocity0: Floats, mass: NDArray[np.float64], *, step: float, gravity: float
) -> dict[str, list[float]]:
    """Kinetic and potential energy at each time [J, in 2D per metre of width], by name as the MPM's.

    positions: `step` [s] apart [m], shape [T, n, D]; velocity0: at the first [m/s], [n, D]; mass: [kg], [n].
    Velocities are central differences, at the end one-sided; a point at y = 0 has no potential energy.
    """
    velocities = np.gradient(positions, step, axis=0) if len(positions) > 1 else np.empty_like(positions)
    velocities[0] = velocity0
    kinetic = 0.5 * np.square(velocities).sum(axis=2) @ mass
    potential = gravity * (positions[:, :, UP] @ mass)
    series = {"kinetic": kinetic, "potential": potential}
    return {name: [float(f"{value:.6g}") for value in values] for name, values in series.items()}


def rollout(
    scene: str,
    /,
    *,
    out: Path,
    model: Path | None = None,
    start: Path | None = None,
    seed: int = 0,
    threads: int = 1,
    device: Literal["cpu", "cuda"] = "cpu",
    vtk: bool = False,
) -> None:
    """Run a scene with the learned simulator; leaves OUT/trajectory.npz and OUT/summary.json.

    Parameters
    ----------
    scene
        Path of a scene in TOML, or the name of a shipped one.
    out
        Folder for the results.
    model
        The model's file; unless given, the shipped one for scenes in 2D or in 3D.
    start
        Trajectory of the MPM whose frames the rollout goes on from; without it, it starts from the scene itself.
    seed
        Seed of the choice of points.
    threads
        Threads of torch.
    device
        Where the model runs.
    vtk
        Write a series for ParaView to OUT/vtk too.
    """
    torch.set_num_threads(threads)
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("expected a GPU that torch can use, there is none", key="--device")
    wanted = read_scene(scene)
    simulator = checkpoint.load(model or shipped(wanted.dimension)).simulator.to(device)
    settings, rng = simulator.settings, np.random.default_rng(seed)
    try:
        if start is None:
            problem = at_rest(wanted, settings, rng)
        else:
            frames = Trajectory.load(start)
            # Who starts a run for its first frames cuts it short; all else must agree.
            if dataclasses.replace(frames.scene, duration=wanted.duration) != wanted:
                raise InputError(f"expected the frames of {scene}, they are of another scene", where=str(start))
            problem = after_frames(frames, wanted, settings, rng)
    except InputError as error:
        raise error if error.where else error.at(scene) from None
    if note := card.warning(model or shipped(wanted.dimension), wanted):
        print(note, file=sys.stderr)
    there = problem.to(device)
    clock = time.perf_counter()
    with torch.no_grad():
        moved = unroll(simulator, there.state, there.conditions, problem.steps, progress=True).cpu().numpy()
    wall = time.perf_counter() - clock
    positions = np.concatenate((problem.known, moved[1:]))
    deposit = positions[-1]
    # A model runs only scenes whose masses are of one density.
    mass = wanted.material_of(wanted.masses[0]).density * problem.conditions.volume.numpy().astype(np.float64)
    summary = {
        "runout": measures.runout(deposit),
        "front": measures.front(deposit),
        "toe": list(measures.toe(deposit)),
        "steps": problem.steps,
        "particles": len(problem.indices),
        "energy": energies(positions, problem.velocity0, mass, step=settings.step, gravity=wanted.gravity),
        "wall_s": wall,
        "device": device,
        "start": "rest" if start is None else "frames",
    }
    trajectory = Trajectory(
        positions=positions,
        time=problem.times(settings.step),
        velocity0=problem.velocity0,
        friction=problem.conditions.friction.numpy(),
        scene=wanted,
        summary=summary,
    )
    trajectory.save(out / "trajectory.npz")
    files.write_json(out / "summary.json", summary)
    if vtk:
        write_vtk(trajectory, out / "vtk", progress=True)
    print(f"front {summary['front']:.4f} m, runout {summary['runout']:.4f} m, {wall:.1f} s, written to {out}")


if __name__ == "__main__":
    sys.exit(command_line.run(rollout, "python -m gns.rollout"))
