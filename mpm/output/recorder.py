"""The records of a scene at the end of a frame; the steps of the next frame; detection of rest."""

import taichi as ti

from mpm.arrays.access import add, dot, lane_sum, maximum, over_lanes, vectors
from mpm.arrays.layout import Energy, Offset, Property, Setting, Worker
from mpm.arrays.properties import STABILITY
from mpm.output.recording import BALANCED, PRESENT, REST
from mpm.physics.barriers import free_since, measure_retained, open_barriers
from mpm.physics.inflow import next_speeds, wait_frame
from mpm.physics.transfer import particles_in, property_of

RUNAWAY = 10.0  # particle speed over wave speed at which a run has blown up


@ti.func
def last_block(scene, arrays: ti.template()):
    """One past the last block of a scene."""
    lanes = arrays.features.lanes
    return arrays.offsets[scene, Offset.BLOCK] + (arrays.offsets[scene, Offset.PARTICLES] + lanes - 1) // lanes


@ti.func
def steps_of_frame(scene, arrays: ti.template()):
    """The scene's usual number of steps; more if particles are so fast that a step would be unstable.

    0 if a particle is many times faster than the elastic wave: that is unphysical, and the scene ends.
    """
    fastest = 0.0 * arrays.state[arrays.offsets[scene, Offset.BLOCK] * arrays.features.state.size]
    for block in range(arrays.offsets[scene, Offset.BLOCK], last_block(scene, arrays)):
        fastest = maximum(fastest, squared_speed(block, arrays))
    return steps_at_speed(scene, ti.sqrt(over_lanes(maximum, fastest, arrays.features.lanes)), arrays)


@ti.func
def squared_speed(block, arrays: ti.template()):
    """|v|^2 [m^2/s^2] of each lane; a huge number in place of NaN, with which comparisons are false."""
    first = block * arrays.features.state.size + arrays.features.state.velocity
    velocity = vectors(arrays.state, first, arrays.features.dimension)
    square = dot(velocity, velocity)
    return ti.select(square < 1.0e30, square, 1.0e30)


@ti.func
def steps_at_speed(scene, speed, arrays: ti.template()):
    """Steps of a frame whose fastest particle has `speed` [m/s]; 0 for a runaway."""
    wave_speed = arrays.settings[scene, Setting.WAVE_SPEED]
    steps = 0
    if speed <= RUNAWAY * wave_speed:
        frame_dt, cell = arrays.settings[scene, Setting.FRAME_DT], arrays.settings[scene, Setting.CELL]
        crossings = frame_dt * (wave_speed + speed) / cell
        steps = ti.max(arrays.offsets[scene, Offset.SUBSTEPS], ti.cast(ti.ceil(crossings / STABILITY), ti.i32))
    return steps


@ti.func
def record_frame(scene, frame, arrays: ti.template()):
    """Record a frame of a scene: its particles, its energies, the impulses of solids, and whether it rests."""
    sums = ti.Vector.zero(ti.f64, ti.static(len(Energy)))
    for block in range(arrays.offsets[scene, Offset.BLOCK], last_block(scene, arrays)):
        sums += record_block(scene, frame, block, arrays)
    add_energies(scene, frame, sums, arrays)
    record_scene(scene, frame, arrays)


@ti.func
def add_energies(scene, frame, sums, arrays: ti.template()):
    """Add the results of `record_block` for some blocks to the energies of a frame."""
    line = (frame + arrays.offsets[scene, Offset.ENERGY]) * ti.static(len(Energy))
    for kind in ti.static(range(len(Energy))):
        add(arrays.energy, line + kind, sums[kind], arrays)


@ti.func
def record_scene(scene, frame, arrays: ti.template()):
    """Record the impulses of solids in a frame whose particles are recorded, and whether it was the last frame."""
    if ti.static(arrays.features.impulses):
        record_impulses(scene, frame, arrays)
    if ti.static(arrays.features.barriers):
        open_barriers(scene, frame, arrays)
    if ti.static(arrays.features.inflow):
        next_speeds(scene, frame, arrays)
    if ti.static(arrays.features.recorded.until_rest):
        detect_rest(scene, frame, arrays)


@ti.func
def record_block(scene, frame, block, arrays: ti.template()):
    """Energies of the particles of a block, in the order of `Energy`; records positions if every frame is kept.

    Kinetic energy includes the affine motion around the particles, m C : C dx^2 / 8, which APIC also carries; elastic
    energy is V0 [(1 + nu) sigma : sigma - nu (tr sigma)^2] / (2 E). If the scene may end at rest, also the unbalanced
    force over the weight, sum m |v - v of the frame before| / (dt_frame M g); if particles may leave or enter the box,
    also the share of M that is not in it.
    """
    features = arrays.features
    volume, dx = property_of(scene, block, Property.VOLUME, arrays), arrays.settings[scene, Setting.CELL]
    first = block * features.state.size
    present = arrays.state[first + features.state.present]
    mass = volume * property_of(scene, block, Property.DENSITY, arrays) * present
    if ti.static(features.barriers):
        measure_retained(scene, block, arrays)
    if ti.static(features.inflow):
        wait_frame(block, arrays)
    velocity = vectors(arrays.state, first + features.state.velocity, features.dimension)
    affine = vectors(arrays.state, first + features.state.affine, features.dimension**2)
    vv, cc, ss, trace = dot(velocity, velocity), dot(affine, affine), 0.0 * mass, 0.0 * mass
    for k in ti.static(range(features.stresses)):
        s = arrays.state[first + features.state.stress + k]
        ss = ss + ti.static(1.0 if k < 3 else 2.0) * s * s
        trace = trace + ti.static(1.0 if k < 3 else 0.0) * s
    along, down = arrays.settings[scene, Setting.GRAVITY_X], arrays.settings[scene, Setting.GRAVITY_Y]
    height = along * arrays.state[first] + down * arrays.state[first + 1]
    deviator = property_of(scene, block, Property.ELASTIC_DEVIATOR, arrays)
    spherical = property_of(scene, block, Property.ELASTIC_TRACE, arrays)
    sums = ti.Vector.zero(ti.f64, ti.static(len(Energy)))
    sums[Energy.KINETIC] = lane_sum(0.5 * mass * (vv + 0.25 * dx * dx * cc), arrays)
    sums[Energy.POTENTIAL] = lane_sum(0.0 - mass * height, arrays)
    elastic = volume * present * (deviator * ss - spherical * trace * trace)
    sums[Energy.ELASTIC] = lane_sum(elastic, arrays)
    if ti.static(features.outflow):
        absent = volume * property_of(scene, block, Property.DENSITY, arrays) * (1.0 - present)
        sums[Energy.ABSENT] = particle_sum(absent, scene, block, arrays) / arrays.settings[scene, Setting.MASS]
    if ti.static(features.recorded.until_rest):
        change = 0.0 * mass
        for k in ti.static(range(features.dimension)):
            new = arrays.state[first + features.state.velocity + k]
            apart = new - arrays.state[first + features.state.before + k]
            change = change + apart * apart
            arrays.state[first + features.state.before + k] = new
        impulse = ti.max(arrays.settings[scene, Setting.WEIGHT], 1.0e-30) * arrays.settings[scene, Setting.FRAME_DT]
        sums[Energy.UNBALANCED] = lane_sum(mass * ti.sqrt(change), arrays) / impulse
    at = arrays.offsets[scene, Offset.RECORD]
    if at >= 0:
        at += frame * arrays.offsets[scene, Offset.PARTICLES]
        for lane in range(particles_in(scene, block, arrays)):
            particle = at + arrays.order[block * features.lanes + lane]
            for k in ti.static(range(features.dimension)):
                arrays.positions[particle * features.dimension + k] = arrays.lanes[(first + k) * features.lanes + lane]
    return sums


@ti.func
def particle_sum(a, scene, block, arrays: ti.template()):
    """Sum over the lanes of a block that hold a particle, in double precision."""
    if ti.static(arrays.features.lanes == 1):
        return ti.cast(a, ti.f64)
    else:
        count, value = particles_in(scene, block, arrays), ti.cast(0.0, ti.f64)
        for lane in ti.static(range(arrays.features.lanes)):
            if lane < count:
                value += ti.cast(a[lane], ti.f64)
        return value


@ti.func
def record_impulses(scene, frame, arrays: ti.template()):
    """Record the momentum that each solid took in this frame, and reset it to zero."""
    features = arrays.features
    count = arrays.offsets[scene, Offset.SOLIDS]
    line = arrays.offsets[scene, Offset.IMPULSE] + frame * count
    per_scene = arrays.workers.shape[0] // arrays.offsets.shape[0]
    for worker in range(scene * per_scene, (scene + 1) * per_scene):
        for number in range(count):
            for k in ti.static(range(features.dimension)):
                at = arrays.workers[worker, Worker.IMPULSE] + number * features.dimension + k
                arrays.recorded_impulse[line + number, k] += lane_sum(arrays.impulse[at], arrays)
                arrays.impulse[at] = 0.0 * arrays.impulse[at]


@ti.func
def detect_rest(scene, frame, arrays: ti.template()):
    """Set the frame of rest if a deposit without barriers was at rest over a window (`mpm.output.recording`)."""
    line, window = arrays.offsets[scene, Offset.ENERGY], arrays.offsets[scene, Offset.WINDOW]
    since = 0
    if ti.static(arrays.features.barriers):
        since = free_since(scene, arrays)
    if ti.static(arrays.features.inflow):
        since = ti.max(since, arrays.offsets[scene, Offset.ENTERED])
    if frame - window >= since:
        peak = ti.cast(arrays.settings[scene, Setting.REST_ENERGY], ti.f64) / REST
        most, unbalanced = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        for earlier in range(since, frame + 1):
            at = (line + earlier) * ti.static(len(Energy))
            kinetic, force = arrays.energy[at + Energy.KINETIC], arrays.energy[at + Energy.UNBALANCED]
            if ti.static(arrays.features.outflow):
                share = ti.max(1.0 - arrays.energy[at + Energy.ABSENT], PRESENT)
                kinetic, force = kinetic / share, force / share
            peak = ti.max(peak, kinetic)
            if earlier > frame - window:
                most = ti.max(most, kinetic)
                unbalanced += force
        if most < REST * peak and unbalanced < BALANCED * window:
            arrays.offsets[scene, Offset.REST] = frame
