"""python -m mpm.run SCENE --out DIR: simulate one scene with the MPM."""

import dataclasses
import shlex
import sys
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from datasets.command_line import run
from datasets.errors import InputError, naming, require
from datasets.exchange.vtk import remove_series, write_vtk
from datasets.files import make_folder, write_json
from datasets.flow.array_files import HDF5, FrameWriter
from datasets.flow.trajectory import open_trajectory
from datasets.forces import PLOT, TABLE, spoken, write_forces
from datasets.processes import stopping
from datasets.scene import Scene
from datasets.scene.library import read_scene
from datasets.scene.particles import particle_count
from mpm.arrays.layout import Precision
from mpm.footprint import expected, footprint, step_spoken
from mpm.output.checkpoint import Checkpoint, described
from mpm.output.recording import Recording
from mpm.resolution import read_tolerance, resolved
from mpm.runtime import Arch, parts_for

if TYPE_CHECKING:
    from mpm.simulation import Options


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
    until_rest: bool = False,
    vtk: bool = False,
    forces: bool = False,
    hdf5: bool = False,
    safety: bool = False,
) -> int:
    """Simulate a scene and write its trajectory and a summary, or with --safety compute its factor of safety.

    Ctrl-C and SIGTERM leave DIR/checkpoint.npz. The same command then continues from it, with the same result to the
    bit as an uninterrupted run.

    Args:
        scene: Path of a scene in TOML, or the name of a shipped one.
        out: Folder for trajectory.npz and summary.json.
        precision: Arithmetic of the solver; f32 unless given, or what the tolerance requires.
        arch: Processor to compute on.
        tolerance: Use the cheapest resolution whose measured error of front and profile is within this, such as 2%.
        every: Keep only every n-th frame and the last.
        last_frame: Keep only the last frame.
        fields: Also record velocity, stress, pressure and plastic strain of every particle, and forces on the walls.
        until_rest: End when the deposit has come to rest; the remaining frames repeat the last one.
        vtk: Also write a series for ParaView, with the fields, to DIR/vtk.
        forces: Also write the force on each solid, the floor and the walls over time, to DIR/forces.csv and .png.
        hdf5: Write DIR/trajectory.h5 instead of trajectory.npz, frame by frame during the run: the positions need not
            fit into memory, unless fields are recorded too.
        safety: Compute the factor of safety, by which the strength may be divided before the slope moves, from about
            twelve runs at the scene's cell size; write DIR/safety.json instead of a trajectory."""
    if safety:
        others = {"arch": arch != "cpu", "tolerance": tolerance, "every": every, "last-frame": last_frame}
        others |= {"fields": fields, "until-rest": until_rest, "vtk": vtk, "forces": forces, "hdf5": hdf5}
        if key := next((name for name, given in others.items() if given), ""):
            raise InputError("expected none beside --safety, which takes only --out and --precision", key=f"--{key}")
        with naming(Path(scene)):
            return write_safety(read_scene(scene), out, precision or "f32")
    given, precise = read_scene(scene), precision or "f32"
    if tolerance is not None:
        what = resolved(given, read_tolerance(tolerance))
        given, precise = what.scene, precision or what.measured.resolution.precision
        print(what)
    require(not last_frame or every is None, "--every", "one of --every and --last-frame", "both")
    require(every is None or every >= 1, "--every", "a whole number from 1 on", every)
    fields = fields or vtk
    frames: Literal["all", "last"] | int = "last" if last_frame else "all" if every is None else every
    record = Recording(frames=frames, fields=fields, wall_forces=fields or forces, until_rest=until_rest)
    options: Options = {"arch": arch, "record": record, "precision": precise, "progress": True}
    return write_flow(scene, given, out, options, hdf5=hdf5, vtk=vtk, forces=forces)


def write_flow(name: str, scene: Scene, out: Path, options: "Options", *, hdf5: bool, vtk: bool, forces: bool) -> int:
    """Simulate `scene`, from a checkpoint if there is one, and write the files of `command`; return the exit status."""
    record, precision, gpu = options["record"], options["precision"], options["arch"] != "cpu"
    workers = 1 if gpu else parts_for(particle_count(scene))
    # Whether frames are written one by one to HDF5.
    appended = hdf5 and not (record.fields or record.every == 0 or gpu)
    with naming(Path(name)):
        plan = footprint(scene, record=record, precision=precision, workers=workers, gpu=gpu, in_file=appended)
    # Imported here: --help needs no compiler.
    from mpm.simulation import Interrupted, simulate

    file, frames = out / "checkpoint.npz", out / f"trajectory{HDF5}"
    start = Checkpoint.load(file) if file.exists() else None
    if start is not None and start.run != described(scene, record, precision):
        print(f"talus: {file}: of another scene, recording or precision; starting anew", file=sys.stderr)
        start = None
    if start is not None and frames.exists():
        start.arrays["positions"] = open_trajectory(frames).positions
    work = plan.work * (1.0 if start is None else 1.0 - start.frame / max(1, scene.frames - 1))
    machine: dict[str, Any] = {"processors": workers, "precision": precision, "arch": options["arch"]}
    price = expected(scene, work, memory=plan.bytes, until_rest=record.until_rest, **machine)
    make_folder(out)
    print(f"{plan}; {step_spoken(scene)}; {price}", flush=True)
    with stopping() as stop:
        checkpoint = None
        # When this block ends, the new file of frames replaces the old one.
        with ExitStack() as stack:
            if appended:
                options["file"] = stack.enter_context(FrameWriter(frames))
            try:
                trajectory = simulate(scene, resume=start, stop=stop, **options)
            except Interrupted as interrupted:
                checkpoint, trajectory = interrupted.checkpoint, interrupted.so_far
            except InputError as error:
                raise error.at(str(file)) if start is not None and not error.where else error from None
            if appended:
                options["file"].put(**trajectory.arrays())
        if checkpoint is not None:
            checkpoint.save(file)
            end_time = scene.frame_dt * checkpoint.frame
            print(f"talus: interrupted at t = {end_time:g} s; the same command continues from {file}", file=sys.stderr)
            return stop.status
        if not appended:
            trajectory.save(frames if hdf5 else out / "trajectory.npz")
        summary = trajectory.summary
        write_json(out / "summary.json", summary)
        # The folder keeps only the trajectory of this run and the files written from it below.
        for former in ("trajectory.npz" if hdf5 else frames.name, TABLE, PLOT, file.name):
            (out / former).unlink(missing_ok=True)
        with suppress(OSError):  # the folder holds other files
            remove_series(out / "vtk")
            (out / "vtk").rmdir()
        if vtk:
            write_vtk(trajectory, out / "vtk", progress=True)
        if forces:
            print("\n".join(spoken(write_forces(trajectory, out))))
    print_summary(summary, out, asked=record.until_rest)
    return 0


def print_summary(summary: Mapping[str, Any], out: Path, *, asked: bool) -> None:
    """Print front and runout, when the flow came to rest (if `asked`), the cost, how to view the flow, and remarks."""
    rate = summary["particles"] * summary["steps"] / summary["wall_s"] / 1.0e6
    rest = "not at rest when its duration ended, " if asked else ""
    if summary["rest_time"] is not None:
        rest = f"at rest after {summary['rest_time']:g} s, "
    print(
        f"front {summary['front']:.4f} m, runout {summary['runout']:.4f} m: {rest}{summary['particles']} particles, "
        f"{summary['steps']} steps in {summary['wall_s']:.2f} s ({rate:.1f} million particle-steps a second), "
        f"{summary['compile_s']:.2f} s to compile"
    )
    if water := summary.get("drainage"):
        print(water)
    print(f"python -m validation.view {shlex.quote(str(out))} shows it in a browser")
    for line in summary["remarks"]:
        print(f"talus: {line}", file=sys.stderr)


def write_safety(scene: Scene, out: Path, precision: Precision) -> int:
    """Compute the factor of safety of a scene; write it to a file and print it."""
    from mpm.safety import safety_factor

    make_folder(out)
    safety = safety_factor(scene, precision=precision, progress=True)
    write_json(out / "safety.json", dataclasses.asdict(safety))
    print(
        f"factor of safety {safety.factor:.3f}: stands at {safety.stands:.3f}, moves at {safety.moves:.3f}; "
        f"{safety.cells:.3g} cells over the height, {len(safety.displacements)} runs in {safety.seconds:.1f} s"
    )
    return 0


if __name__ == "__main__":
    sys.exit(run(command, "python -m mpm.run"))
