"""Bars of a block of particles (`mpm.adjoint.layout`): added to, and read and written in single lanes."""

import taichi as ti


@ti.func
def add_bars(first, values: ti.template(), arrays: ti.template()):
    """Add to the bars from vector `first` on."""
    for k in ti.static(range(len(values))):
        arrays.adjoints[first + k] = arrays.adjoints[first + k] + values[k]


@ti.func
def add_property_bar(block, column: ti.template(), value, arrays: ti.template()):
    """Add to the bars of a property of the particles of a block."""
    at = block * arrays.layout.width + arrays.layout.properties + ti.static(int(column))
    present = arrays.state[block * arrays.features.block + arrays.features.present]
    arrays.adjoints[at] = arrays.adjoints[at] + present * value


@ti.func
def contact_bar(block, column: ti.template(), arrays: ti.template()):
    """Index of the bar of the vector `column` of those that describe the contact of a block."""
    return block * arrays.layout.width + arrays.layout.contacts + column


@ti.func
def lane_numbers(numbers: ti.template(), first, arrays: ti.template()):
    """D numbers of a lane from `first` on, one per vector of its block."""
    features = arrays.features
    return ti.Vector([numbers[first + k * features.lanes] for k in ti.static(range(features.dimension))])


@ti.func
def put_lane_numbers(numbers: ti.template(), first, value, arrays: ti.template()):
    """Put D numbers where `lane_numbers` reads them."""
    for k in ti.static(range(arrays.features.dimension)):
        numbers[first + k * arrays.features.lanes] = value[k]
