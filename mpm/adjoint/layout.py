"""What the reverse of a step keeps of every particle and of a worker, beside the arrays of the step itself.

The derivative of the objective J with respect to a number is called its bar. Bars of a block of particles lie as the
numbers do in its state: position, velocity, C, stress from vector 0 on; those of its material properties follow.
"""

from dataclasses import dataclass
from typing import ClassVar

from mpm.arrays.features import Features


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
    def history(self) -> int:
        """Vectors of a block that are kept of every step: all that a step changes and a reverse step reads."""
        return self.history_present + int(self.features.outflow)

    @property
    def history_present(self) -> int:
        """Vector of a block's history that holds whether particles are in the box, where `outflow`."""
        return self.history_contacts + self.features.contact_vectors

    @property
    def history_contacts(self) -> int:
        """First of the vectors of a block's history that `mpm.arrays.layout.Contact` lists, where `contact`."""
        return self.features.properties

    @property
    def properties(self) -> int:
        """First of the vectors of bars of `mpm.arrays.layout.Property`, behind those of the state."""
        return self.features.properties

    @property
    def width(self) -> int:
        """Vectors of bars in a block."""
        return self.contacts + self.features.contact_vectors

    @property
    def contacts(self) -> int:
        """First of the vectors of bars of `mpm.arrays.layout.Contact`, where `contact`."""
        return self.properties + self.features.columns

    # The scratch vectors of a worker: those of the step, whose weights times distances become slopes of the weights.

    @property
    def slopes(self) -> int:
        """First of the 3 D scratch vectors dw/dx_p of the three nodes along each axis [1/m]."""
        return 3 * self.features.dimension

    @property
    def levers(self) -> int:
        """First of the 3 D scratch vectors w (x_i - x_p) along each axis [m]."""
        return self.features.scratch

    @property
    def sums(self) -> int:
        """First of the 1 + D groups of what a block gathers of its nodes: sum w n, then sum w n x_ip of each axis."""
        return self.levers + 3 * self.features.dimension

    @property
    def forces(self) -> int:
        """First of the D scratch vectors of the sums that move a particle's weights."""
        return self.sums + (1 + self.features.dimension) * self.features.node

    @property
    def scratch(self) -> int:
        """Scratch vectors of a worker."""
        return self.before + (2 * self.features.dimension if self.features.contact else 0)

    @property
    def foot(self) -> int:
        """First of the D scratch vectors of the bars of v_f (`mpm.physics.contact`), where `contact`."""
        return self.forces + self.features.dimension

    @property
    def before(self) -> int:
        """First of the 2 D scratch vectors of velocity and shear traction before contact is found, where `contact`."""
        return self.foot + (self.features.dimension if self.features.contact else 0)
