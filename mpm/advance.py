"""Frames of MLS-MPM steps: the one kernel of the solver.

One scene runs on one thread from the first step of a launch to the last: no atomics, no barriers, and the result is the
same to the bit on any number of threads.
"""

import taichi as ti

from mpm.layout import Energy, Place, Property, Setting
from mpm.nodes import clear, update_nodes
from mpm.transfer import grid_to_points, points_to_grid

STABILITY = 1.0
"""Largest (wave speed + point speed) dt / dx. Measured clean up to 1.1 in 2D."""
RUNAWAY = 10.0
"""Point speed over wave speed at which a run has blown up."""
TURNS = 512
"""Taichi hands a thread no fewer turns of a loop than these."""

Array = ti.types.ndarray()
Flat = ti.types.ndarray(ndim=1)


@ti.kernel
def advance(
    x: Flat,
    v: Flat,
    c: Flat,
    sigma: Flat,
    material: Flat,
    grid: Flat,
    settings: Array,
    properties: Array,
    places: Array,
    record: Flat,
    energy: Array,
    first_frame: ti.i32,
    last_frame: ti.i32,
    damped: ti.template(),
    dilates: ti.template(),
    several: ti.template(),
):
    """Advance every scene from `first_frame` to `last_frame` and record its positions and energies.

    `x`, `v` [2 N], `c` [4 N] (rows of C), `sigma` [4 N] (xx, yy, xy, zz), `material` [N], `grid`: all scenes in a row.
    `damped`, `dilates`, `several` (materials in one scene) are compiled in only where a scene of the batch needs them.
    """
    ti.loop_config(block_dim=TURNS)
    for turn in range(places.shape[0] * TURNS):
        if turn % TURNS != 0:
            continue
        scene = turn // TURNS
        for frame in range(first_frame, ti.min(last_frame, places[scene, Place.FRAMES])):
            substeps = steps_of_frame(scene, v, settings, places)
            if substeps == 0:
                places[scene, Place.FRAMES] = frame
                break
            places[scene, Place.STEPS] = places[scene, Place.STEPS] + substeps
            dt = settings[scene, Setting.FRAME_DT] / substeps
            for _ in range(substeps):
                clear(scene, grid, places, damped)
                points_to_grid(scene, dt, x, v, c, sigma, material, grid, settings, properties, places, damped, several)
                update_nodes(scene, dt, grid, settings, places, damped)
                grid_to_points(
                    scene, dt, x, v, c, sigma, material, grid, settings, properties, places, damped, dilates, several
                )
            note(scene, frame, x, v, c, sigma, material, settings, properties, places, record, energy, several)


@ti.func
def steps_of_frame(scene, v: ti.template(), settings: ti.template(), places: ti.template()):
    """The scene's usual number of steps, more where points move so fast that a step would leave the stable range.

    0 where a point outruns the elastic wave many times over: that is no longer physics, and the scene ends.
    """
    first = places[scene, Place.POINT]
    fastest = 0.0
    for p in range(first, first + places[scene, Place.POINTS]):
        square = v[2 * p] * v[2 * p] + v[2 * p + 1] * v[2 * p + 1]
        if ti.math.isnan(square):
            square = ti.math.inf
        fastest = ti.max(fastest, square)
    wave_speed = settings[scene, Setting.WAVE_SPEED]
    steps = 0
    if fastest <= (RUNAWAY * wave_speed) ** 2:
        crossings = settings[scene, Setting.FRAME_DT] * (wave_speed + ti.sqrt(fastest)) / settings[scene, Setting.CELL]
        steps = ti.max(places[scene, Place.SUBSTEPS], ti.cast(ti.ceil(crossings / STABILITY), ti.i32))
    return steps


@ti.func
def note(
    scene,
    frame,
    x: ti.template(),
    v: ti.template(),
    c: ti.template(),
    sigma: ti.template(),
    material: ti.template(),
    settings: ti.template(),
    properties: ti.template(),
    places: ti.template(),
    record: ti.template(),
    energy: ti.template(),
    several: ti.template(),
):
    """Record positions and energies of a frame.

    Kinetic energy is that of the points and of the affine motion around them, m C : C dx^2 / 8, which APIC carries too;
    elastic energy V0 [(1 + nu) sigma : sigma - nu (tr sigma)^2] / (2 E).
    """
    volume, dx = settings[scene, Setting.VOLUME], settings[scene, Setting.CELL]
    gravity_x, gravity_y = settings[scene, Setting.GRAVITY_X], settings[scene, Setting.GRAVITY_Y]
    first, count = places[scene, Place.POINT], places[scene, Place.POINTS]
    offset = places[scene, Place.RECORD] + 2 * frame * count
    kind = places[scene, Place.MATERIAL]
    kinetic, potential, elastic = 0.0, 0.0, 0.0
    for p in range(first, first + count):
        if ti.static(several):
            kind = material[p]
        mass = volume * properties[kind, Property.DENSITY]
        n = offset + 2 * (p - first)
        record[n], record[n + 1] = x[2 * p], x[2 * p + 1]
        vv = v[2 * p] * v[2 * p] + v[2 * p + 1] * v[2 * p + 1]
        cc = 0.0
        for k in ti.static(range(4)):
            cc += c[4 * p + k] * c[4 * p + k]
        kinetic += 0.5 * mass * (vv + 0.25 * dx * dx * cc)
        potential -= mass * (gravity_x * x[2 * p] + gravity_y * x[2 * p + 1])
        sxx, syy, sxy, szz = sigma[4 * p], sigma[4 * p + 1], sigma[4 * p + 2], sigma[4 * p + 3]
        square = sxx * sxx + syy * syy + szz * szz + 2.0 * sxy * sxy
        trace = sxx + syy + szz
        deviator, spherical = properties[kind, Property.ELASTIC_DEVIATOR], properties[kind, Property.ELASTIC_TRACE]
        elastic += volume * (deviator * square - spherical * trace * trace)
    line = frame + places[scene, Place.ENERGY]
    energy[line, Energy.KINETIC] = kinetic
    energy[line, Energy.POTENTIAL] = potential
    energy[line, Energy.ELASTIC] = elastic
