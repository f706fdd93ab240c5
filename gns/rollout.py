"""`python -m gns.rollout`: run a scene with the learned simulator."""

import dataclasses
import sys
from pathlib import Path
from typing import Literal

from cyclopts.types import PositiveInt

from datasets import command_line, files
from datasets.errors import InputError, naming, require
from datasets.exchange.vtk import write_vtk
from datasets.flow.trajectory import read_trajectory, trajectory_file
from datasets.scene.library import read_scene
from gns import card
from gns.library import model_path, shipped


def rollout(
    scene: str,
    /,
    *,
    out: Path,
    model: Path | None = None,
    start: Path | None = None,
    threads: PositiveInt = 1,
    device: Literal["cpu", "cuda"] = "cpu",
    vtk: bool = False,
) -> None:
    """Predict a scene with the learned simulator; write OUT/trajectory.npz and OUT/summary.json.

    Args:
        scene: Path of a scene in TOML, or the name of a shipped one.
        out: Folder for the results.
        model: The model's file or the name of a shipped one; unless given, the shipped one for the scene's dimension.
        start: MPM trajectory; the rollout continues from its last whole step of the model instead of starting at the
            release.
        threads: Number of torch threads.
        device: Device that the model runs on.
        vtk: Also write a series for ParaView to OUT/vtk.
    """
    # Imported here, so that --help need not load torch, which takes seconds.
    import torch

    from gns.inference import load, simulate
    from gns.surroundings.initial import check

    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("expected a GPU that torch can use, there is none", key="--device")
    kept = start is None or (out / "trajectory.npz").resolve() != trajectory_file(start).resolve()
    require(kept, "--out", "a folder other than that of --start, whose frames must stay", out)
    read = read_scene(scene)
    path = model_path(model or shipped(read))
    simulator = load(path)
    frames = None if start is None else read_trajectory(start)
    # A run of only the first frames has a shorter duration; all else must agree.
    if frames is not None and dataclasses.replace(frames.scene, duration=read.duration) != read:
        raise InputError(f"expected the frames of {scene}, these belong to another scene", where=str(start))
    try:
        with naming(Path(scene)):
            check(read, simulator.settings)
            if warning := card.warning(path, read):
                print(warning, file=sys.stderr)
            files.make_folder(out)
            trajectory = simulate(read, model=simulator, start=frames, threads=threads, device=device, progress=True)
    except KeyboardInterrupt as interrupt:
        raise type(interrupt)("nothing was written") from None
    summary = trajectory.summary
    trajectory.save(out / "trajectory.npz")
    files.write_json(out / "summary.json", summary)
    if vtk:
        write_vtk(trajectory, out / "vtk", progress=True)
    if frames is not None:
        begins = f"the rollout begins at {trajectory.time[-1 - summary['steps']]:.4g} s of the {frames.time[-1]:.4g} s"
        print(f"{begins} of {start}, after whole steps of the model of {trajectory.scene.frame_dt:.3g} s")
    figures = f"front {summary['front']:.4f} m, runout {summary['runout']:.4f} m, {summary['wall_s']:.1f} s"
    print(f"{figures}, written to {out}")


if __name__ == "__main__":
    sys.exit(command_line.run(rollout, "python -m gns.rollout"))
