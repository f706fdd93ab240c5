"""python -m mpm.run SCENE --out DIR: simulate one scene with the MPM."""

import sys
from pathlib import Path

from datasets.command_line import run
from datasets.files import write_json
from datasets.library import read_scene
from datasets.vtk import write_vtk
from mpm.layout import Precision
from mpm.resolution import read_tolerance, resolved
from mpm.runtime import Arch
from mpm.simulate import simulate


def command(
    scene: str,
    /,
    *,
    out: Path,
    precision: Precision | None = None,
    arch: Arch = "cpu",
    tolerance: str | None = None,
    fields: bool = False,
    until_rest: bool = False,
    vtk: bool = False,
) -> None:
    """Simulate a scene and write its trajectory and a summary.

    Parameters
    ----------
    scene
        Path of a scene in TOML, or the name of a shipped one.
    out
        Folder for trajectory.npz and summary.json.
    precision
        Arithmetic of the solver; f32 unless given, or what the tolerance asks for.
    arch
        Where to compute.
    tolerance
        Run at the cheapest resolution that was measured to keep front and profile within this, such as 2%.
    fields
        Record velocity, pressure and plastic strain of every particle too.
    until_rest
        End when the deposit has come to rest; the frames that are left repeat the last one.
    vtk
        Write a series for ParaView to DIR/vtk too, with the fields.
    """
    given, what = read_scene(scene), None
    if tolerance is not None:
        what = resolved(given, read_tolerance(tolerance))
        given = what.scene
        print(what)
    trajectory = simulate(
        given,
        precision=precision or (what.precision if what else "f32"),
        arch=arch,
        fields=fields or vtk,
        until_rest=until_rest,
        progress=True,
    )
    trajectory.save(out / "trajectory.npz")
    write_json(out / "summary.json", trajectory.summary)
    if vtk:
        write_vtk(trajectory, out / "vtk", progress=True)
    summary = trajectory.summary
    rate = summary["particles"] * summary["steps"] / summary["wall_s"] / 1.0e6
    rest = f"at rest after {summary['rest_time']:g} s, " if summary["rest_time"] else ""
    print(
        f"front {summary['front']:.4f} m, runout {summary['runout']:.4f} m: {rest}{summary['particles']} particles, "
        f"{summary['steps']} steps in {summary['wall_s']:.2f} s ({rate:.1f} million particle-steps a second), "
        f"{summary['compile_s']:.2f} s to compile"
    )


if __name__ == "__main__":
    sys.exit(run(command, "python -m mpm.run"))
