"""What is recorded of a scene at the end of a frame, and what the next frame asks about: steps, rest."""

import taichi as ti

from mpm.lanes import add, larger, most, total
from mpm.layout import Energy, Field, Place, Property, Setting, Worker
from mpm.transfer import points_in, property_of

STABILITY = 1.0
"""Largest (wave speed + point speed) dt / dx. Measured clean up to 1.1 in 2D and 1.2 in 3D."""
RUNAWAY = 10.0
"""Point speed over wave speed at which a run has blown up."""
REST = 1.0e-3
"""Kinetic energy at which a deposit has come to rest, as a fraction of the largest so far."""


@ti.func
def last_block(scene, of: ti.template()):
    """One past the last block of a scene."""
    needs = of.needs
    return of.places[scene, Place.BLOCK] + (of.places[scene, Place.POINTS] + needs.lanes - 1) // needs.lanes


@ti.func
def steps_of_frame(scene, of: ti.template()):
    """The scene's usual number of steps, more where points move so fast that a step would leave the stable range.

    0 where a point outruns the elastic wave many times over: that is no longer physics, and the scene ends.
    """
    fastest = 0.0 * of.state[of.places[scene, Place.BLOCK] * of.needs.block]
    for block in range(of.places[scene, Place.BLOCK], last_block(scene, of)):
        fastest = larger(fastest, squared_speed(block, of))
    return steps_at_speed(scene, ti.sqrt(most(fastest, of)), of)


@ti.func
def squared_speed(block, of: ti.template()):
    """|v|^2 [m^2/s^2] of each lane, huge where it is not a number: a comparison with NaN is false."""
    v = block * of.needs.block + of.needs.velocity
    square = of.state[v] * of.state[v]
    for k in ti.static(range(1, of.needs.dimension)):
        square = square + of.state[v + k] * of.state[v + k]
    return ti.select(square < 1.0e30, square, 1.0e30)


@ti.func
def steps_at_speed(scene, speed, of: ti.template()):
    """Steps of a frame whose fastest point has `speed` [m/s]; 0 for a runaway."""
    wave_speed = of.settings[scene, Setting.WAVE_SPEED]
    steps = 0
    if speed <= RUNAWAY * wave_speed:
        crossings = of.settings[scene, Setting.FRAME_DT] * (wave_speed + speed) / of.settings[scene, Setting.CELL]
        steps = ti.max(of.places[scene, Place.SUBSTEPS], ti.cast(ti.ceil(crossings / STABILITY), ti.i32))
    return steps


@ti.func
def note(scene, frame, of: ti.template()):
    """Record a frame of a scene: what its points carry, its energies, what its solids have taken, whether it rests."""
    for block in range(of.places[scene, Place.BLOCK], last_block(scene, of)):
        note_block(scene, frame, block, of)
    note_scene(scene, frame, of)


@ti.func
def note_scene(scene, frame, of: ti.template()):
    """Record what solids have taken in a frame whose points are recorded, and whether it was the last one."""
    if ti.static(of.needs.impulses):
        note_impulses(scene, frame, of)
    if ti.static(of.needs.rests):
        note_rest(scene, frame, of)


@ti.func
def note_block(scene, frame, block, of: ti.template()):
    """Record positions and energies of the points of a block, and the fields where asked for.

    Kinetic energy is that of the points and of the affine motion around them, m C : C dx^2 / 8, which APIC carries too;
    elastic energy V0 [(1 + nu) sigma : sigma - nu (tr sigma)^2] / (2 E).
    """
    needs, lanes = of.needs, of.needs.lanes
    volume, dx = of.settings[scene, Setting.VOLUME], of.settings[scene, Setting.CELL]
    first = block * needs.block
    present = of.state[first + needs.present]
    mass = volume * property_of(scene, block, Property.DENSITY, of) * present
    vv, cc, ss, trace = 0.0 * mass, 0.0 * mass, 0.0 * mass, 0.0 * mass
    for k in ti.static(range(needs.dimension)):
        vv = vv + of.state[first + needs.velocity + k] * of.state[first + needs.velocity + k]
    for k in ti.static(range(needs.dimension * needs.dimension)):
        cc = cc + of.state[first + needs.affine + k] * of.state[first + needs.affine + k]
    for k in ti.static(range(needs.stresses)):
        s = of.state[first + needs.stress + k]
        ss = ss + ti.static(1.0 if k < 3 else 2.0) * s * s
        trace = trace + ti.static(1.0 if k < 3 else 0.0) * s
    height = (
        of.settings[scene, Setting.GRAVITY_X] * of.state[first]
        + of.settings[scene, Setting.GRAVITY_Y] * of.state[first + 1]
    )
    deviator = property_of(scene, block, Property.ELASTIC_DEVIATOR, of)
    spherical = property_of(scene, block, Property.ELASTIC_TRACE, of)
    line = (frame + of.places[scene, Place.ENERGY]) * ti.static(len(Energy))
    add(of.energy, line + Energy.KINETIC, total(0.5 * mass * (vv + 0.25 * dx * dx * cc), of), of)
    add(of.energy, line + Energy.POTENTIAL, total(0.0 - mass * height, of), of)
    elastic = volume * present * (deviator * ss - spherical * trace * trace)
    add(of.energy, line + Energy.ELASTIC, total(elastic, of), of)
    for lane in range(points_in(scene, block, of)):
        point = of.places[scene, Place.RECORD] + frame * of.places[scene, Place.POINTS] + of.order[block * lanes + lane]
        for k in ti.static(range(needs.dimension)):
            of.record[point * needs.dimension + k] = of.lanes[(first + k) * lanes + lane]
        if ti.static(needs.fields):
            at = point * ti.static(needs.dimension + len(Field))
            for k in ti.static(range(needs.dimension)):
                of.fields[at + k] = of.lanes[(first + needs.velocity + k) * lanes + lane]
            pressure = 0.0
            for k in ti.static(range(3)):
                pressure -= of.lanes[(first + needs.stress + k) * lanes + lane] / 3.0
            of.fields[at + ti.static(needs.dimension + Field.PRESSURE)] = pressure
            of.fields[at + ti.static(needs.dimension + Field.PLASTIC_STRAIN)] = of.lanes[
                (first + needs.plastic_strain) * lanes + lane
            ]


@ti.func
def note_impulses(scene, frame, of: ti.template()):
    """Record the momentum that each solid took in this frame, and count from zero again."""
    needs = of.needs
    count = of.places[scene, Place.SOLIDS]
    line = of.places[scene, Place.TAKEN] + frame * count
    each = of.workers.shape[0] // of.places.shape[0]
    for worker in range(scene * each, (scene + 1) * each):
        for number in range(count):
            for k in ti.static(range(needs.dimension)):
                at = of.workers[worker, Worker.IMPULSE] + number * needs.dimension + k
                of.taken[line + number, k] = of.taken[line + number, k] + total(of.impulse[at], of)
                of.impulse[at] = 0.0 * of.impulse[at]


@ti.func
def note_rest(scene, frame, of: ti.template()):
    """Note where the kinetic energy of a frame has fallen to nothing beside the largest so far."""
    line = of.places[scene, Place.ENERGY]
    peak = of.energy[line * ti.static(len(Energy)) + Energy.KINETIC]
    for earlier in range(frame):
        peak = ti.max(peak, of.energy[(line + earlier) * ti.static(len(Energy)) + Energy.KINETIC])
    if of.energy[(line + frame) * ti.static(len(Energy)) + Energy.KINETIC] < REST * peak:
        of.places[scene, Place.REST] = frame
