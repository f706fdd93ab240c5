"""The lines that describe scenes and particles to the kernels: settings, material properties, and steps in a frame.

The elastic waves of the stiffest material or the speed of the flow set the time step:

    dt = min( f dx / c,  s dx / (c + v) ),    f: `step_fraction`,  s: `STABILITY`

with the wave speed c and the largest speed v of a particle at the start of a frame. The flow sets the step where it is
faster than (s / f - 1) c, by default 1.5 c: there a stiffer material shortens the step less than elsewhere.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.bodies import scene_height
from datasets.geometry.placement import heights_above_ground, remembers_gaps
from datasets.scene import NO_SLIP, TOLERANCE, Scene, coefficient
from datasets.scene.material import MOHR_COULOMB, Material
from datasets.scene.particles import Particles
from datasets.scene.water import pore_numbers, saturated, seepage
from mpm.arrays.features import drags_of, features_of
from mpm.arrays.layout import Property, Setting
from mpm.laws import law_named
from mpm.output.recording import REST_ENERGY

Array = NDArray[Any]

GAP_RATE = 4.0  # rate at which gaps follow the density, times sqrt(cell / g) [-] (`mpm.physics.volume_correction`)
LEAST_TENSION = 0.1  # tension limit over the weight of a cell up to which open material counts as loose [-]
IN_FLIGHT = 2.0e-8  # initial gap of a body in flight: twice the strain that counts as none [-]
GAP_CUTOFF = 1.7  # cells from a wall or a solid within which it hides mass from a particle
CONTACT_WIDTH = 1.0  # width h of the contact with solids [cells] (`mpm.physics.contact`)
STABILITY = 1.0  # largest (wave speed + particle speed) dt / dx: measured stable up to 1.1 in 2D and 1.2 in 3D
DRY_GRIP = 2.0  # Coulomb coefficient above which a surface's friction makes no difference to dry sand
ADHESION = 1.0  # increase of that coefficient by cohesion over the weight of a cell [-]


def roughest(scene: Scene) -> float:
    """Largest Coulomb coefficient [-] that surfaces of a scene have.

    Cohesionless sand bears a shear stress of at most tan(phi) times the pressure on any plane, and slides within itself
    beside a rougher surface. With a larger coefficient, the small pressure that rounding and jitter leave in sand
    falling beside a rough wall would hold the sand. Cohesion c needs no pressure: if it is large against the weight
    rho g dx of a cell, nothing slides along a rough surface."""
    materials = [scene.material_of(mass) for mass in scene.masses]
    steepest = max(max(math.radians(material.phi_deg), math.asin(material.sin_phi_limit)) for material in materials)
    grip = max(DRY_GRIP, math.tan(steepest))
    if not features_of([scene], "f32").cohesive:
        return grip
    weight = min(material.density for material in materials) * scene.gravity * scene.domain.cell
    if materials[0].law != MOHR_COULOMB or weight <= 0.0:
        return NO_SLIP
    deep = scene_height(scene)
    cohesions = [material.cohesion_at(deep) for material in materials]
    cohesions += [(stage.cohesion or 0.0) + (stage.strength_gradient or 0.0) * deep for stage in scene.stages]
    return min(NO_SLIP, grip + ADHESION * max(cohesions) / weight)


def search_distance(scene: Scene) -> float:
    """Distance [m] up to which a particle's distance from solids is computed: contact width, or cut-off of gaps."""
    return scene.domain.cell * (max(CONTACT_WIDTH, GAP_CUTOFF) if remembers_gaps(scene) else CONTACT_WIDTH)


def substeps_per_frame(scene: Scene, materials: Sequence[Material]) -> int:
    """Steps in a frame: the fewest whose dt is at most `step_fraction` * cell / (fastest wave speed)."""
    fastest = max(material.wave_speed for material in materials)
    return math.ceil(scene.frame_dt * fastest / (scene.step_fraction * scene.domain.cell))


def settings_row(scene: Scene, particles: Particles) -> list[float]:
    """One line of `settings`, in the order of `Setting`."""
    mass = float((particles.density * particles.volume).sum())
    weight = mass * scene.gravity
    pores = pore_numbers(scene)
    values = {
        Setting.CELL: scene.domain.cell,
        Setting.FRAME_DT: scene.frame_dt,
        Setting.GRAVITY_X: scene.gravity_vector[0],
        Setting.GRAVITY_Y: scene.gravity_vector[1],
        Setting.FLOOR_FRICTION: min(coefficient(scene.floor_friction), roughest(scene)),
        Setting.WALL_FRICTION: min(coefficient(scene.wall_friction), roughest(scene)),
        Setting.CONTACT_WIDTH: CONTACT_WIDTH * scene.domain.cell,
        Setting.SEARCH_DISTANCE: search_distance(scene),
        Setting.DAMPING: scene.damping,
        Setting.GRIP: scene.channel.grip if scene.channel else 0.0,
        Setting.CORRECTED: float(remembers_gaps(scene) or pores[0] > 0.0),
        Setting.GAP_RATE: GAP_RATE * math.sqrt(scene.gravity / scene.domain.cell),
        Setting.LEAST_TENSION: LEAST_TENSION * float(particles.density.min()) * scene.gravity * scene.domain.cell,
        Setting.SLOW_AFFINE: 2.0 * scene.gravity / scene.domain.cell,
        Setting.WAVE_SPEED: max(material.wave_speed for material in particles.materials),
        Setting.RELAXATION_RATE: 1.0 / scene.relaxation if scene.relaxation > 0.0 else math.inf,
        Setting.MASS: mass,
        Setting.WEIGHT: weight,
        Setting.REST_ENERGY: REST_ENERGY * weight * scene_height(scene),
        Setting.SEEPAGE: seepage(scene),
        Setting.DRAINED: float(scene.water is not None and scene.water.drained),
        **dict(zip((Setting.WATER_MODULUS, Setting.WATER_DIFFUSION, Setting.WATER_WAVE), pores, strict=True)),
    }
    return [values[column] for column in Setting]


def drag_tables(scenes: Sequence[Scene], real: np.dtype[Any]) -> tuple[Array, Array, Array]:
    """`drags_of` the solids of each scene [scenes, S]; the start of the posts of each solid whose xi varies, else 0, of
    the same shape; for these solids x and posts per length, z and posts per length, their numbers and 1 / xi."""
    drags = [drags_of(scene) for scene in scenes]
    table = np.zeros((len(scenes), max(1, *map(len, drags))), real)
    places, posts = np.zeros(table.shape, np.int32), [np.zeros(1)]
    for index, (scene, values) in enumerate(zip(scenes, drags, strict=True)):
        table[index, : len(values)] = values
        for number, solid in enumerate(scene.solids, len(scene.baffles)):
            if isinstance(solid.turbulence, tuple):
                per_xi, (x, z), steps = 1.0 / np.array(solid.turbulence), solid.origin or (), solid.spacing or ()
                places[index, number] = sum(map(len, posts))
                header = [x, 1.0 / steps[0], z, 1.0 / steps[1], *map(float, per_xi.shape)]
                posts += [np.array(header), per_xi.ravel()]
    return table, places, np.concatenate(posts).astype(real)


def in_precision(
    rows: Sequence[Sequence[float]] | Sequence[Array], columns: Sequence[IntEnum], real: np.dtype[Any]
) -> Array:
    """Lines of a table as the kernels take them. Raises InputError for a number that `real` cannot hold."""
    table = np.array(rows, np.float64)
    size, kind = np.abs(table), np.finfo(real)
    bad = np.argwhere(np.isfinite(table) & ((size > kind.max) | ((size > 0.0) & (size < kind.tiny))))
    if len(bad):
        line, column = bad[0]
        name = columns[column].name.lower().replace("_", " ")
        message = f"expected numbers of {kind.tiny:.0e} to {kind.max:.0e}, got a {name} of {table[line, column]:g}"
        raise InputError(f"{message}; --precision f64 holds more" if real == np.float32 else message)
    return table.astype(real)


def properties_row(material: Material, volume: float) -> Array:
    """One line of `properties`, at the top of a body; `volume` of a particle [m^D]."""
    return np.asarray(properties_at(material, np.zeros(1), volume=volume)[0])


def properties_of(particles: Particles) -> Array:
    """Lines of `properties`, one for each particle, shape [N, columns]."""
    law = law_named(particles.materials[0].law)
    rows = np.empty((len(particles.material), len(Property) + len(law.Column)))
    for index, material in enumerate(particles.materials):
        here = particles.material == index
        friction_deg = None if particles.friction_deg is None else particles.friction_deg[here]
        rows[here] = properties_at(material, particles.depth[here], friction_deg)
    rows[:, Property.VOLUME] = particles.volume
    return rows


def properties_at(material: Material, depth: Array, friction_deg: Array | None = None, *, volume: float = 1.0) -> Array:
    """Lines of `properties` of particles `depth` [m] below the top of their body, shape [N]; [N, columns].

    friction_deg: of each of them, shape [N], in place of the material's."""
    values = {
        Property.VOLUME: volume,
        Property.DENSITY: material.density,
        Property.LAME: material.lame,
        Property.SHEAR: material.shear_modulus,
        Property.ELASTIC_DEVIATOR: (1.0 + material.poisson) / (2.0 * material.modulus),
        Property.ELASTIC_TRACE: material.poisson / (2.0 * material.modulus),
    }
    common = np.tile([values[column] for column in Property], (len(depth), 1))
    return np.concatenate([common, law_named(material.law).properties(material, depth, friction_deg)], axis=1)


def initial_gaps(scene: Scene, particles: Particles) -> Array:
    """K e [Pa] of particles at the start, shape [N, 1]. A body in flight starts with a tiny gap, which then follows the
    grid: without it, the nodes of a floor would carry the body up to a cell above the floor."""
    gaps = np.zeros((len(particles.positions), 1))
    if remembers_gaps(scene) and particles.entry_time is None and not saturated(scene):
        values = properties_of(particles)
        bulk = values[:, Property.LAME] + 2.0 / 3.0 * values[:, Property.SHEAR]
        gaps[:, 0] = np.where(heights_above_ground(scene)[particles.mass] > TOLERANCE, IN_FLIGHT * bulk, 0.0)
    return gaps


def elastic_energy(particles: Particles, stress: Array) -> float:
    """Sum of V0 [(1 + nu) sigma : sigma - nu (tr sigma)^2] / (2 E) [J]; stress [Pa], shape [N, 4 or 6]."""
    rows = np.array([properties_row(material, 0.0) for material in particles.materials])[particles.material]
    square = (stress[:, :3] ** 2).sum(axis=1) + 2.0 * (stress[:, 3:] ** 2).sum(axis=1)
    trace = stress[:, :3].sum(axis=1)
    energy_density = rows[:, Property.ELASTIC_DEVIATOR] * square - rows[:, Property.ELASTIC_TRACE] * trace**2
    return float(particles.volume @ energy_density)
