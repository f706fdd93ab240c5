"""The pressure of pore water in the forces: inside of a mixture, on solids and on walls of the box.

    sigma = sigma' - p I,        t_w = p_f n,    p_f = p - d n . grad p

with the effective stress sigma', the outward normal n of a surface and the pressure p_f at the foot of a particle whose
distance is d. Water presses on every surface by the delta of `mpm.physics.contact` in place of p delta: exact for a
pressure that grows evenly. By p itself, which acts 0.3 cells away on average, it would bear 0.3 rho g dx too little of
a layer, the grains that much more, and where these bear a fifth of the weight of five cells, they would rub by a
quarter too much. A wall of the box takes this traction of the water, too: what its nodes stop is then what grains press
on it, and on that alone it rubs.

Forces have max(p, -u) in place of p, with the suction u that water bears (`mpm.physics.water`).
"""

import taichi as ti

from datasets.scene.water import CAVITATION
from mpm.arrays.access import add, clamp, dot, maximum, minimum, no_overflow, over_lanes, present, vectors
from mpm.arrays.layout import Contact, Offset, Setting, Worker
from mpm.physics.boundary import contact_delta, is_wall

COVERED = 0.5  # component of a solid's normal across a wall from which on it covers that for particles that touch it


@ti.func
def suction_held(stress: ti.template(), held: ti.template()):
    """The largest suction of water [Pa] between grains with the `stress` [Pa]: what presses these, up to cavitation, so
    that they pull nothing together; none where not `held`.
    """
    if ti.static(held):
        return clamp((stress[0] + stress[1] + stress[2]) * (-1.0 / 3.0), 0.0, CAVITATION)
    else:
        return 0.0 * stress[0]


@ti.func
def felt_pressure(block, stress: ti.template(), rise, arrays: ti.template()):
    """max(p, -u) [Pa] of the water of a block whose grains have `stress`, at places where p is higher by `rise`."""
    features = arrays.features
    first = no_overflow(block * features.state.size)
    p = arrays.state[first + features.state.pore_pressure] + arrays.state[first + features.state.volume_strain]
    return maximum(p + rise, 0.0 - suction_held(stress, features.dilates))


@ti.func
def total_stress(block, towards: ti.template(), arrays: ti.template()):
    """Stress [Pa] of the particles of a block, that of the grains less the pore pressure; a list of vectors.

    towards: the way [m] to the place whose pressure counts, a list of D; none for that of the particle.
    """
    features = arrays.features
    first = no_overflow(block * features.state.size)
    stress = vectors(arrays.state, first + features.state.stress, features.stresses)
    if ti.static(features.wet):
        rise = 0.0 * stress[0]
        if ti.static(len(towards) > 0):
            rise = dot(vectors(arrays.state, first + features.state.pressure_slope, features.dimension), towards)
        p = felt_pressure(block, stress, rise, arrays)
        return [stress[k] - p if k < 3 else stress[k] for k in ti.static(range(features.stresses))]
    else:
        return stress


@ti.func
def from_wall(block, side: ti.template(), scene, arrays: ti.template()):
    """Distance of the particles of a block from a side of the box, 0 to 2 D - 1 for x-, x+, y-, ... [m]."""
    x = arrays.state[no_overflow(block * arrays.features.state.size) + ti.static(side // 2)]
    if ti.static(side % 2 == 1):
        x = arrays.offsets[scene, Offset.CELLS_X + ti.static(side // 2)] * arrays.settings[scene, Setting.CELL] - x
    return maximum(x, 0.0)


@ti.func
def presses_on(block, side: ti.template(), scene, arrays: ti.template()):
    """Whether water of a block may press on a side of the box."""
    away = over_lanes(minimum, from_wall(block, side, scene, arrays), arrays.features.lanes)
    return away < arrays.settings[scene, Setting.CONTACT_WIDTH] and is_wall(side, scene, arrays) == 1


@ti.func
def wall_pressure(block, side: ti.template(), scene, arrays: ti.template()):
    """delta p_f [Pa/m] of the water of a block at a side of the box, not where a solid covers it."""
    features, inwards = arrays.features, ti.static(1.0 - 2.0 * (side % 2))
    first, axis = no_overflow(block * features.state.size), ti.static(side // 2)
    away = from_wall(block, side, scene, arrays)
    stress = vectors(arrays.state, first + features.state.stress, features.stresses)
    rise = (0.0 - inwards) * away * arrays.state[first + features.state.pressure_slope + axis]
    p = felt_pressure(block, stress, rise, arrays) * arrays.state[first + features.state.saturated]
    pressure = contact_delta(away, arrays.settings[scene, Setting.CONTACT_WIDTH]) * p
    if ti.static(features.contact):
        contact = first + features.state.contacts
        facing = inwards * arrays.state[contact + Contact.NORMAL + axis]
        covered = (arrays.state[contact + Contact.DELTA] > 0.0) & (facing > COVERED)
        pressure = ti.select(covered, 0.0, pressure)
    return pressure


@ti.func
def record_wall_pressure(block, volume, dt, scene, worker, arrays: ti.template()):
    """Add what water gives of its momentum to the sides of the box in a step, -dt V0 delta p_f n."""
    for side in ti.static(range(2 * arrays.features.dimension)):
        if presses_on(block, side, scene, arrays):
            taken = wall_pressure(block, side, scene, arrays) * volume * present(block, arrays)
            solid = arrays.offsets[scene, Offset.OBSTACLES] + side
            at = arrays.workers[worker, Worker.IMPULSE] + solid * arrays.features.dimension + ti.static(side // 2)
            add(arrays.impulse, at, ti.static(2.0 * (side % 2) - 1.0) * dt * taken, arrays)
