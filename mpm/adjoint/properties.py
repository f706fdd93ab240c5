"""Bars of the material's properties: what a step read of them, and of the strength that softening made of them."""

import taichi as ti

from mpm.adjoint.mohr_coulomb import softened_reverse
from mpm.arrays.layout import Property, Setting
from mpm.physics.transfer import property_of


@ti.func
def add_property_bar(block, column: ti.template(), value, arrays: ti.template()):
    """Add to the bars of a property of the particles of a block."""
    at = block * arrays.layout.width + arrays.layout.properties + ti.static(int(column))
    present = arrays.state[block * arrays.features.block + arrays.features.present]
    arrays.adjoints[at] = arrays.adjoints[at] + present * value


@ti.func
def strength_reverse(scene, block, bar: ti.template(), arrays: ti.template()):
    """Bars of the strength of a block's material, and of its plastic strain, from those of `strength_of`."""
    features, layout = arrays.features, arrays.layout
    if ti.static(features.softens):
        zero = 0.0 * bar[0]
        peak = [zero + property_of(scene, block, Property.SIN_PHI, arrays), zero, zero, zero]
        if ti.static(features.dilates):
            peak[1] = zero + property_of(scene, block, Property.SIN_PSI, arrays)
        if ti.static(features.cohesive):
            peak[2] = zero + property_of(scene, block, Property.STRENGTH, arrays)
            peak[3] = zero + property_of(scene, block, Property.LIMIT, arrays)
        residual = (
            property_of(scene, block, Property.RESIDUAL_SIN_PHI, arrays),
            property_of(scene, block, Property.RESIDUAL_STRENGTH, arrays),
            property_of(scene, block, Property.RESIDUAL_LIMIT, arrays),
        )
        cell = arrays.settings[scene, Setting.CELL]
        per_strain = property_of(scene, block, Property.SOFTENING, arrays) * cell
        strain = arrays.state[block * features.block + features.plastic_strain]
        back = softened_reverse(bar, strain, per_strain, peak, residual, features)
        at = block * layout.width + features.plastic_strain
        arrays.adjoints[at] = arrays.adjoints[at] + back[0]
        add_property_bar(block, Property.SOFTENING, cell * back[1], arrays)
        columns = ti.static(
            (
                Property.SIN_PHI,
                Property.SIN_PSI,
                Property.STRENGTH,
                Property.LIMIT,
                Property.RESIDUAL_SIN_PHI,
                Property.RESIDUAL_STRENGTH,
                Property.RESIDUAL_LIMIT,
            )
        )
        for k in ti.static(range(7)):
            add_property_bar(block, columns[k], back[ti.static(2 + k)], arrays)
    else:
        columns = ti.static((Property.SIN_PHI, Property.SIN_PSI, Property.STRENGTH, Property.LIMIT))
        for k in ti.static(range(4)):
            add_property_bar(block, columns[k], bar[k], arrays)
