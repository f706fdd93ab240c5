"""python -m datasets.forces TRAJECTORY --out DIR: the force on each solid over time, as CSV and as a plot.

    F_k = (J(t_k) - J(t_(k-1))) / (t_k - t_(k-1)),    J(t_(-1)) = 0

J is the recorded impulse on a solid since the start (`Trajectory.solid_impulse`); F_k is the mean force over the
interval that ends at t_k. So sum_k F_k (t_k - t_(k-1)) = J(end), exactly. Smoothing replaces J by its mean over a
window w, with the force mirrored at both ends, which does not change that sum:

    J_w(t) = 1 / w  integral of J from t - w/2 to t + w/2,    J(-t) = -J(t),  J(T + t) = 2 J(T) - J(T - t)
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.command_line import run
from datasets.errors import naming, require
from datasets.files import make_folder, replacing, write_csv
from datasets.flow.trajectory import Trajectory, read_trajectory, solid_names, trajectory_file
from datasets.scene.grid_field import Floats

TABLE, PLOT = "forces.csv", "forces.png"
AXES = ("x", "y", "z")
ROUNDING = 1.0e-9  # relative difference up to which two times are equal
MOST_PANELS = 6  # most solids in one plot; of more, those with the largest peaks are drawn


@dataclass(frozen=True, kw_only=True)
class Forces:
    """Mean forces on solids over the intervals of a trajectory's frames."""

    names: tuple[str, ...]  # of baffles, other solids, then the sides of the box if recorded; `y-` is the floor
    time: Floats  # ends of the intervals [s], shape [T]; each starts at the end of the one before, the first at 0
    force: Floats  # on each solid [N, in 2D per metre of width], shape [T, S, D]; positive along the axes of the box

    @property
    def edges(self) -> Floats:
        """Ends of all intervals, including the start [s], shape [T + 1]."""
        return np.concatenate([[0.0], self.time])

    @property
    def unit(self) -> str:
        """N, in 2D per metre of width."""
        return "N/m" if self.force.shape[2] == 2 else "N"

    @property
    def impulse(self) -> Floats:
        """Total impulse on each solid [N s or N s/m], shape [S, D]: the sum of force times time."""
        return np.asarray(np.einsum("tsd, t -> sd", self.force, np.diff(self.edges)))

    @property
    def peaks(self) -> list[tuple[float, float]]:
        """The largest force on each solid [N or N/m], and the middle of its interval [s]."""
        magnitude = np.linalg.norm(self.force, axis=2)
        last = magnitude.argmax(axis=0)
        middle = 0.5 * (self.edges[last] + self.edges[last + 1])
        return list(zip(magnitude.max(axis=0).tolist(), middle.tolist(), strict=True))

    @property
    def largest(self) -> dict[str, float]:
        """Name of a solid -> largest force [N or N/m]."""
        return {name: force for name, (force, _) in zip(self.names, self.peaks, strict=True)}


def forces_of(trajectory: Trajectory, *, window: float = 0.0) -> Forces:
    """The force on every solid with a recorded impulse, including the box's floor and walls, also averaged over
    `window` [s]. Raises InputError if none was recorded, or for a window outside 0 to twice the run."""
    scene, time, recorded = trajectory.scene, trajectory.time, dict[str, Floats]()
    if trajectory.solid_impulse is not None:
        recorded |= dict(zip(solid_names(scene), np.moveaxis(trajectory.solid_impulse, 1, 0), strict=True))
    # The summary has values for the sides of the box at every `frame_dt` of the scene.
    frames = np.rint(time / scene.frame_dt).astype(int)
    recorded |= {name: np.array(series)[frames] for name, series in trajectory.summary.get("side_impulse", {}).items()}
    require(bool(recorded), "", "a trajectory that recorded the momentum solids took, this one did not")
    kept, edges = intervals(trajectory)
    require(len(edges) > 1, "", "a trajectory of more than its start")
    require(0.0 <= window <= 2.0 * edges[-1], "", f"a window of 0 to {2.0 * edges[-1]:g} s", f"{window:g} s")
    impulse = np.stack([series[kept] for series in recorded.values()], axis=1)
    impulse = np.concatenate([np.zeros_like(impulse[:1]), impulse])
    if window > 0.0:
        impulse = smoothed(impulse, edges, window)
    return Forces(names=tuple(recorded), time=edges[1:], force=np.diff(impulse, axis=0) / np.diff(edges)[:, None, None])


def intervals(trajectory: Trajectory) -> tuple[slice, Floats]:
    """The frames [T] that end an interval over which a force is a mean, and where the intervals begin and end [s],
    shape [T + 1]. A frame at the start ends none, nor do those after the end of the computation, which repeat it."""
    time = trajectory.time
    end = min(float(time[-1]), float(trajectory.summary.get("end_time") or time[-1]))
    kept = slice(1 if time[0] == 0.0 else 0, int(np.searchsorted(time, end * (1.0 - ROUNDING))) + 1)
    return kept, np.concatenate([[0.0], np.minimum(time[kept], end)])


def momentum(trajectory: Trajectory) -> Floats | None:
    """The momentum that each solid has taken up to each frame, shape [T, S, D], None where it was not recorded. A
    deposit at rest still leans on a solid: in frames after the end of the computation, whose recorded momentum repeats
    that of the end, the last force goes on."""
    (kept, edges), recorded = intervals(trajectory), trajectory.solid_impulse
    if recorded is None or len(edges) == 1:
        return recorded
    gained = np.diff(recorded[kept][-2:], axis=0, prepend=0.0 * recorded[:1])[-1]
    after = np.maximum(trajectory.time - edges[-1], 0.0)
    return np.asarray(recorded + after[:, None, None] * gained / (edges[-1] - edges[-2]))


def smoothed(impulse: Floats, time: Floats, window: float) -> Floats:
    """The mean of `impulse` [T, S, D], linear between the times [T], over `window` [s] around each, ends mirrored."""
    from scipy.interpolate import make_interp_spline

    mirrored = np.concatenate([-time[:0:-1], time, 2.0 * time[-1] - time[-2::-1]])
    values = np.concatenate([-impulse[:0:-1], impulse, 2.0 * impulse[-1] - impulse[-2::-1]])
    integral = make_interp_spline(mirrored, values, k=1).antiderivative()
    return np.asarray((integral(time + 0.5 * window) - integral(time - 0.5 * window)) / window)


def write_forces(trajectory: Trajectory, folder: Path, *, window: float = 0.0) -> Forces:
    """Write forces.png and forces.csv into `folder`, and return the forces. The CSV has `time_s`, the end of an
    interval, and the mean force over it for each solid and axis. Raises InputError as `forces_of`."""
    forces = forces_of(trajectory, window=window)
    suffix, axes = forces.unit.replace("/", "_per_"), AXES[: forces.force.shape[2]]
    header = ["time_s", *(f"{name}_f{axis}_{suffix}" for name in forces.names for axis in axes)]
    rows = zip(forces.time.tolist(), forces.force.reshape(len(forces.time), -1).tolist(), strict=True)
    write_csv(folder / TABLE, header, ([f"{time:.10g}", *(f"{value:.9g}" for value in row)] for time, row in rows))
    draw(folder / PLOT, forces)
    return forces


def draw(path: Path, forces: Forces) -> None:
    """Plot the components of the force on each solid over time, and mark the peak of the magnitude."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter

    peaks = forces.peaks
    shown = sorted(sorted(range(len(peaks)), key=lambda index: -peaks[index][0])[:MOST_PANELS])
    figure = Figure(figsize=(9.0, 1.2 + 2.4 * len(shown)), layout="constrained")
    panels = figure.subplots(len(shown), sharex=True, squeeze=False)[:, 0]
    spoken = EngFormatter(unit=forces.unit)
    for panel, index in zip(panels, shown, strict=True):
        for axis, series in zip(AXES, forces.force[:, index].T, strict=False):
            panel.stairs(series, forces.edges, baseline=None, label=f"$F_{axis}$")
        value, time = peaks[index]
        magnitude = np.linalg.norm(forces.force[:, index], axis=1)
        panel.stairs(magnitude, forces.edges, color="black", baseline=None, label="$|F|$")
        panel.plot(time, value, "ko", markersize=4)
        panel.set_title(f"{forces.names[index]}: peak {spoken(value)} at {time:.4g} s", loc="left", fontsize=10)
        panel.yaxis.set_major_formatter(spoken)
        panel.margins(x=0.0, y=0.18)
        panel.grid(alpha=0.25)
    panels[0].legend(loc="upper right", ncols=4, frameon=False, fontsize=9)
    panels[-1].set_xlabel("time [s]")
    if len(shown) < len(forces.names):
        figure.suptitle(f"the largest peaks: {len(shown)} of {len(forces.names)} solids and sides of the box")
    with replacing(path) as part:
        figure.savefig(part, dpi=110)


def spoken(forces: Forces) -> list[str]:
    """A line for each solid: the peak force, its time, and the impulse."""
    lines = []
    for name, (value, time), impulse in zip(forces.names, forces.peaks, forces.impulse, strict=True):
        recorded, unit = ", ".join(f"{part:.4g}" for part in impulse), forces.unit.replace("N", "N s")
        lines.append(f"{name}: peak {value:.4g} {forces.unit} at {time:.4g} s, impulse ({recorded}) {unit}")
    return lines


def command(trajectory: Path, /, *, out: Path, smooth: float = 0.0) -> None:
    """Write the force on each solid over time: OUT/forces.csv and OUT/forces.png.

    Args:
        trajectory: A trajectory (NPZ), or the folder of a run that holds one.
        out: Folder for the results.
        smooth: Time [s] over which forces are averaged in addition to the frame interval; 0 for none.
    """
    flow = read_trajectory(trajectory)
    make_folder(out)
    with naming(trajectory_file(trajectory)):
        forces = write_forces(flow, out, window=smooth)
    print("\n".join(spoken(forces)))


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.forces"))
