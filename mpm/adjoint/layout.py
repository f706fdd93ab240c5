"""What the reverse of a step keeps of every particle and of a worker, beside the arrays of the step itself.

Bars of a block of particles, and what is kept of it, lie as the numbers do in its state: position, velocity, C, stress
from vector 0 on, then contact; bars of its material properties follow.
"""

from dataclasses import dataclass
from typing import ClassVar

from mpm.arrays.features import Features, offset


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

    def __getattr__(self, name: str) -> int:
        """Where the part `name` begins of bars, history or scratch; see `parts`."""
        return offset(parts, self.features, name)


def parts(features: Features) -> list[dict[str, int]]:
    """How long the parts are of what the reverse keeps, in their order."""
    size, contact = features.dimension, int(features.contact)
    return [
        # Vectors of bars of a block: those of its state, then of `Property`.
        {"state": features.properties + features.columns, "width": 0},
        # Vectors of a block that are kept of every step, the first of its state: a reverse step reads no others.
        {"changing": features.present + int(features.outflow), "history": 0},
        {  # Scratch vectors of a worker: those of the step, whose weights times distances become slopes, and
            "weights": 3 * size,
            "slopes": features.scratch - 3 * size,  # dw/dx_p of the three nodes along each axis [1/m],
            "levers": 3 * size,  # w (x_i - x_p) along each axis [m],
            "sums": (1 + size) * features.node,  # sum w n of a block's nodes n, then sum w n x_ip of each axis,
            "forces": size,  # the sums that move a particle's weights,
            "foot": size * contact,  # bars of v_f (`mpm.physics.contact`),
            "before": 2 * size * contact,  # velocity and shear traction before contact is found
            "scratch": 0,
        },
    ]
