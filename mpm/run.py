"""python -m mpm.run SCENE --out DIR: simulate one scene with the MPM."""

import sys
from pathlib import Path

from datasets.command_line import run
from datasets.files import write_json
from datasets.library import read_scene
from mpm.runtime import Precision
from mpm.simulate import simulate


def command(scene: str, /, *, out: Path, precision: Precision = "f32") -> None:
    """Simulate a scene and write its trajectory and a summary.

    Parameters
    ----------
    scene
        Path of a scene in TOML, or the name of a shipped one.
    out
        Folder for trajectory.npz and summary.json.
    precision
        Arithmetic of the solver.
    """
    trajectory = simulate(read_scene(scene), precision=precision, threads=1, progress=True)
    trajectory.save(out / "trajectory.npz")
    write_json(out / "summary.json", trajectory.summary)
    summary = trajectory.summary
    rate = summary["particles"] * summary["steps"] / summary["wall_s"] / 1.0e6
    print(
        f"front {summary['front']:.4f} m, runout {summary['runout']:.4f} m: {summary['particles']} points, "
        f"{summary['steps']} steps in {summary['wall_s']:.2f} s ({rate:.1f} million point-steps a second), "
        f"{summary['compile_s']:.2f} s to compile"
    )


if __name__ == "__main__":
    sys.exit(run(command, "python -m mpm.run"))
