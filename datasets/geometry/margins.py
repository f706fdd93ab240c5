"""How far solids go on beyond the box, and what counts as touching."""

from dataclasses import dataclass

BEYOND = 8.0
"""Cells by which a solid that reaches a side of the box goes on beyond it, so that none of its faces lies there."""
KEPT = 3.0
"""Cells beyond the box in which faces are kept: the grid ends there (`mpm.arrays.layout.PADDING`)."""
TOUCHING = 1.0e-9
"""Distance [m] up to which lengths that a user wrote in decimals are the same."""
CLOSING = 1.0e-6
"""Half of the widest gap, in cells, that touching solids leave between them by rounding."""
OUTSIDE = "expected a solid that reaches into the domain, this one lies outside of it"
DOMAIN_SIDES = {2: ((0, 0), (0, 1), (1, 0), (1, 1)), 3: ((0, 0), (0, 1), (2, 0), (2, 1), (1, 0), (1, 1))}
"""The sides of the box as (axis, 0 or 1), in the order in which solids are continued beyond them."""


@dataclass(frozen=True)
class Box:
    """The box of a scene: what of a `Domain` the geometry needs."""

    size: tuple[float, ...]
    """Extent [m]."""
    cell: float
    """Edge of a grid cell [m]."""

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return len(self.size)
