"""What a scene must fulfil to be simulated, each key with what is expected of it."""

import math

import numpy as np

from datasets.errors import InputError
from datasets.field import check_fields
from datasets.geometry.solid import check_solid
from datasets.scene import DOMAIN_SIDES, TOLERANCE, Baffle, Mass, Scene, has_shapes, overlaps


def check(scene: Scene) -> None:
    """Raise InputError for a scene that cannot be simulated: each key with what was expected of it."""

    def require(ok: bool, key: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=key)

    domain, dimension = scene.domain, len(scene.domain.size)
    require(dimension in (2, 3), "domain.size", "2 or 3 lengths in m", list(domain.size))
    require(domain.cell > 0.0, "domain.cell", "a positive length in m", domain.cell)
    for length in domain.size:
        cells = length / domain.cell
        require(
            length > 0.0 and abs(cells - round(cells)) < 1e-6 * max(cells, 1.0),
            "domain.size",
            f"a positive whole number of cells of {domain.cell:g} m",
            list(domain.size),
        )
    require(scene.frame_dt > 0.0, "frame_dt", "a positive time in s", scene.frame_dt)
    frames = scene.duration / scene.frame_dt
    require(
        scene.duration > 0.0 and abs(frames - round(frames)) < 1e-6 * max(frames, 1.0),
        "duration",
        f"a positive whole number of frames of {scene.frame_dt:g} s",
        scene.duration,
    )
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
    require(scene.particles_per_axis >= 1, "particles_per_axis", "an integer of at least 1", scene.particles_per_axis)
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
            friction is None or friction >= 0.0, f"baffles[{index}].friction", "a coefficient of at least 0", friction
        )
    for index, solid in enumerate(scene.solids):
        check_solid(solid, f"solids[{index}]", dimension)
    for index, mass in enumerate(scene.masses):
        if mass.velocity is not None:
            require(
                len(mass.velocity) == dimension and all(map(math.isfinite, mass.velocity)),
                f"masses[{index}].velocity",
                f"{dimension} finite components in m/s",
                list(mass.velocity),
            )
        if mass.angular_velocity is not None:
            turn = mass.angular_velocity
            parts = turn if isinstance(turn, tuple) else (turn,)
            require(
                len(parts) in {2: (1,), 3: (1, 3)}[dimension] and all(map(math.isfinite, parts)),
                f"masses[{index}].angular_velocity",
                "a finite number in rad/s, in 3D that or 3 components",
                list(parts),
            )
        check_start(scene, mass, f"masses[{index}]")
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
        require(mass.k0 >= 0.0, "k0", "a ratio of at least 0", mass.k0)
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
