"""The shipped flume of 35 degrees: its front, the force on its end wall, and its balance of momentum."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.surface import surface_of
from datasets.library import read_scene
from datasets.measures import front
from datasets.particles import initial_particles
from datasets.trajectory import Trajectory
from mpm import Recording, simulate
from validation.report.plots import INK, ORANGE, figure, pane

SCENE = "flume-35"
SHOWN = (0.0, 0.4, 0.8, 1.4, 2.0)
"""Times that the picture shows [s]."""


@dataclass(frozen=True, kw_only=True)
class Flume:
    """The flow in the flume."""

    flow: Trajectory
    front: float
    """Of the deposit [m]."""
    force: NDArray[np.float64]
    """Mean force on the end wall in each frame, along x [N/m], shape [T - 1]."""
    balance: float
    """Largest |P - M g t + impulse on solids and walls| over the largest M g t, while nothing has left the box [-]."""

    @property
    def peak(self) -> tuple[float, float]:
        """Largest force on the wall [N/m], and when [s]."""
        at = int(np.argmax(self.force))
        return float(self.force[at]), float(self.flow.time[at + 1])


def run_flume() -> Flume:
    """Compute the shipped flume, in double precision."""
    scene = read_scene(SCENE)
    record = Recording(fields=frozenset({"velocity"}), wall_forces=True)
    flow = simulate(scene, precision="f64", record=record)
    assert flow.velocities is not None
    assert flow.solid_impulse is not None
    particles = initial_particles(scene)
    mass = particles.density * particles.volume
    momentum = np.einsum("n,tnd->td", mass, flow.velocities.astype(np.float64))
    weight = np.outer(flow.time, scene.gravity_vector) * mass.sum()
    walls = np.sum(list(flow.summary["side_impulse"].values()), axis=0)
    error = np.abs(momentum - weight + walls + flow.solid_impulse.sum(axis=1)).max(axis=1)
    stays = flow.positions[:, :, 0].max(axis=1) < scene.domain.size[0]
    wall = flow.solid_impulse[:, -1, 0]
    return Flume(
        flow=flow,
        front=front(flow.positions[-1]),
        force=np.diff(wall) / np.diff(flow.time),
        balance=float(error[stays].max() / np.abs(weight).max()),
    )


def draw(path: Path, flume: Flume) -> None:
    """The sand at some times, and the force on the end wall over time."""
    scene, flow = flume.flow.scene, flume.flow
    surface = surface_of(scene)
    assert surface is not None
    with figure(path, rows=3, columns=2, size=(4.5, 2.5)) as axes:
        for axis, time in zip(axes.flat, SHOWN, strict=False):
            frame = int(np.abs(flow.time - time).argmin())
            for a, b in surface.corners:
                axis.plot([a[0], b[0]], [a[1], b[1]], color=INK, linewidth=1.0)
            axis.plot(flow.positions[frame, :, 0], flow.positions[frame, :, 1], ".", color=ORANGE, markersize=1.0)
            axis.set(xlim=(0.0, scene.domain.size[0]), ylim=(0.0, scene.domain.size[1]), aspect="equal")
            axis.set(title=f"{flow.time[frame]:.2f} s", xlabel="x [m]", ylabel="y [m]")
        last = pane(axes, 2, 1)
        last.plot(flow.time[1:], flume.force, linewidth=1.0)
        force, time = flume.peak
        last.annotate(f"{force:.0f} N/m at {time:.2f} s", (time, force), xytext=(6, -4), textcoords="offset points")
        last.set(xlabel="time [s]", ylabel="force on the end wall [N/m]")
