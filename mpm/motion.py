"""What a block of points does between grid and next step: it moves, keeps out of solids, and its stress follows."""

import taichi as ti

from mpm.baffles import points_against_baffles
from mpm.lanes import add, between, larger, least, most, smaller, total
from mpm.layout import PADDING, Place, Property, Setting, Worker
from mpm.mohr_coulomb import softened
from mpm.stress import stress_step
from mpm.transfer import grid_to_block, property_of


@ti.func
def move_points(worker, scene, dt, rows: ti.template(), of: ti.template()):
    """Bring every point of `worker` from the grid's velocities to its new place and stress."""
    needs = of.needs
    first = of.workers[worker, Worker.FIRST]
    per_dx = 1.0 / of.settings[scene, Setting.CELL]
    # The lowest and highest place of each lane, then of all: the box of nodes that the next step touches.
    low = [of.state[first * needs.block + k] * 0.0 + 1.0e30 for k in ti.static(range(needs.dimension))]
    high = [0.0 - low[k] for k in ti.static(range(needs.dimension))]
    grid, scratch = of.workers[worker, Worker.NODE], of.workers[worker, Worker.SCRATCH]
    for block in range(first, of.workers[worker, Worker.LAST]):
        move_block(worker, grid, scene, block, scratch, dt, rows, of)
        for k in ti.static(range(needs.dimension)):
            low[k] = smaller(low[k], of.state[block * needs.block + k])
            high[k] = larger(high[k], of.state[block * needs.block + k])
    for k in ti.static(range(needs.dimension)):
        lowest = ti.floor(least(low[k], of) * per_dx + (PADDING - 0.5))
        highest = ti.floor(most(high[k], of) * per_dx + (PADDING - 0.5))
        of.workers[worker, Worker.LOW_X + k] = ti.cast(lowest, ti.i32)
        of.workers[worker, Worker.HIGH_X + k] = ti.cast(highest, ti.i32) + 3


@ti.func
def move_block(worker, grid, scene, block, scratch, dt, rows: ti.template(), of: ti.template()):
    """Bring the points of a block from the velocities of the nodes from `grid` on to their new places and stresses."""
    grid_to_block(grid, block, scratch, 1.0 / of.settings[scene, Setting.CELL], rows, of)
    step_points(worker, scene, block, dt, of)
    update_stress(scene, block, dt, of)


@ti.func
def step_points(worker, scene, block, dt, of: ti.template()):
    """Move a block by its velocity; no point leaves the box or comes into a baffle."""
    needs = of.needs
    x, v = block * needs.block, block * needs.block + needs.velocity
    for k in ti.static(range(needs.dimension)):
        of.state[x + k] = of.state[x + k] + dt * of.state[v + k]
    if ti.static(needs.baffles):
        density = property_of(scene, block, Property.DENSITY, of)
        present = of.state[block * needs.block + needs.present]
        mass = of.settings[scene, Setting.VOLUME] * density * present
        points_against_baffles(block, mass, worker, scene, of)
    for k in ti.static(range(needs.dimension)):
        free = of.state[x + k]
        length = of.places[scene, Place.CELLS_X + k] * of.settings[scene, Setting.CELL]
        held = between(free, 0.0, length)
        of.state[x + k] = held
        put_back = total(ti.select(held != free, of.state[block * needs.block + needs.present], 0.0), of)
        if put_back > 0.0:
            add(of.clamped, worker, ti.cast(put_back, ti.i32), of)


@ti.func
def update_stress(scene, block, dt, of: ti.template()):
    """Stress, and plastic strain where it is needed, of a block after its new velocity gradient.

    Where the material softens, the strength of the step is that of the plastic strain at its start: explicit.
    """
    needs = of.needs
    first = block * needs.block
    lame, shear = property_of(scene, block, Property.LAME, of), property_of(scene, block, Property.SHEAR, of)
    sin_phi, sin_psi, strength, limit = strength_of(scene, block, of)
    stress = [of.state[first + needs.stress + k] for k in ti.static(range(needs.stresses))]
    gradient = [dt * of.state[first + needs.affine + k] for k in ti.static(range(needs.dimension * needs.dimension))]
    opened = 0.0 * stress[0]
    if ti.static(needs.corrected):
        opened = of.state[first + needs.gap]
    new = stress_step(stress, gradient, opened, sin_phi, sin_psi, strength, limit, lame, shear, needs)
    for k in ti.static(range(needs.stresses)):
        of.state[first + needs.stress + k] = new[k]
    if ti.static(needs.corrected):
        of.state[first + needs.gap] = of.settings[scene, Setting.CORRECTED] * new[needs.stresses + 1]
    if ti.static(needs.strained):
        at = first + needs.plastic_strain
        of.state[at] = of.state[at] + new[needs.stresses]


@ti.func
def strength_of(scene, block, of: ti.template()):
    """sin phi [-], sin psi [-], 2 c cos phi [Pa] and T [Pa] of a block in this step."""
    needs = of.needs
    sin_phi = property_of(scene, block, Property.SIN_PHI, of)
    # Zeros known to the compiler where the scene has no dilation and no cohesion.
    sin_psi, strength, limit = 0.0 * sin_phi, 0.0 * sin_phi, 0.0 * sin_phi
    if ti.static(needs.dilates):
        sin_psi = property_of(scene, block, Property.SIN_PSI, of)
    if ti.static(needs.cohesive):
        strength = property_of(scene, block, Property.STRENGTH, of)
        limit = property_of(scene, block, Property.LIMIT, of)
    if ti.static(needs.softens):
        residual = (
            property_of(scene, block, Property.RESIDUAL_SIN_PHI, of),
            property_of(scene, block, Property.RESIDUAL_STRENGTH, of),
            property_of(scene, block, Property.RESIDUAL_LIMIT, of),
        )
        per_strain = property_of(scene, block, Property.SOFTENING, of) * of.settings[scene, Setting.CELL]
        strain = of.state[block * needs.block + needs.plastic_strain]
        return softened(strain, per_strain, (sin_phi, sin_psi, strength, limit), residual, needs)
    else:
        return sin_phi, sin_psi, strength, limit
