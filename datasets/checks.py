"""What a scene must fulfil to be simulated, each key with what is expected of it."""

import math

import numpy as np

from datasets.errors import InputError
from datasets.field import check_fields
from datasets.geometry.solid import FARTHEST, check_solid, usual
from datasets.particles import lattice_counts
from datasets.scene import DOMAIN_SIDES, TOLERANCE, Baffle, Mass, Scene, has_shapes, overlaps

MOST_CELLS = 2**31 - 1
"""Of the box: what 32 bits count."""
MOST_PARTICLES = 2**30
MOST_FRAMES = 10_000_000
MOST_PER_AXIS = 1000
MOST_BODIES = 4096
"""Masses, baffles and solids: each pair of them is compared."""


def check_sizes(scene: Scene) -> None:
    """Raise InputError where the box, the times or the number of anything are beyond what can be counted.

    First of all, because shapes are filled with particles before the rest is checked.
    """

    def require(ok: bool, key: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=key)

    domain = scene.domain
    require(len(domain.size) in (2, 3), "domain.size", "2 or 3 lengths in m", list(domain.size))
    require(0.0 < domain.cell <= FARTHEST, "domain.cell", f"a positive length in m, up to {FARTHEST:g}", domain.cell)
    cells = [length / domain.cell for length in domain.size]
    for length, count in zip(domain.size, cells, strict=True):
        require(
            0.0 < length <= FARTHEST and count < MOST_CELLS and whole(count),
            "domain.size",
            f"a positive whole number of cells of {domain.cell:g} m, up to {FARTHEST:g} m",
            list(domain.size),
        )
    few = math.prod(cells) <= MOST_CELLS
    require(few, "domain.cell", f"a box of at most {MOST_CELLS} cells, so larger ones", f"{math.prod(cells):.3g}")
    for key in ("frame_dt", "duration"):
        time = getattr(scene, key)
        require(0.0 < time <= FARTHEST, key, f"a positive time in s, up to {FARTHEST:g}", time)
    frames = scene.duration / scene.frame_dt
    few = frames <= MOST_FRAMES
    require(few, "frame_dt", f"at most {MOST_FRAMES} frames, so more time between them", f"{frames:.3g}")
    expected = f"a positive whole number of frames of {scene.frame_dt:g} s"
    require(whole(frames), "duration", expected, scene.duration)
    most = f"an integer from 1 to {MOST_PER_AXIS}"
    require(1 <= scene.particles_per_axis <= MOST_PER_AXIS, "particles_per_axis", most, scene.particles_per_axis)
    count = len(scene.masses) + len(scene.baffles) + len(scene.solids)
    require(count <= MOST_BODIES, "masses", f"at most {MOST_BODIES} masses, baffles and solids", count)


def whole(count: float) -> bool:
    """Whether a number is a whole one of at least 1, but for rounding."""
    return round(count) >= 1 and abs(count - round(count)) < 1e-6 * count


def check_particles(scene: Scene) -> None:
    """Raise InputError for boxes of more particles than can be counted; other shapes say so when they are filled."""
    counts = [math.prod(lattice_counts(scene, mass)) for mass in scene.masses if mass.kind == "box"]
    if sum(counts) > MOST_PARTICLES:
        raise InputError(
            f"expected at most {MOST_PARTICLES} particles, got {sum(counts):.3g}: larger cells are fewer",
            key="masses",
        )


def check(scene: Scene) -> None:
    """Raise InputError for a scene that cannot be simulated: each key with what was expected of it."""

    def require(ok: bool, key: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=key)

    domain, dimension = scene.domain, len(scene.domain.size)
    for key in ("gravity", "floor_friction", "wall_friction", "baffle_friction", "relaxation_time"):
        require((getattr(scene, key) or 0.0) <= FARTHEST, key, f"a number up to {FARTHEST:g}", getattr(scene, key))
    require(scene.gravity >= 0.0, "gravity", "an acceleration of at least 0 m/s^2", scene.gravity)
    require(-90.0 < scene.slope_deg < 90.0, "slope_deg", "an angle in (-90, 90) degrees", scene.slope_deg)
    require(scene.floor_friction >= 0.0, "floor_friction", "a coefficient of at least 0", scene.floor_friction)
    require(scene.wall_friction >= 0.0, "wall_friction", "a coefficient of at least 0", scene.wall_friction)
    require(scene.baffle_friction >= 0.0, "baffle_friction", "a coefficient of at least 0", scene.baffle_friction)
    require(0.0 <= scene.damping < 1.0, "damping", "a fraction in [0, 1)", scene.damping)
    relaxation = scene.relaxation_time
    require(relaxation is None or relaxation >= 0.0, "relaxation_time", "a time of at least 0 s", relaxation)
    require(0.0 < scene.step_fraction <= 1.0, "step_fraction", "a fraction in (0, 1]", scene.step_fraction)
    require(0.0 <= scene.jitter <= 1.0, "jitter", "a fraction in [0, 1]", scene.jitter)
    require(scene.seed >= 0, "seed", "an integer of at least 0", scene.seed)
    require(len(scene.masses) > 0, "masses", "at least one mass", "none")
    groups: dict[str, tuple[Mass | Baffle, ...]] = {"masses": scene.masses, "baffles": scene.baffles}
    for kind, boxes in groups.items():
        for index, box in enumerate(boxes):
            key = f"{kind}[{index}]"
            for name in ("lower", "size"):
                if getattr(box, name) == ():
                    raise InputError("expected a value, the key is missing", key=f"{key}.{name}")
            require(len(box.lower) == dimension, f"{key}.lower", f"{dimension} lengths in m", list(box.lower))
            require(len(box.size) == dimension, f"{key}.size", f"{dimension} lengths in m", list(box.size))
            require(min(box.size) > 0.0, f"{key}.size", "positive lengths in m", list(box.size))
            require(all(map(usual, box.lower)), f"{key}.lower", f"lengths within {FARTHEST:g} m", list(box.lower))
            inside = all(
                low >= -TOLERANCE and low + size <= limit + TOLERANCE
                for low, size, limit in zip(box.lower, box.size, domain.size, strict=True)
            )
            require(
                inside, key, f"a box inside the domain {list(domain.size)}", f"{list(box.lower)} + {list(box.size)}"
            )
    open_sides = DOMAIN_SIDES[: 2 * dimension]
    for index, side in enumerate(scene.open_sides):
        require(side in open_sides, f"open_sides[{index}]", f"one of {', '.join(open_sides)}", repr(side))
        require(side not in scene.open_sides[:index], f"open_sides[{index}]", "each side once", repr(side))
    for index, baffle in enumerate(scene.baffles):
        friction = baffle.friction
        require(
            friction is None or 0.0 <= friction <= FARTHEST,
            f"baffles[{index}].friction",
            "a coefficient of at least 0",
            friction,
        )
    for index, solid in enumerate(scene.solids):
        check_solid(solid, f"solids[{index}]", dimension)
    for index, mass in enumerate(scene.masses):
        if mass.velocity is not None:
            require(
                len(mass.velocity) == dimension and all(map(usual, mass.velocity)),
                f"masses[{index}].velocity",
                f"{dimension} finite components in m/s",
                list(mass.velocity),
            )
        if mass.angular_velocity is not None:
            turn = mass.angular_velocity
            parts = turn if isinstance(turn, tuple) else (turn,)
            require(
                len(parts) in {2: (1,), 3: (1, 3)}[dimension] and all(map(usual, parts)),
                f"masses[{index}].angular_velocity",
                "a finite number in rad/s, in 3D that or 3 components",
                list(parts),
            )
        check_start(scene, mass, f"masses[{index}]")
    check_particles(scene)
    check_fields(scene)
    names = [f"{kind}[{index}]" for kind, group in groups.items() for index in range(len(group))]
    shared = overlaps((*scene.masses, *scene.baffles))
    shared[len(scene.masses) :, len(scene.masses) :] = False  # baffles may be built of more boxes than one
    upright = [mass.kind == "box" for mass in scene.masses] + [baffle.turned_deg == 0.0 for baffle in scene.baffles]
    shared &= np.outer(upright, upright)  # others are more than boxes
    if shared.any():
        first, second = np.argwhere(shared)[0]
        raise InputError(f"expected a box clear of {names[first]}, got an overlap", key=names[second])
    if has_shapes(scene):
        from datasets.geometry.overlaps import check_overlaps

        check_overlaps(scene)


def check_start(scene: Scene, mass: Mass, key: str) -> None:
    """Raise InputError for a mass that cannot begin as its `k0` and `release` ask."""

    def require(ok: bool, name: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=f"{key}.{name}")

    for name in ("k0", "release"):
        given = getattr(mass, name)
        require(given is None or mass.kind == "box", name, f"none of a {mass.kind}, which is no box", repr(given))
    if isinstance(mass.k0, str):
        require(mass.k0 == "elastic", "k0", "a ratio of stresses or 'elastic'", repr(mass.k0))
    elif mass.k0 is not None:
        require(0.0 <= mass.k0 <= FARTHEST, "k0", "a ratio of at least 0", mass.k0)
    if isinstance(mass.release, str):
        require(mass.release == "settled", "release", "a time in s or 'settled'", repr(mass.release))
    elif mass.release is not None:
        frames = mass.release / scene.frame_dt
        require(
            mass.release > 0.0 and abs(frames - round(frames)) < 1e-6 * max(frames, 1.0),
            "release",
            f"a positive whole number of frames of {scene.frame_dt:g} s",
            mass.release,
        )
        require(
            round(frames) < scene.frames - 1, "release", f"a time before the end at {scene.duration:g} s", mass.release
        )
    if mass.release is not None:
        require(
            not any(mass.velocity or ()), "velocity", "a mass at rest behind its barriers", list(mass.velocity or ())
        )
