"""`python -m gns.rollout`: run a scene with the learned simulator."""

import dataclasses
import sys
import time
from pathlib import Path

import numpy as np
import torch

from datasets import command_line, files, measures
from datasets.errors import InputError
from datasets.library import read_scene
from datasets.trajectory import Trajectory
from datasets.vtk import write_vtk
from gns import checkpoint
from gns.start import after_frames, at_rest
from gns.unroll import unroll

SHIPPED = Path(__file__).parent / "weights" / "flow2d.pt"
"""The model that is used where none is named."""


def rollout(
    scene: str,
    /,
    *,
    out: Path,
    model: Path = SHIPPED,
    start: Path | None = None,
    seed: int = 0,
    threads: int = 1,
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
        The model's file; the shipped one unless given.
    start
        Trajectory of the MPM whose frames the rollout goes on from; without it, it starts from the scene itself.
    seed
        Seed of the choice of points.
    threads
        Threads of torch.
    vtk
        Write a series for ParaView to OUT/vtk too.
    """
    torch.set_num_threads(threads)
    wanted = read_scene(scene)
    simulator = checkpoint.load(model).simulator
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
    clock = time.perf_counter()
    with torch.no_grad():
        moved = unroll(simulator, problem.state, problem.conditions, problem.steps, progress=True).numpy()
    wall = time.perf_counter() - clock
    positions = np.concatenate((problem.known, moved[1:]))
    deposit = positions[-1]
    summary = {
        "runout": measures.runout(deposit),
        "front": measures.front(deposit),
        "toe": list(measures.toe(deposit)),
        "steps": problem.steps,
        "particles": len(problem.indices),
        "wall_s": wall,
        "device": "cpu",
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
