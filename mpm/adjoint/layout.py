"""The memory of the reverse of a step for particles and workers, besides the arrays of the step itself.

The adjoints of a block of particles, and its history, are ordered like its state: position, velocity, C, stress from
vector 0 on, then contact; the adjoints of its material properties follow.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import taichi as ti

from mpm.arrays.access import lane_sum, present, vectors
from mpm.arrays.features import NODE, Addresses, Features
from mpm.arrays.layout import Worker


@dataclass(frozen=True)
class Layout:
    """Where adjoints and the history of states lie; the kernel is compiled for it."""

    features: Features
    exact: bool = False  # whether the sign of damping has its true slope, else a bounded one (`mpm.adjoint.grid`)
    impulses: bool = False  # whether the objective depends on the momentum that solids have taken

    _data_oriented: ClassVar[bool] = True  # tells Taichi that a kernel may hold it as a compile-time Python object

    @property
    def width(self) -> int:
        """Vectors of adjoints of a block: those of its state, then of `Property`."""
        return self.features.state.properties + self.features.columns

    @property
    def history(self) -> int:
        """Number of vectors of a block kept for every step, the first of its state: a reverse step reads no others."""
        return self.features.state.present + int(self.features.outflow)

    @cached_property
    def scratch(self) -> Addresses:
        """Vectors of a worker's scratch: those of the step, slopes in place of weights times distances; then more."""
        size, contact = self.features.dimension, int(self.features.contact)
        return Addresses(
            weights=3 * size,
            slopes=self.features.scratch.size - 3 * size,  # dw/dx_p of the three nodes along each axis [1/m]
            levers=3 * size,  # w (x_i - x_p) along each axis [m]
            sums=(1 + size) * NODE,  # sum w n of a block's nodes n, then sum w n x_ip of each axis
            forces=size,  # the sums that move a particle's weights
            foot=size * contact,  # adjoints of v_f (`mpm.physics.contact`)
            before=2 * size * contact,  # velocity and shear traction before contact is found
        )


@dataclass(frozen=True, eq=False)
class Block:
    """A block of particles in a reversed step: numbers of the kernel that its functions pass on together."""

    worker: Any
    scene: Any
    number: Any  # of the block among all
    table: Any  # the first column of the worker's nodes
    state: Any  # its first vector in `state`, before the step
    adj: Any  # in `adjoints`
    after: Any  # in the history of states, after the step
    scratch: Any  # of the worker, in `scratch`
    dt: Any
    kappa: Any

    _data_oriented: ClassVar[bool] = True  # as of `Layout`


@ti.func
def state_before(step, block, arrays: ti.template()):
    """The first vector in the history of the block with this number before `step`."""
    blocks = arrays.state.shape[0] // ti.static(arrays.features.state.size)
    return (step * blocks + block) * ti.static(arrays.layout.history)


@ti.func
def adjoints_of(block: ti.template(), first: ti.template(), count: ti.template(), arrays: ti.template()):
    """The adjoints of `count` vectors of the state of a block from its vector `first` on."""
    return vectors(arrays.adjoints, block.adj + first, count)


@ti.func
def add_adjoints(block: ti.template(), first: ti.template(), values: ti.template(), arrays: ti.template()):
    """Add to the adjoints of the state of a block from its vector `first` on."""
    for k in ti.static(range(len(values))):
        at = block.adj + first + k
        arrays.adjoints[at] = arrays.adjoints[at] + values[k]


@ti.func
def add_property_adjoint(block: ti.template(), column: ti.template(), value, arrays: ti.template()):
    """Add to the adjoint of a property of the particles of a block."""
    first = ti.static(arrays.features.state.properties + int(column))
    add_adjoints(block, first, [present(block.number, arrays) * value], arrays)


@ti.func
def add_setting_adjoint(block: ti.template(), setting: ti.template(), value, arrays: ti.template()):
    """Add the contributions of a block's particles, in the box, to the adjoint of a setting."""
    total = lane_sum(present(block.number, arrays) * value, arrays)
    arrays.sums[block.worker, ti.static(int(setting))] += total


@ti.func
def impulse_adjoint(solid, worker, arrays: ti.template()):
    """The adjoint of the impulse of a solid, shape [D]."""
    features = arrays.features
    first = arrays.workers[worker, Worker.IMPULSE] + solid * features.dimension
    return ti.Vector([arrays.impulse_adjoints[first + k] for k in ti.static(range(features.dimension))])
