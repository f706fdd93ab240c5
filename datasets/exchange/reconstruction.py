"""A scene for a trajectory that came without one: what follows from its particles, and what had to be assumed.

| of the scene | from |
|---|---|
| `domain.size` | the bounds, their lower corner moved to the origin |
| `domain.cell`, `particles_per_axis` | the spacing of the particles, so that a domain is a whole number of cells |
| `frame_dt`, `duration` | the time between frames and their number |
| `material.friction_deg` | the material property, or the angle that the user gives |
| `masses` | the box around each cluster of sand in the first frame, with its mean velocity and friction |
| `baffles` | the boxes that the stationary particles fill |
| all else | the defaults of a scene: nobody knows |
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from datasets.errors import InputError
from datasets.exchange.baffle_particles import DECIMALS, Box, baffles_in, clusters
from datasets.exchange.cloud import Cloud
from datasets.material import Material
from datasets.measures import front, runout, toe
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Floats, Trajectory

NEIGHBOURS = np.arange(8, 25)
"""Whose distances tell the spacing: far enough to look past the jitter, near enough to stay inside a mass."""
FEWEST_INSIDE, FEWEST_RANKS = 20, 5
"""Points with a whole ball, and ranks of neighbours with so many, that an estimate from the inside takes."""
STRETCH = 0.05
"""How far a cell may be from twice the spacing, as a fraction, to divide the domain without a rest."""
MOST_CELLS = 100_000
STILL = 1.0e-3
"""Movement of a stationary particle, in spacings, that is round-off."""
VELOCITY_DECIMALS = 4
"""Of a mass's velocity [m/s]: positions in single precision, a frame apart, tell no more."""
ASSUMED = (
    "masses are the boxes around each cluster of sand in the first frame, less the baffles",
    "velocity0 is the first displacement over the time between frames",
    "material constants but the angle of friction, friction of floor and walls, and damping are defaults",
)


@dataclass(frozen=True, kw_only=True)
class Known:
    """What a dataset says of all its trajectories, and what the user adds."""

    bounds: tuple[tuple[float, float], ...]
    """Lower and upper end of the box per axis [m]."""
    frame_dt: float
    """Time between frames [s]."""
    spacing: float | None
    """Spacing of the particles at the start [m]; estimated from them where None."""
    spacing_from: str
    """Where that is known from: `dx`, `--spacing` or `estimate`."""
    friction_deg: float | None
    """Angle of friction [deg] of sets that do not say."""


def reconstruct(cloud: Cloud, known: Known) -> Trajectory:
    """The trajectory of the sand, in a scene made from its particles. Raises InputError."""
    try:
        return _reconstruct(cloud, known)
    except InputError as error:
        raise InputError(error.message, key=": ".join(part for part in (cloud.name, error.key) if part)) from None


def _reconstruct(cloud: Cloud, known: Known) -> Trajectory:
    lower = np.array([low for low, _ in known.bounds])
    if cloud.positions.shape[2] != len(lower):
        raise InputError(f"expected {len(lower)}D positions as in the metadata, got {cloud.positions.shape[2]}D")
    positions = cloud.positions - lower if lower.any() else cloud.positions
    sand = np.ascontiguousarray(positions[:, ~cloud.stationary], dtype=np.float32)
    start = sand[0].astype(np.float64)
    velocity0 = (sand[1] - start) / known.frame_dt
    friction = sand_friction(cloud, known.friction_deg)

    spacing = estimated_spacing(start) if known.spacing is None else known.spacing
    lengths = tuple(round(high - low, 9) for low, high in known.bounds)
    domain, particles_per_axis = fitted_domain(lengths, spacing)
    spacing = domain.cell / particles_per_axis
    baffles = baffles_in(fixed_particles(positions[:, cloud.stationary], spacing), spacing)
    boxes = mass_boxes(start, spacing, domain, baffles)
    shared, masses = masses_in(boxes, start, velocity0, friction)
    scene = Scene(
        domain=domain,
        material=shared,
        masses=masses,
        baffles=baffles,
        duration=(len(sand) - 1) * known.frame_dt,
        frame_dt=known.frame_dt,
        particles_per_axis=particles_per_axis,
    )
    return Trajectory(
        positions=sand,
        time=np.arange(len(sand), dtype=np.float64) * known.frame_dt,
        velocity0=velocity0.astype(np.float32),
        friction=friction,
        scene=scene,
        summary={
            "runout": runout(sand[-1]),
            "front": front(sand[-1]),
            "toe": list(toe(sand[-1])),
            "particles": len(friction),
            "reconstructed": {
                "trajectory": cloud.name,
                "origin": lower.tolist(),
                "grown": [new - old for new, old in zip(domain.size, lengths, strict=True)],
                "spacing": spacing,
                "spacing_from": known.spacing_from,
                "filled": len(sand[0]) * scene.particle_volume / sum(math.prod(mass.size) for mass in scene.masses),
                "outside": int(((sand < 0.0) | (sand > np.array(domain.size, np.float32))).any(axis=(0, 2)).sum()),
                "obstacle_particles": int(cloud.stationary.sum()),
                "assumed": list(ASSUMED),
            },
        },
    )


def sand_friction(cloud: Cloud, friction_deg: float | None) -> Floats:
    """tan(phi) of each particle of sand, shape [N], from the file or the user; InputError without or with both."""
    sand = ~cloud.stationary
    if cloud.friction is not None:
        if friction_deg is not None:
            raise InputError("expected no --friction-deg, the set says what tan(phi) is")
        return cloud.friction[sand]
    if friction_deg is None:
        raise InputError("expected --friction-deg, the set says nothing of the friction")
    return np.full(int(sand.sum()), Material(friction_deg=friction_deg).friction, np.float32)


def estimated_spacing(particles: NDArray[np.float64]) -> float:
    """About how far apart particles are [m], such that spacing^D is the volume of one; positions [N, D].

    A ball up to the k-th neighbour holds k particles and half of another; the median over the particles whose ball
    stays inside the sand, the mean over k. Masses of 20 particles a side, 8 in 3D: within 2 % for a lattice, jittered
    or not (3 % in 3D), within 6 % for particles strewn at random.
    """
    if len(particles) <= NEIGHBOURS[-1]:
        raise InputError(f"expected --spacing, for {len(particles)} particles of sand are too few to estimate it")
    dimension = particles.shape[1]
    distance, _ = cKDTree(particles).query(particles, k=NEIGHBOURS + 1)
    unit_ball = math.pi if dimension == 2 else 4.0 / 3.0 * math.pi
    scale = (unit_ball / (NEIGHBOURS + 0.5)) ** (1.0 / dimension)
    # At an edge a ball is half empty; too many edges make this too long, but long enough to find what is inside.
    rough = float(np.mean(np.median(distance, axis=0) * scale))
    if rough <= 0.0:
        raise InputError("expected --spacing, for most particles of sand lie on top of others")
    depth = np.empty(len(particles))
    for cluster in clusters(particles, rough):
        sand = particles[cluster]
        depth[cluster] = np.minimum(sand - sand.min(axis=0), sand.max(axis=0) - sand).min(axis=1) + rough / 2
    inner = distance <= depth[:, None]
    enough = inner.sum(axis=0) >= FEWEST_INSIDE
    if enough.sum() < FEWEST_RANKS:
        return rough
    return float(np.mean([np.median(distance[inner[:, k], k]) * scale[k] for k in np.flatnonzero(enough)]))


def fitted_domain(lengths: tuple[float, ...], spacing: float) -> tuple[Domain, int]:
    """A domain of `lengths` [m] in whole cells, and the particles per axis of a cell, for a `spacing` [m].

    As they are, where some number of spacings divides the lengths; else in cells of two spacings stretched by at most
    5 %; else grown, up to a cell, at the upper end of each axis.
    """

    def divides(cell: float) -> bool:
        return all(abs(length / cell - max(1, round(length / cell))) < 1e-7 * length / cell for length in lengths)

    ideal = lengths[0] / (2 * spacing)
    if ideal > MOST_CELLS:
        raise InputError(
            f"expected a box of at most {MOST_CELLS} cells a side, the particles are {spacing:.3g} m apart"
        )
    for particles_per_axis in (2, 3, 1):
        if divides(particles_per_axis * spacing):
            return Domain(size=lengths, cell=round(particles_per_axis * spacing, 12)), particles_per_axis
    counts = range(max(1, math.floor(ideal * (1 - STRETCH))), math.ceil(ideal * (1 + STRETCH)) + 1)
    for count in sorted(counts, key=lambda count: abs(count - ideal)):
        if divides(lengths[0] / count):
            return Domain(size=lengths, cell=round(lengths[0] / count, 12)), 2
    cell = float(f"{2 * spacing:.3g}")
    return Domain(size=tuple(round(math.ceil(length / cell - 1e-9) * cell, 9) for length in lengths), cell=cell), 2


def fixed_particles(positions: NDArray[np.floating], spacing: float) -> NDArray[np.float64]:
    """The particles of the obstacles [m], shape [N, D], from all frames [T, N, D]. Raises InputError if they move."""
    first: NDArray[np.float64] = positions[0].astype(np.float64)
    moved = float(max((abs(frame - first).max(initial=0.0) for frame in positions), default=0.0))
    if moved > STILL * spacing:
        raise InputError(f"expected stationary particles to stay where they are, they move by {moved:.3g} m")
    return first


def mass_boxes(
    particles: NDArray[np.float64], spacing: float, domain: Domain, baffles: tuple[Baffle, ...]
) -> list[Box]:
    """Boxes that hold the sand of the first frame [m], shape [N, D]; none of them overlaps another or a baffle."""
    limit = np.array(domain.size)
    boxes = []
    for cluster in clusters(particles, spacing):
        low, high = grown_box(particles[cluster], spacing)
        boxes.append((low.clip(0.0, limit).round(DECIMALS), high.clip(0.0, limit).round(DECIMALS)))
    while pair := next((pair for pair in itertools.combinations(boxes, 2) if overlap(*pair)), None):
        boxes = [box for box in boxes if not any(box is one for one in pair)]
        (low, high), (other_low, other_high) = pair
        boxes.append((np.minimum(low, other_low), np.maximum(high, other_high)))
    for baffle in baffles:
        solid = np.array(baffle.lower), np.array(baffle.lower) + baffle.size
        boxes = [part for box in boxes for part in (without(box, solid) if overlap(box, solid) else [box])]
    boxes = [box for box in boxes if inside(particles, box).any() and (box[0] < box[1]).all()]
    if not boxes:
        raise InputError("expected sand inside the bounds and outside the obstacles in the first frame")
    return sorted(boxes, key=lambda box: tuple(box[0]))


def grown_box(particles: NDArray[np.float64], spacing: float) -> Box:
    """The box around a cluster, wider on all sides until it has the volume of its particles, half a spacing at most."""
    low, high = particles.min(axis=0), particles.max(axis=0)

    def spare(margin: float) -> float:
        return float(np.prod(high - low + 2.0 * margin) - len(particles) * spacing ** len(low))

    margin = 0.0 if spare(0.0) >= 0.0 else spacing / 2
    if margin and spare(margin) > 0.0:
        margin = float(brentq(spare, 0.0, margin))
    return low - margin, high + margin


def overlap(a: Box, b: Box) -> bool:
    """Whether two boxes share volume."""
    return bool((a[0] < b[1]).all() and (b[0] < a[1]).all())


def without(box: Box, solid: Box) -> list[Box]:
    """What is left of `box` outside `solid`, which it overlaps, as boxes."""
    low, high = box[0].copy(), box[1].copy()
    rest = []
    for axis in range(len(low)):
        if low[axis] < solid[0][axis]:
            cut = high.copy()
            cut[axis] = solid[0][axis]
            rest.append((low.copy(), cut))
            low[axis] = solid[0][axis]
        if solid[1][axis] < high[axis]:
            cut = low.copy()
            cut[axis] = solid[1][axis]
            rest.append((cut, high.copy()))
            high[axis] = solid[1][axis]
    return rest


def inside(particles: NDArray[np.float64], box: Box) -> NDArray[np.bool_]:
    """Which particles lie in `box`, shape [N]."""
    return np.asarray(((particles >= box[0]) & (particles <= box[1])).all(axis=1))


def masses_in(
    boxes: list[Box], particles: NDArray[np.float64], velocity0: NDArray[np.float64], friction: Floats
) -> tuple[Material, tuple[Mass, ...]]:
    """The first box's material, and a mass for each box: mean velocity and mean tan(phi) of the particles there."""
    materials, masses = [], []
    for low, high in boxes:
        here = inside(particles, (low, high))
        mean = float(friction[here].mean(dtype=np.float64))
        materials.append(Material(friction_deg=round(math.degrees(math.atan(mean)), 4)))
        velocity = velocity0[here].mean(axis=0).round(VELOCITY_DECIMALS) + 0.0
        masses.append(
            Mass(
                lower=tuple(low.tolist()),
                size=tuple((high - low).round(DECIMALS).tolist()),
                velocity=tuple(velocity.tolist()) if velocity.any() else None,
                material=None if materials[-1] == materials[0] else materials[-1],
            )
        )
    return materials[0], tuple(masses)
