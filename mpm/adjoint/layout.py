"""What the reverse of a step keeps of every particle and of a worker, beside the arrays of the step itself.

Bars of a block of particles, and what is kept of it, lie as the numbers do in its state: position, velocity, C, stress
from vector 0 on, then contact; bars of its material properties follow.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import taichi as ti

from mpm.arrays.features import NODE, Addresses, Features
from mpm.arrays.layout import Worker


@dataclass(frozen=True)
class Layout:
    """Where bars and the history of states lie; the kernel is compiled for it."""

    features: Features
    exact: bool = False
    """Whether the sign of local damping has the slope of the step, else a bounded one (`mpm.adjoint.grid`)."""
    impulses: bool = False
    """Whether the objective depends on the momentum that solids have taken."""

    _data_oriented: ClassVar[bool] = True
    """Tells Taichi that a kernel may hold it as a Python object of compile time."""

    @property
    def width(self) -> int:
        """Vectors of bars of a block: those of its state, then of `Property`."""
        return self.features.state.properties + self.features.columns

    @property
    def history(self) -> int:
        """Vectors of a block that are kept of every step, the first of its state: a reverse step reads no others."""
        return self.features.state.present + int(self.features.outflow)

    @cached_property
    def scratch(self) -> Addresses:
        """Vectors of a worker's scratch: those of the step, whose weights times distances become slopes, then more."""
        size, contact = self.features.dimension, int(self.features.contact)
        return Addresses(
            weights=3 * size,
            slopes=self.features.scratch.size - 3 * size,  # dw/dx_p of the three nodes along each axis [1/m]
            levers=3 * size,  # w (x_i - x_p) along each axis [m]
            sums=(1 + size) * NODE,  # sum w n of a block's nodes n, then sum w n x_ip of each axis
            forces=size,  # the sums that move a particle's weights
            foot=size * contact,  # bars of v_f (`mpm.physics.contact`)
            before=2 * size * contact,  # velocity and shear traction before contact is found
        )


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
def impulse_bar(solid, worker, arrays: ti.template()):
    """The bar of the impulse of a solid, shape [D]."""
    features = arrays.features
    first = arrays.workers[worker, Worker.IMPULSE] + solid * features.dimension
    return ti.Vector([arrays.impulse_adjoints[first + k] for k in ti.static(range(features.dimension))])


@ti.func
def contact_bar(block, column: ti.template(), arrays: ti.template()):
    """Index of the bar of the vector `column` of those that describe the contact of a block."""
    return block * arrays.layout.width + arrays.features.state.contacts + column
