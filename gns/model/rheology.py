"""The forces of pressure and of internal friction that Coulomb's law gives on the background grid, as features.

Sand that shears bears a shear stress of its strength, along its rate of strain (von Mises' flow rule, e.g. Jop,
Forterre & Pouliquen, Nature 441, 2006, eq. 2, without the dependence on the rate), beside the pressure p of the column
above:

    f_p = -grad p / (rho g),                               p = rho g h
    f_s = div S / (rho g),   S = (c + p tan(phi)) D' / (|D'| + d0),   |D'| = sqrt(D' : D' / 2)

with the deviatoric rate of strain D'. On cells as coarse as these it is a rough estimate; the rest is learned.

| symbol         | variable            | unit                                              |
| h, c / (rho g) | `above`, `cohesion` | m                                                 |
| D              | from `moved`        | 1 per step                                        |
| f_p, f_s       | result              | weight of the material; S over rho g is a length  |
"""

import torch
from torch import Tensor

from gns.model.grid import Stencil

EMPTY = 0.05
"""Share of a cell that is filled below which the mean of what is in it fades [-]."""
LOOSE = 0.3
"""Share of a cell that is filled below which a force is that on so much material [-]."""
LARGEST = 3.0
"""The weight of the material that a force approaches at most [-]."""


def count(dimension: int) -> int:
    """Number of `internal_forces`."""
    return 2 * dimension


def internal_forces(
    stencil: Stencil,
    moved: Tensor,
    volume: Tensor,
    friction: Tensor,
    cohesion: Tensor,
    above: Tensor,
    size: Tensor,
    slow: Tensor,
) -> Tensor:
    """f_s, then f_p at the particles [-], shape [N, `count`].

    moved: newest displacements [m per step], shape [N, D]; volume [m^D], friction tan(phi) [-] and cohesion over rho g
    [m]: shape [N]; above: height of the column of material above each node [m], shape [B * nodes]; size: of the boxes
    [m], shape [B, D]; slow: d0 times the cell [m per step]. Walls bear no shear here: that is a feature apart.
    """
    cell, dimension, shape = stencil.cell, moved.shape[1], (stencil.samples, *stencil.shape)
    carried = torch.cat((torch.ones_like(moved[:, :1]), moved, friction.unsqueeze(1), cohesion.unsqueeze(1)), dim=1)
    sums = stencil.scatter((volume / cell**dimension).unsqueeze(1) * carried)
    filled = sums[:, :1]
    means = sums[:, 1:] / (filled + EMPTY)
    strength = means[:, dimension + 1] + above * means[:, dimension]
    fields = torch.cat((means[:, :dimension], strength.unsqueeze(1), above.unsqueeze(1)), dim=1).view(*shape, -1)
    fields = stencil.within(fields, size, range(dimension))
    gradient = [torch.gradient(fields, spacing=cell, dim=axis + 1)[0] for axis in range(dimension)]
    mean = sum(gradient[axis][..., axis] for axis in range(dimension)) / dimension
    rate = {
        (i, j): 0.5 * (gradient[j][..., i] + gradient[i][..., j]) - (mean if i == j else 0.0)
        for i in range(dimension)
        for j in range(i, dimension)
    }
    square = sum((1.0 if i == j else 2.0) * each.square() for (i, j), each in rate.items())
    # Not the root alone: it has no slope at zero.
    scale = fields[..., dimension] / ((0.5 * square + (slow / cell) ** 2).sqrt() + slow / cell)
    stress = stencil.within(torch.stack([scale * each for each in rate.values()], dim=-1), size, range(dimension))
    slopes = [torch.gradient(stress, spacing=cell, dim=axis + 1)[0] for axis in range(dimension)]
    index = {pair: number for number, pair in enumerate(rate)}
    divergence = [
        torch.stack([slopes[j][..., index[min(i, j), max(i, j)]].reshape(-1) for j in range(dimension)]).sum(dim=0)
        for i in range(dimension)
    ]
    shear = torch.stack(divergence, dim=1) / filled.clamp(min=LOOSE)
    pressure = torch.stack([gradient[axis][..., dimension + 1].reshape(-1) for axis in range(dimension)], dim=1)
    return stencil.gather(LARGEST * torch.tanh(torch.cat((shear, -pressure), dim=1) / LARGEST))
