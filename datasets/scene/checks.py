"""Checks that the parts of a scene fit together and can be simulated; each names a key and the expected value."""

import dataclasses
import itertools
import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from datasets.errors import InputError, require
from datasets.geometry.shapes import check_grid, check_rows, check_shape, check_solid, check_vector, usual
from datasets.scene.grid_field import FRICTION, THICKNESS, VELOCITIES, Field
from datasets.scene.material import ANGLES, MOHR_COULOMB
from datasets.scene.parts import DOMAIN_SIDES, INFLOW, ROUGH, TOLERANCE, Baffle, Mass, SceneLayout, Water, keyed
from datasets.scene.water import consolidation, saturated, unlikely_water
from datasets.schema import FARTHEST

MOST_CELLS, MOST_COLUMNS = 2**31 - 1, 2**28  # of the box, within what 32 bits count
MOST_PARTICLES = 2**30
MOST_FRAMES = 10_000_000
MOST_BODIES = 4096  # masses, baffles and solids, each pair of which is compared
TALL, STEEPEST = 2.0, 10.0
"""Thickness of a layer over its length, and Coulomb coefficient, above which the unit looks wrong."""
ROUGHEST = 20.0  # turbulent coefficient [m/s^2] below which no published one lies (Voellmy's xi: 100 to 8000 m/s^2)
LOST = 1.0e-6  # share of a layer that rounding may put beyond a side of the box
SMALL_ANGLE = 3.0  # friction angle [deg] below that of any sand: probably in radians
SLACK = 1.0e-3  # relative tolerance for a limit that a user wrote in decimals
LIGHT, WATER = 30.0, 1000.0  # densities [kg/m^3]: below that of any soil or snow; of water
FASTEST, DAY, YEAR = 10.0, 86400.0, 365.25 * 86400.0
"""Coefficient of consolidation [m^2/s] above that of any soil; seconds of a day and of a year."""
WEAKEST = 5.0e-4  # cohesion over the pressure rho g h under a body below which it looks like one in kPa
SOFTEST = 10.0
"""Young's modulus over the pressure rho g h under a body, below which the body settles by 5 % of its height or more."""


def checked(scene: SceneLayout) -> SceneLayout:
    """The scene, checked, with the boxes around its masses. Raises InputError if the parts do not fit together."""
    check_sizes(scene)  # first of all, because shapes are filled with particles before the rest is checked
    for key, solid in keyed(scene, "solids").items():
        check_solid(solid, key, scene.dimension)
        placed = solid.corner is None or scene.domain.origin is None
        require(placed, f"{key}.corner", "none beside domain.origin, which says where the box lies", "one")
    if any(mass.kind != "box" for mass in scene.masses):
        # The libraries of solid geometry load only where there is more than boxes.
        from datasets.geometry.bodies import with_boxes

        scene = SceneLayout(**vars(scene) | {"masses": with_boxes(scene)})
    check(scene)
    return scene


def check_sizes(scene: SceneLayout) -> None:
    """Raise InputError if the box, the times or a number of parts exceed what can be counted."""
    domain = scene.domain
    cells = [length / domain.cell for length in domain.size]
    fits = all(0.0 < length <= FARTHEST for length in domain.size) and all(map(whole, cells))
    expected = f"a positive whole number of cells of {domain.cell:g} m, up to {FARTHEST:g} m"
    require(fits, "domain.size", expected, list(domain.size))
    plan = math.prod(cells[::2])
    expected = f"a box of at most {MOST_COLUMNS} cells seen from above, so larger ones"
    require(plan <= MOST_COLUMNS, "domain.cell", expected, f"{plan:.3g}")
    frames = scene.duration / scene.frame_dt
    few = frames <= MOST_FRAMES
    require(few, "frame_dt", f"at most {MOST_FRAMES} frames, so more time between them", f"{frames:.3g}")
    require(whole(frames), "duration", f"a positive whole number of frames of {scene.frame_dt:g} s", scene.duration)
    count = len(scene.masses) + len(scene.baffles) + len(scene.solids)
    require(count <= MOST_BODIES, "masses", f"at most {MOST_BODIES} masses, baffles and solids", count)


def whole(count: float) -> bool:
    """Whether a number is an integer of at least 1, within rounding."""
    return 0.5 <= count < MOST_CELLS and abs(count - round(count)) < 1e-6 * count


def check(scene: SceneLayout) -> None:
    """Raise InputError, which names the key and the expected value, for a scene that cannot be simulated."""
    domain, dimension = scene.domain, scene.dimension
    require(len(scene.masses) > 0, "masses", "at least one mass", "none")
    for key, box in keyed(scene, "masses", "baffles").items():
        for name in ("lower", "size"):
            require(getattr(box, name) != (), f"{key}.{name}", "a value, the key is missing")
            check_vector(getattr(box, name), f"{key}.{name}", dimension)
        extents = zip(box.lower, box.size, domain.size, strict=True)
        inside = all(low >= -TOLERANCE and low + size <= limit + TOLERANCE for low, size, limit in extents)
        require(inside, key, f"a box inside the domain {list(domain.size)}", f"{list(box.lower)} + {list(box.size)}")
    for key, solid in keyed(scene, "baffles", "solids").items():
        sticks = scene.friction_of(solid) == ROUGH if isinstance(solid, Baffle) else solid.contact != "coulomb"
        slides = solid.turbulence is None or not sticks
        require(slides, f"{key}.turbulence", "none of a surface on which nothing slides", solid.turbulence)
    if scene.channel is not None:
        require(dimension == 2, "channel", "none in 3D, where the box or solids are the walls", "one")
    sides = DOMAIN_SIDES[: 2 * dimension]
    for index, side in enumerate(scene.open_sides):
        require(side in sides, f"open_sides[{index}]", f"one of {', '.join(sides)}", repr(side))
        require(side not in scene.open_sides[:index], f"open_sides[{index}]", "each side once", repr(side))
    for key, mass in keyed(scene, "masses").items():
        if mass.kind == "box":  # other shapes are checked when they are filled
            check_shape(mass, key, dimension)
        check_start(scene, mass, key)
    # The particles of other shapes are counted when they are filled.
    sizes = [[length / scene.particle_spacing for length in mass.size] for mass in scene.masses if mass.kind == "box"]
    count = sum(math.prod(max(1, round(length)) for length in size) for size in sizes)
    require(count <= MOST_PARTICLES, "masses", f"at most {MOST_PARTICLES} particles, so larger cells", f"{count:.3g}")
    check_fields(scene)
    check_k0(scene)
    check_water(scene)
    check_stages(scene)
    from datasets.geometry.placement import check_overlaps

    check_overlaps(scene)


def check_start(scene: SceneLayout, mass: Mass, key: str) -> None:
    """Raise InputError for a mass whose velocities, `k0` and `release` are not compatible with it or each other."""
    dimension, velocity, turn = scene.dimension, mass.velocity, mass.angular_velocity
    k0, release = mass.k0, mass.release
    for name in ("velocity", "angular_velocity", "k0") if mass.kind == INFLOW else ():
        expected = "none of an inflow, which enters at the speed of its hydrograph and free of stress"
        require(getattr(mass, name) is None, f"{key}.{name}", expected, "one")
    if velocity is not None:
        ok = len(velocity) == dimension and all(map(usual, velocity))
        require(ok, f"{key}.velocity", f"{dimension} finite components in m/s", list(velocity))
    if turn is not None:
        parts = turn if isinstance(turn, tuple) else (turn,)
        ok = len(parts) in {2: (1,), 3: (1, 3)}[dimension] and all(map(usual, parts))
        require(ok, f"{key}.angular_velocity", "a finite number in rad/s, in 3D that or 3 components", list(parts))
    box = release is None or mass.kind == "box"
    require(box, f"{key}.release", f"none of a {mass.kind}, which is no box", repr(release))
    flat = mass.kind in ("box", "layer") or k0 is None or isinstance(k0, str)
    require(flat, f"{key}.k0", f"'elastic' of a {mass.kind}, no box and no layer", k0)
    held = release is not None or mass.gate is None
    require(held, f"{key}.gate", "a release at which the gate begins to rise", "none")
    if release is not None:
        check_time(scene, release, f"{key}.release")
        require(not any(velocity or ()), f"{key}.velocity", "a mass at rest behind its barriers", list(velocity or ()))


def check_k0(scene: SceneLayout) -> None:
    """Raise InputError for a ratio of stresses beyond active or passive yield (Rankine 1857), with cohesion Bell's:

        K_a - 2 (c / sigma_v) sqrt(K_a) <= K0 <= K_p + 2 (c / sigma_v) sqrt(K_p),    K_a = 1 / K_p = tan^2(45 - phi / 2)

    with sigma_v at the base and at the top of the mass, including the masses stacked on it; the smaller c / sigma_v
    decides. If friction varies, phi is the smallest of the mass. For other laws, the MPM warns if no stress within
    yield has that ratio.
    """
    from datasets.geometry.bodies import height

    for number, (key, mass) in enumerate(keyed(scene, "masses").items()):
        if mass.k0 is None or isinstance(mass.k0, str) or scene.gravity <= 0.0:
            continue
        material = scene.material_of(mass)
        if material.law != MOHR_COULOMB:
            continue
        varying = (field for field in scene.fields if field.quantity == FRICTION and field.mass in (None, number))
        angles = [min(field.values) for field in varying]
        angle = material.phi_deg_of(min(angles), material.dilation_deg) if angles else material.phi_deg
        active = math.tan(math.radians(45.0 - 0.5 * angle)) ** 2
        tall = height(scene, mass)
        load, down = resting_load(scene, mass), -scene.gravity_vector[1]
        pressures = [load, load + material.density * down * tall]
        ratios = [material.cohesion_at(z) / max(p, 1.0e-9) for z, p in zip((0.0, tall), pressures, strict=True)]
        low = max(0.0, active - 2.0 * min(ratios) * math.sqrt(active))
        high = 1.0 / active + 2.0 * min(ratios) / math.sqrt(active)
        inside = low * (1.0 - SLACK) <= mass.k0 <= high * (1.0 + SLACK)
        require(inside, f"{key}.k0", f"a ratio within active and passive yield, {low:.3g} to {high:.3g}", mass.k0)


def check_water(scene: SceneLayout) -> None:
    """Raise InputError for water without a saturated material, and for what the water solver does not support."""
    water = scene.water or Water()
    if saturated(scene) is None:
        require(scene.water is None, "water", "a saturated material beside it", "none")
    elif not water.fixed:
        enters = any(mass.kind == INFLOW for mass in scene.masses)
        require(not enters, "masses", "no inflow in a scene with saturated material", "one")
        keeps = scene.volume_correction is not False
        require(keeps, "volume_correction", "true or none beside saturated material", "false")
    require(water.level is None or water.table is None, "water.table", "none beside a level", "one")
    level = water.pool is None or scene.slope_deg == 0.0
    require(level, "water.pool", "none in a tilted box, in which standing water is not level", f"{water.pool} m")
    check_grid(water, water.table if scene.dimension == 3 else None, "water", "table", "a table in 3D")
    if water.table is not None and scene.dimension == 2:
        check_rows(water.table, "water.table", 2, least=2)
        rises = all(second[0] > first[0] for first, second in itertools.pairwise(water.table))
        require(rises, "water.table", "points from small to large x", "others")
        check_reach("water.table", water.table[0][:1], water.table[-1][:1], scene)
    elif water.table is not None:
        last = np.multiply(water.spacing or (), np.array(np.shape(water.table)) - 1) + (water.origin or ())
        check_reach("water.origin", water.origin or (), last, scene)
    for key, mass in keyed(scene, "masses").items():
        if scene.material_of(mass).saturated:
            expected = "none that is saturated of an inflow, which enters without water"
            require(mass.kind != INFLOW, f"{key}.material", expected, "one")
            continue
        above = -math.inf if water.pool is None else water.pool - mass.lower[1]
        dry = f"none above the foot of {key}, which is not saturated"
        require(above <= TOLERANCE, "water.pool", dry, f"{above:.3g} m above it")
        ratio, place = mass.initial_pore_pressure_ratio, f"{key}.initial_pore_pressure_ratio"
        require(ratio is None, place, "none of a material that is not saturated", ratio)


def resting_load(scene: SceneLayout, mass: Mass) -> float:
    """Largest pressure [Pa] on the top of `mass` from the masses with a `k0` stacked on it."""
    load, top = 0.0, mass.lower[1] + mass.size[1]
    for above in sorted(scene.masses, key=lambda other: other.lower[1]):
        shared = all(
            above.lower[axis] < mass.lower[axis] + mass.size[axis] - TOLERANCE
            and mass.lower[axis] < above.lower[axis] + above.size[axis] - TOLERANCE
            for axis in range(0, scene.dimension, 2)
        )
        if above.k0 is not None and shared and abs(above.lower[1] - top) <= TOLERANCE:
            load -= scene.material_of(above).density * scene.gravity_vector[1] * above.size[1]
            top += above.size[1]
    return load


def check_time(scene: SceneLayout, time: float | str, key: str) -> None:
    """Raise InputError unless an event can happen at `time`: the end of a frame before the last, or "settled"."""
    if isinstance(time, str):
        return
    frames = time / scene.frame_dt
    require(whole(frames), key, f"a positive whole number of frames of {scene.frame_dt:g} s", time)
    require(round(frames) < scene.frames - 1, key, f"a time before the end at {scene.duration:g} s", time)


def check_stages(scene: SceneLayout) -> None:
    """Raise InputError for stages that are out of order, refer to no mass or place, or give an invalid material."""
    materials = {scene.material_of(mass) for mass in scene.masses}
    for index, (key, stage) in enumerate(keyed(scene, "stages").items()):
        dimension = scene.dimension
        check_time(scene, stage.time, f"{key}.time")
        before = scene.stages[index - 1].time if index else 0.0
        later = isinstance(stage.time, str) or (not isinstance(before, str) and stage.time > before)
        require(later, f"{key}.time", "times in ascending order, then 'settled'", f"{stage.time} after {before!r}")
        masses = range(len(scene.masses))
        require(stage.mass is None or stage.mass in masses, f"{key}.mass", f"one of 0 to {masses[-1]}", stage.mass)
        for name, other in (("lower", "size"), ("size", "lower")):
            vector = getattr(stage, name)
            paired = vector is not None or getattr(stage, other) is None
            require(paired, f"{key}.{name}", f"lower and size together, {other} is given", "none")
            if vector is not None:
                check_vector(vector, f"{key}.{name}", dimension)
        regions: dict[str, Any] = {}
        if stage.lower is not None and stage.size is not None:
            regions["lower"] = zip(stage.lower, np.add(stage.lower, stage.size), scene.domain.size, strict=True)
        if stage.outline is not None:
            check_rows(stage.outline, f"{key}.outline", dimension - 1, least=dimension)
            corners = np.min(stage.outline, axis=0), np.max(stage.outline, axis=0)
            regions["outline"] = zip(*corners, scene.domain.size[::2], strict=True)
        for name, spans in regions.items():
            inside = all(low <= length and high >= 0.0 for low, high, length in spans)
            expected = f"a region inside the domain {list(scene.domain.size)}, in part at least"
            require(inside, f"{key}.{name}", expected, list(getattr(stage, name)))
        require(bool(stage.values), key, "a constant of the material that changes", "none")
        try:
            values: dict[str, Any] = dict(stage.values)
            materials |= {dataclasses.replace(material, **values) for material in materials}
        except InputError as error:
            name = error.key.removeprefix("material.")
            if name in stage.values:
                raise InputError(error.message, key=f"{key}.{name}") from None
            raise InputError(f"{name} of the material beside it: {error.message}", key=key) from None


def check_fields(scene: SceneLayout) -> None:
    """Raise InputError for fields that the particles of `scene` cannot have."""
    kinds = (FRICTION, THICKNESS, *VELOCITIES[: scene.dimension])
    for index, (key, field) in enumerate(keyed(scene, "fields").items()):
        require(field.quantity in kinds, f"{key}.quantity", f"one of {', '.join(kinds)}", repr(field.quantity))
        dimension = scene.dimension - (field.quantity == THICKNESS)
        check_vector(field.origin, f"{key}.origin", dimension)
        check_vector(field.spacing, f"{key}.spacing", dimension)
        require(len(field.nodes) == dimension, f"{key}.nodes", f"{dimension} numbers", len(field.nodes))
        count = field.count
        require(len(field.values) == count, f"{key}.values", f"{count} numbers, one for each node", len(field.values))
        require(all(map(usual, field.values)), f"{key}.values", "finite numbers", "others")
        check_reach(f"{key}.origin", field.origin, field.positions[-1], scene)
        masses = range(len(scene.masses))
        require(field.mass is None or field.mass in masses, f"{key}.mass", f"one of 0 to {masses[-1]}", field.mass)
        entering = [n for n in masses if scene.masses[n].kind == INFLOW and field.mass in (None, n)]
        still = field.quantity in (FRICTION, THICKNESS) or not entering
        require(still, f"{key}.mass", "a mass of another kind: an inflow has the velocity of its hydrograph", entering)
        others = [other for other in scene.fields[:index] if other.quantity == field.quantity]
        alone = all(other.mass is not None and field.mass is not None and other.mass != field.mass for other in others)
        require(alone, key, f"one field of {field.quantity} for each mass", "another one")
        if field.quantity == THICKNESS:
            check_thickness(scene, field, key)
        if field.quantity != FRICTION:
            continue
        lowest, highest = min(field.values), max(field.values)
        require(lowest > 0.0 and highest < 90.0, f"{key}.values", "angles in (0, 90) degrees", (lowest, highest))
        for number in masses if field.mass is None else (field.mass,):
            material = scene.material_of(scene.masses[number])
            steepest = ANGLES[material.angle]
            expected = f"angles below {steepest:g} degrees where the angle is {material.angle!r}"
            require(highest < steepest, f"{key}.values", expected, highest)
            smallest = max(material.dilation_deg, material.residual_friction_deg or 0.0)
            message = f"angles of at least {smallest:g} degrees, dilation and residual friction of masses[{number}]"
            require(lowest >= smallest, f"{key}.values", message, lowest)


def check_reach(key: str, first: Sequence[float], last: Any, scene: SceneLayout) -> None:
    """Raise InputError for values from `first` to `last` [m], along all axes or in plan, that lie beside the box: they
    are constant beyond their ends, so that one of them would count everywhere."""
    size = scene.domain.size if len(first) == scene.dimension else scene.domain.size[::2]
    for start, end, length in zip(first, last, size, strict=True):
        got = f"{start:.10g} to {end:.10g} m"
        require(start <= length and end >= 0.0, key, f"places that reach into the box, 0 to {length:g} m", got)


def check_thickness(scene: SceneLayout, field: Field, key: str) -> None:
    """Raise InputError for a field of thickness without a layer in `scene`, or whose layer leaves the box."""
    from datasets.geometry.bodies import filling

    require(min(field.values) > 0.0, f"{key}.values", "thicknesses above 0 m", min(field.values))
    for number in range(len(scene.masses)) if field.mass is None else (field.mass,):
        mass = scene.masses[number]
        require(mass.kind == "layer", f"{key}.mass", "a mass of kind layer", f"masses[{number}], a {mass.kind}")
        lattice = filling(scene, mass).lattice.copy()
        lattice[:, 1] = field.at(lattice)
        top, highest = float(filling(scene, mass).raised(lattice)[:, 1].max()), scene.domain.size[1]
        require(top <= highest, f"{key}.values", f"a layer below the top of the box at {highest:g} m", f"{top:g}")


def warn_if_unlikely(scene: SceneLayout) -> None:
    """Warn (UserWarning) of numbers in a probably wrong unit (radians, MPa, mm), and of layers that the box cuts."""
    from datasets.geometry.bodies import Plan, height
    from datasets.geometry.ground import TOUCHING, lowest_ground

    for key, mass in keyed(scene, "masses").items():
        lost = Plan(mass, scene.domain, key).lost if mass.kind == "layer" else 0.0
        if lost > LOST:
            beyond = f"{lost:.2g} of the layer lies beyond the sides of the box and is left out"
            warnings.warn(f"{key}: {beyond}", stacklevel=3)
        thick, long = float(np.max(mass.thickness or 0.0)), max(mass.size[::2])
        if mass.kind == "layer" and thick > TALL * long:
            said = f"{thick:g} m is {thick / long:.2g} times the length of the layer"
            warnings.warn(f"{key}.thickness: {said}; in cm it would be {thick / 100:g} m", stacklevel=3)
    for line in unlikely_water(scene):
        warnings.warn(line, stacklevel=3)
    terrains = [(key, solid) for key, solid in keyed(scene, "solids").items() if solid.kind == "terrain"]
    for key, solid in terrains if len(terrains) == 1 else ():  # with several terrains the highest is the ground
        lowest = lowest_ground(scene.domain, solid, key)
        if lowest < -TOUCHING:
            said = f"falls {-lowest:.3g} m below the floor of the box, which is the ground there"
            warnings.warn(f"{key}: the terrain {said}, of floor_friction = {scene.floor_friction}", stacklevel=3)
    surfaces = {key: surface.friction for key, surface in keyed(scene, "baffles", "solids").items()}
    surfaces |= {name: getattr(scene, name) for name in ("floor_friction", "wall_friction", "baffle_friction")}
    for key, friction in surfaces.items():
        # Only the first row of a raster, which may have millions of values.
        first = friction[0] if isinstance(friction, tuple) else friction
        steep = 0.0 if first is None or isinstance(first, str) else float(np.max(first))
        if STEEPEST < steep < 90.0:
            angle = f"of an angle of {steep:g} degrees it is {math.tan(math.radians(steep)):.3g}"
            warnings.warn(f"{key}: a friction of {steep:g} is a Coulomb coefficient; {angle}", stacklevel=3)
    for key, solid in keyed(scene, "solids").items():
        brakes = solid.turbulence[0] if isinstance(solid.turbulence, tuple) else solid.turbulence
        if brakes is not None and (least := float(np.min(brakes))) < ROUGHEST:
            usual = "of snow and debris it is between 100 and 8000 m/s^2, and less brakes more"
            warnings.warn(f"{key}: a turbulence of {least:g} m/s^2 stops nearly any flow; {usual}", stacklevel=3)
    of_masses = {f"{key}.material": mass.material for key, mass in keyed(scene, "masses").items() if mass.material}
    for key, material in {"material": scene.material, **of_masses}.items():
        lines = []
        if 0.0 < material.friction_deg < SMALL_ANGLE:
            radians = math.degrees(material.friction_deg)
            hint = f"; in radians it would be {radians:.3g} degrees" if radians < 60.0 else ""
            lines.append(f"friction_deg = {material.friction_deg:g} degrees is less than any sand's{hint}")
        if material.density < LIGHT:
            unit, factor = ("g/cm^3", WATER) if material.density < 5.0 else ("kN/m^3", WATER / 9.81)
            light = f"density = {material.density:g} kg/m^3 is less than any soil's or snow's"
            lines.append(f"{light}; in {unit} it would be {factor * material.density:.4g} kg/m^3")
        elif material.saturated and material.density <= WATER:
            lines.append(f"density = {material.density:g} kg/m^3, of grains and water, is no more than water's")
        if material.saturated and consolidation(material, scene.gravity) > FASTEST:
            name, unit, other, times = "consolidation", "m^2/s", "m^2/year", YEAR
            if material.permeability is not None:
                name, unit, other, times = "permeability", "m/s", "m/day", DAY
            rate = getattr(material, name)
            said = f"{name} = {rate:g} {unit} drains faster than any soil"
            lines.append(f"{said}; in {other} it would be {rate / times:.2g} {unit}")
        if (grain := material.grain_diameter or 0.0) > scene.domain.cell:
            lines.append(f"grain_diameter = {grain:g} m is larger than a cell; in mm it would be {grain / 1e3:g} m")
        heights = [height(scene, mass) for mass in scene.masses if scene.material_of(mass) == material]
        weight = material.density * scene.gravity * max(heights, default=0.0)
        least = SOFTEST * weight
        if material.modulus < least:
            soft = f"young = {material.modulus:g} Pa is less than {SOFTEST:g} rho g h = {least:.3g} Pa"
            lines.append(f"{soft}: the body settles under its own weight by more than a twentieth of its height")
        if 0.0 < material.cohesion < WEAKEST * weight:
            weak = f"cohesion = {material.cohesion:g} Pa is negligible compared with rho g h = {weight:.3g} Pa"
            lines.append(f"{weak}; in kPa it would be {1e3 * material.cohesion:g} Pa")
        for line in lines:
            warnings.warn(f"{key}.{line}", stacklevel=3)
