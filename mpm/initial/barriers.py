"""The barriers of a retained mass: the nodes of the grid whose velocity they fix.

A barrier is a smooth vertical wall at a lateral face of a mass: the nodes from the face to `BEYOND` cells outside have
no velocity across it. These are all nodes beyond the face in the support of the mass's own particles, so none of it
passes. A face on a wall of the box needs no barrier. If the mass has a gate, all of its barriers rise. Nodes behind the
section of an inflow move with it (`mpm.physics.inflow`).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.bodies import filling
from datasets.geometry.ground import plan_axes
from datasets.scene import INFLOW, TOLERANCE, Mass, Scene
from datasets.scene.particles import Particles
from mpm.arrays.layout import PADDING, Barrier, Inflow, Offset, Retained, Settling
from mpm.initial.slope import meet_in_plan
from mpm.physics.barriers import ENERGY, FORCE
from mpm.physics.inflow import NEVER

BEYOND = 2  # cells beyond a face with held nodes: the support of a quadratic B-spline is one and a half

Range = NDArray[np.int32]  # indices of nodes, [low, high) per axis, shape [2, D]


def barriers(scene: Scene, mass: Mass) -> list[tuple[int, Range]]:
    """For a barrier at each lateral face of `mass` in the box: the axis across it, and the nodes that it holds."""
    standing, foot, reach = [], mass.lower[1], BEYOND * scene.domain.cell
    around = nodes_of(scene, mass, BEYOND)
    for other in scene.masses:
        begins, ends = other.lower[1], other.lower[1] + other.size[1]
        if meet_in_plan(other, mass, reach) and begins < foot - TOLERANCE and ends > foot - reach:
            # The barriers of a mass just below are its own.
            around[0, 1] = PADDING + np.ceil((foot - TOLERANCE) / scene.domain.cell)
    for axis in plan_axes(scene.dimension):
        low, high = mass.lower[axis], mass.lower[axis] + mass.size[axis]
        first, end = around[:, axis].tolist()
        low_side = low > TOLERANCE, (first, first + BEYOND + 1)
        high_side = high < scene.domain.size[axis] - TOLERANCE, (end - BEYOND - 1, end)
        for stands, rows in (low_side, high_side):
            if stands:
                nodes = around.copy()
                nodes[:, axis] = rows
                standing.append((axis, nodes))
    return standing


def nodes_of(scene: Scene, mass: Mass, beyond: int = 0) -> Range:
    """The nodes in the box of a mass and so many more on each side."""
    first = np.floor((np.array(mass.lower) + TOLERANCE) / scene.domain.cell) - beyond
    last = np.ceil((np.add(mass.lower, mass.size) - TOLERANCE) / scene.domain.cell) + beyond
    return np.array([PADDING + first, PADDING + last + 1], np.int32)


def held_tables(
    scenes: Sequence[Scene], particles: Sequence[Particles], offsets: NDArray[np.int32], real: np.dtype[Any]
) -> list[NDArray[Any]]:
    """`barriers`, `retained`, `settling` and `inflows` of some scenes; puts the places of each scene into `offsets`."""
    tables: tuple[list[Any], ...] = [], [], [], []
    for scene, its, offset in zip(scenes, particles, offsets, strict=True):
        offset[Offset.BARRIER], offset[Offset.RETAINED], _, offset[Offset.INFLOW] = map(len, tables)
        speeds = inflow_rows(scene, max(other.frames for other in scenes))
        rows: tuple[list[Any], ...] = (*barrier_tables(scene, its, len(tables[1])), speeds)
        offset[Offset.BARRIERS], offset[Offset.RETAINED_COUNT], _, offset[Offset.INFLOWS] = map(len, rows)
        if its.entry_time is not None:
            offset[Offset.ENTERED] = math.ceil(its.entry_time.max() / scene.frame_dt)
        for table, lines in zip(tables, rows, strict=True):
            table += lines
    kinds: tuple[Any, ...] = np.int32, np.int32, np.float64, real
    counts = map(len, (Barrier, Retained, Settling, Inflow))
    return [np.array(table or [[0] * n], kind) for table, n, kind in zip(tables, counts, kinds, strict=True)]


def barrier_tables(
    scene: Scene, particles: Particles, first: int
) -> tuple[list[list[int]], list[list[int]], list[list[float]]]:
    """Lines of `barriers`, `retained` and `settling`, in the order of `Barrier`, `Retained` and `Settling`.

    The latter two have one line for each retained mass of `scene`, starting with line `first`."""
    held: list[list[int]] = []
    retained: list[list[int]] = []
    settling: list[list[float]] = []
    for index, mass in retained_masses(scene).items():
        standing = barriers(scene, mass)
        if mass.release == "settled":
            standing.append((len(Barrier), nodes_of(scene, mass)))
        for axis, nodes in standing:
            padded = np.pad(nodes, ((0, 0), (0, 3 - scene.dimension)))
            held.append([first + len(retained), axis, *padded[0].tolist(), *padded[1].tolist()])
        members = np.flatnonzero(particles.mass == index)
        release = 0 if isinstance(mass.release, str) else round((mass.release or 0.0) / scene.frame_dt)
        top = max((int(nodes[1, 1]) for axis, nodes in standing if axis < len(Barrier)), default=0)
        retained.append([int(members[0]), int(members[-1]) + 1, release, 0, 0, 0, top])
        material, height = scene.material_of(mass), mass.size[1]
        weight, speed = material.density * float(np.prod(mass.size)), scene.gravity * height / material.wave_speed
        # Without a gate the barriers disappear at once.
        speed_and_time = (0.0, 0.0) if mass.gate is None else (mass.gate.speed, mass.gate.time_constant)
        values = {
            Settling.RATE: np.pi * material.wave_speed / height,
            Settling.PARTICLE: material.density * float(particles.volume[members[0]]),
            Settling.MOST_KINETIC: ENERGY * 0.5 * weight * speed**2,
            Settling.MOST_IMPULSE: FORCE * weight * scene.gravity * scene.frame_dt,
            Settling.GATE_SPEED: speed_and_time[0],
            Settling.GATE_TIME: speed_and_time[1],
            Settling.GATE_FOOT: mass.lower[1],
        }
        settling.append([values.get(column, 0.0) for column in Settling])
    return held, retained, settling


def inflow_rows(scene: Scene, frames: int) -> list[list[float]]:
    """Lines of `inflows`, each with the mean speed in each of so many frames, over the time with inflow."""
    lines, edges, cell = [], scene.frame_dt * np.arange(frames + 1), scene.domain.cell
    for mass in scene.masses:
        flow = filling(scene, mass).inflow if mass.kind == INFLOW else None
        if flow is None:
            continue
        (first, *_, last), speed = flow.hydrograph[:, 0], flow.hydrograph[:, 2]
        middle = 0.5 * (np.maximum(edges[:-1], first) + np.minimum(edges[1:], last))
        flows = (edges[:-1] < last) & (edges[1:] > first)
        speeds = np.where(flows, np.interp(middle, flow.hydrograph[:, 0], speed), NEVER)
        foot = (flow.foot + flow.bed.min() * flow.up) / cell
        lines.append([speeds[0], *foot, *flow.flow, *flow.along, *flow.up, 0.5 * flow.width / cell, *speeds])
    return lines


def retained_masses(scene: Scene) -> dict[int, Mass]:
    """The masses that begin behind barriers, by their index."""
    return {index: mass for index, mass in enumerate(scene.masses) if mass.release is not None}
