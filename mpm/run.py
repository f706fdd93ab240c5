"""python -m mpm.run SCENE --out DIR: simulate one scene with the MPM."""

import sys
from pathlib import Path

from datasets.command_line import run
from datasets.errors import InputError
from datasets.exchange.vtk import write_vtk
from datasets.exchange.vtkhdf import FILE as VTKHDF
from datasets.exchange.vtkhdf import write_vtkhdf
from datasets.files import write_json
from datasets.forces import spoken, write_forces
from datasets.frames import HDF5 as SUFFIX
from datasets.library import read_scene
from datasets.particles import particle_count
from datasets.processes import stopping
from mpm.arrays.layout import Precision
from mpm.footprint import footprint
from mpm.output.checkpoint import Checkpoint
from mpm.output.request import ALL, FIELDS, Recording
from mpm.resolution import read_tolerance, resolved
from mpm.runtime import Arch, workers_for
from mpm.simulation import Interrupted, Options, simulate_resumably


def command(
    scene: str,
    /,
    *,
    out: Path,
    precision: Precision | None = None,
    arch: Arch = "cpu",
    tolerance: str | None = None,
    every: int | None = None,
    last_frame: bool = False,
    fields: bool = False,
    raw_fields: bool = False,
    until_rest: bool = False,
    vtk: bool = False,
    vtkhdf: bool = False,
    forces: bool = False,
    compress: bool = False,
    stream: bool = False,
    checkpoint: bool = False,
    resume: bool = False,
) -> int:
    """Simulate a scene and write its trajectory and a summary.

    Ctrl-C and SIGTERM leave DIR/checkpoint.npz, from which --resume goes on.

    Parameters
    ----------
    scene
        Path of a scene in TOML, or the name of a shipped one.
    out
        Folder for trajectory.npz and summary.json.
    precision
        Arithmetic of the solver; f32 unless given, or what the tolerance requires.
    arch
        Where to compute.
    tolerance
        Run at the cheapest resolution that was measured to keep front and profile within this, such as 2%.
    every
        Keep every so many frames only, and the last.
    last_frame
        Keep the last frame only.
    fields
        Record velocity, stress, pressure, density and plastic strain of every particle too, and forces on the walls.
    raw_fields
        The same, stress and pressure as the particles carry them instead of smoothed through the grid.
    until_rest
        End when the deposit has come to rest; the frames that are left repeat the last one.
    vtk
        Write a series for ParaView to DIR/vtk too, with the fields.
    vtkhdf
        The same in one file: DIR/trajectory.vtkhdf.
    forces
        Write the force on each solid, and on floor and walls, over time too: DIR/forces.csv and DIR/forces.png.
    compress
        Write DIR/trajectory.h5, of a quarter of the size, positions to a part of a cell, instead of trajectory.npz.
    stream
        Keep frames on the disk of DIR while the scene runs, not in memory.
    checkpoint
        Leave DIR/checkpoint.npz at the end too: the state and all that was recorded.
    resume
        Go on from DIR/checkpoint.npz, the same to the bit as without the break: the scene may have a longer duration
        and is the same otherwise; what is recorded, the precision and --until-rest are the checkpoint's.
    """
    given, what = read_scene(scene), None
    if tolerance is not None:
        what = resolved(given, read_tolerance(tolerance))
        given = what.scene
        print(what)
    if last_frame and every is not None:
        raise InputError("expected one of --every and --last-frame, got both", key="--every")
    checkpoint_file = out / "checkpoint.npz"
    start = Checkpoint.load(checkpoint_file) if resume else None
    base = start.recording if start else ALL
    fields = fields or raw_fields or vtk or vtkhdf
    record = Recording(
        frames="last" if last_frame else base.frames if every is None else every,
        fields=frozenset(FIELDS) if fields else base.fields,
        wall_forces=fields or forces or base.wall_forces,
        raw=raw_fields or base.raw,
        until_rest=until_rest or base.until_rest,
    )
    options: Options = {"arch": arch, "record": record, "progress": True}
    if stream:
        options["stream"] = out
    if precision or what:
        options["precision"] = precision or (what.precision if what else "f32")
    precise = options.get("precision") or (start.features.precision if start else "f32")
    workers = workers_for(particle_count(given)) if arch == "cpu" else 1
    print(
        footprint(given, record=record, precision=precise, workers=workers, gpu=arch != "cpu", stream=stream),
        flush=True,
    )
    try:
        with stopping() as stop:
            trajectory, end = simulate_resumably(given, resume=start, stop=stop, **options)
    except Interrupted as interrupted:
        interrupted.checkpoint.save(checkpoint_file)
        end_time = given.frame_dt * interrupted.checkpoint.frame
        print(f"talus: interrupted at t = {end_time:g} s; --resume goes on from {checkpoint_file}", file=sys.stderr)
        return stop.status
    except InputError as error:
        raise error.at(str(checkpoint_file)) if start is not None and not error.where else error from None
    trajectory.save(out / f"trajectory{SUFFIX if compress else '.npz'}")
    # The folder holds one trajectory: that of this run.
    (out / f"trajectory{'.npz' if compress else SUFFIX}").unlink(missing_ok=True)
    write_json(out / "summary.json", trajectory.summary)
    if checkpoint:
        end.save(checkpoint_file)
    if vtk:
        write_vtk(trajectory, out / "vtk", progress=True)
    if vtkhdf:
        write_vtkhdf(trajectory, out / VTKHDF, progress=True)
    if forces:
        print("\n".join(spoken(write_forces(trajectory, out))))
    summary = trajectory.summary
    rate = summary["particles"] * summary["steps"] / summary["wall_s"] / 1.0e6
    rest = f"at rest after {summary['rest_time']:g} s, " if summary["rest_time"] is not None else ""
    print(
        f"front {summary['front']:.4f} m, runout {summary['runout']:.4f} m: {rest}{summary['particles']} particles, "
        f"{summary['steps']} steps in {summary['wall_s']:.2f} s ({rate:.1f} million particle-steps a second), "
        f"{summary['compile_s']:.2f} s to compile"
    )
    return 0


if __name__ == "__main__":
    sys.exit(run(command, "python -m mpm.run"))
