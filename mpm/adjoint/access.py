"""Bars of a block of particles (`mpm.adjoint.layout`)."""

import taichi as ti


@ti.func
def add_bars(first, values: ti.template(), arrays: ti.template()):
    """Add to the bars from vector `first` on."""
    for k in ti.static(range(len(values))):
        arrays.adjoints[first + k] = arrays.adjoints[first + k] + values[k]


@ti.func
def add_property_bar(block, column: ti.template(), value, arrays: ti.template()):
    """Add to the bars of a property of the particles of a block."""
    at = block * arrays.layout.width + arrays.features.state.properties + ti.static(int(column))
    present = arrays.state[block * arrays.features.state.size + arrays.features.state.present]
    arrays.adjoints[at] = arrays.adjoints[at] + present * value


@ti.func
def contact_bar(block, column: ti.template(), arrays: ti.template()):
    """Index of the bar of the vector `column` of those that describe the contact of a block."""
    return block * arrays.layout.width + arrays.features.state.contacts + column
