"""The shipped flume of 35 degrees: how far its sand runs, what its end wall bears, and where all momentum goes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datasets.files import replacing
from datasets.geometry.surface import surface_of
from datasets.library import read_scene
from datasets.measures import front
from datasets.particles import initial_particles
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import simulate
from mpm.output.request import Recording

SCENE = "flume-35"
SHOWN = (0.0, 0.4, 0.8, 2.0)
"""Times that the picture shows [s]."""


@dataclass(frozen=True, kw_only=True)
class Flume:
    """What the flume's sand did."""

    flow: Trajectory
    front: float
    """Of the deposit [m]."""
    force: NDArray[np.float64]
    """Mean force on the end wall in each frame, along x [N/m], shape [T - 1]."""
    balance: float
    """Largest |P - M g t + what solids and sides took| over the largest M g t, while nothing has left the box [-]."""

    @property
    def peak(self) -> tuple[float, float]:
        """Largest force on the wall [N/m], and when [s]."""
        at = int(np.argmax(self.force))
        return float(self.force[at]), float(self.flow.time[at + 1])


def run_flume(scene: Scene | None = None) -> Flume:
    """Compute the shipped flume, in double precision."""
    scene = scene or read_scene(SCENE)
    record = Recording(fields=frozenset({"velocity"}), wall_forces=True)
    flow = simulate(scene, precision="f64", record=record)
    assert flow.velocities is not None
    assert flow.solid_impulse is not None
    particles = initial_particles(scene)
    mass = particles.density * particles.volume
    momentum = np.einsum("n,tnd->td", mass, flow.velocities.astype(np.float64))
    weight = np.outer(flow.time, scene.gravity_vector) * mass.sum()
    sides = np.sum(list(flow.summary["side_impulse"].values()), axis=0)
    error = np.abs(momentum - weight + sides + flow.solid_impulse.sum(axis=1)).max(axis=1)
    stays = flow.positions[:, :, 0].max(axis=1) < scene.domain.size[0]
    wall = flow.solid_impulse[:, -1, 0]
    return Flume(
        flow=flow,
        front=front(flow.positions[-1]),
        force=np.diff(wall) / np.diff(flow.time),
        balance=float(error[stays].max() / np.abs(weight).max()),
    )


def draw(path: Path, flume: Flume) -> None:
    """The sand at several times, and the force on the end wall over time."""
    scene, flow = flume.flow.scene, flume.flow
    surface = surface_of(scene)
    assert surface is not None
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    grid = figure.add_gridspec(3, 2)
    for number, time in enumerate(SHOWN):
        axes = figure.add_subplot(grid[number // 2, number % 2])
        frame = int(np.abs(flow.time - time).argmin())
        for a, b in surface.corners:
            axes.plot([a[0], b[0]], [a[1], b[1]], color="black", linewidth=1.0)
        axes.scatter(flow.positions[frame, :, 0], flow.positions[frame, :, 1], s=1.0, color="tab:brown", linewidths=0)
        axes.set(xlim=(0.0, scene.domain.size[0]), ylim=(0.0, scene.domain.size[1]), aspect="equal")
        axes.set(title=f"{flow.time[frame]:.1f} s", xlabel="x [m]", ylabel="y [m]")
    axes = figure.add_subplot(grid[2, :])
    axes.plot(flow.time[1:], flume.force, color="tab:blue", linewidth=1.0)
    force, time = flume.peak
    axes.annotate(f"{force:.0f} N/m at {time:.2f} s", (time, force), xytext=(10, -2), textcoords="offset points")
    axes.set(xlabel="time [s]", ylabel="force on the end wall [N/m]")
    with replacing(path) as part:
        figure.savefig(part, dpi=120, format="png")
