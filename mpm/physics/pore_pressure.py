"""The forces of pore water pressure: inside the mixture, on solids and on walls of the box.

    sigma = sigma' - p I,        t_w = p_f n,    p_f = p - d n . grad p

with the effective stress sigma', the outward normal n of a surface and the pressure p_f at the foot of a particle at
distance d. Water presses on every surface with delta p_f (delta: `mpm.physics.contact`) instead of delta p, which is
exact for a linear pressure. p acts 0.3 cells away from the surface on average: with it, water would carry 0.3 rho g dx
too little of a layer and the grains that much more; grains that carry a fifth of the weight of five cells would have a
quarter too much friction. A wall of the box takes this water traction, too. Its nodes then stop only the thrust of the
grains, which alone causes friction.

The forces use max(p, -u) instead of p, with the suction u that water bears (`mpm.physics.water`).
"""

import taichi as ti

from datasets.scene.water import CAVITATION
from mpm.arrays.access import add, clamp, dot, maximum, minimum, no_overflow, over_lanes, present, vectors
from mpm.arrays.layout import Contact, Offset, Setting, Worker
from mpm.physics.boundary import contact_delta, is_wall

COVERED = 0.5  # normal component across a wall above which a solid covers the wall for particles touching it


@ti.func
def suction_held(stress: ti.template(), held: ti.template()):
    """The largest suction of water [Pa] between grains with the `stress` [Pa]: the pressure between grains, up to
    cavitation, so that the total stress is no tension; none where not `held`.
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

    towards: vector [m] to the place whose pressure counts, a list of D; empty for the particle's own place.
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
    """Add the momentum that water gives to the sides of the box in a step, -dt V0 delta p_f n."""
    for side in ti.static(range(2 * arrays.features.dimension)):
        if presses_on(block, side, scene, arrays):
            taken = wall_pressure(block, side, scene, arrays) * volume * present(block, arrays)
            solid = arrays.offsets[scene, Offset.OBSTACLES] + side
            at = arrays.workers[worker, Worker.IMPULSE] + solid * arrays.features.dimension + ti.static(side // 2)
            add(arrays.impulse, at, ti.static(2.0 * (side % 2) - 1.0) * dt * taken, arrays)
