"""What Coulomb's law and damping say of a particle, as features: products that a network would have to learn.

The friction of a surface acts against the tangential motion, with the coefficient mu of that surface; local damping
acts against the motion. A network of sums learns products of an input with the direction of another slowly.

    traction = -sum_s mu_s w_s u(v - (v . n_s) n_s)      over floor, walls and the nearest baffle or ground
    damping  = -alpha u(v)                               u(v) = v / sqrt(|v|^2 + v0^2)
    strength = r / (1 + r),  r = c / (rho g (h + cell))  cohesion over the weight h of the column above
    basal    = -m v* / sqrt(|v*|^2 + m^2) / g dt^2,      m = min(mu, tan(phi)) g_n dt^2
    damped   = -alpha |a| u(v) / g dt^2                  of the MPM's local damping, on the last change a of the motion

The basal friction is that of a layer which slides as a whole (Savage & Hutter, J. Fluid Mech. 199, 1989, eq. 2.21):
its friction on the floor or, above a rougher floor, within itself. It acts on the displacement v* along the floor that
gravity alone would lead to, and at most stops it.

| symbol | variable                          | meaning                                            |
| w_s    | 1 - distance / cutoff, at least 0 | how near the surface is                            |
| v      | newest displacement               | m per step                                         |
| v0     | `slow`                            | displacement below which the direction fades       |
| g_n    | `normal`                          | gravity against the floor                          |

On the background grid the law gives the forces of pressure and of internal friction. Sand that shears bears a shear
stress of its strength, along its rate of strain (von Mises' flow rule, e.g. Jop, Forterre & Pouliquen, Nature 441,
2006, eq. 2, without the dependence on the rate), beside the pressure p of the column above:

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

from gns.grid import Stencil
from gns.settings import GRAVITY, UP
from gns.state import Conditions

ROUNDED = 0.1
"""Change of the motion over `slow` below which its amount is rounded [-]: a sharp kink has no useful derivative."""
EMPTY = 0.05
"""Share of a cell that is filled below which the mean of what is in it fades [-]."""
LOOSE = 0.3
"""Share of a cell that is filled below which a force is that on so much material [-]."""
LARGEST = 3.0
"""The weight of the material that a force approaches at most [-]."""


def traction_features(
    positions: Tensor, velocity: Tensor, solids: Tensor, conditions: Conditions, *, cutoff: float, slow: Tensor
) -> Tensor:
    """Traction and damping of each particle [-], shape [N, 2 D].

    velocity: newest displacements [m per step], shape [N, D]; solids: direction and friction of the nearest solid, the
    last D + 1 of `gns.solids.solid_features`; slow: v0 [m per step].
    """
    dimension = positions.shape[1]
    size = conditions.of_particles(conditions.size)
    floor, wall = (
        conditions.of_particles(each).unsqueeze(1) for each in (conditions.floor_friction, conditions.wall_friction)
    )
    lower = (1.0 - positions / cutoff).clamp(min=0.0)
    upper = (1.0 - (size - positions) / cutoff).clamp(min=0.0)
    traction = torch.zeros_like(velocity)
    for axis in range(dimension):
        along = torch.cat([velocity[:, other : other + 1] * float(other != axis) for other in range(dimension)], dim=1)
        near = (floor if axis == UP else wall) * lower[:, axis : axis + 1] + wall * upper[:, axis : axis + 1]
        traction = traction - near * unit(along, slow)
    direction, friction = solids[:, :dimension], solids[:, dimension:]
    square = direction.square().sum(dim=1, keepdim=True)
    normal = direction / torch.where(square > 0.0, square, 1.0).sqrt()
    along = velocity - (velocity * normal).sum(dim=1, keepdim=True) * normal
    traction = traction - friction * unit(along, slow)
    damping = conditions.of_particles(conditions.damping).unsqueeze(1)
    return torch.cat((traction, -damping * unit(velocity, slow)), dim=1)


def basal_friction(velocity: Tensor, conditions: Conditions, *, step: float, slow: Tensor) -> Tensor:
    """Basal friction of each particle over its weight [-], shape [N, D].

    velocity: newest displacements [m per step], shape [N, D]; step: [s]; slow: v0 [m per step].
    """
    gravity = conditions.of_particles(conditions.gravity) * step**2
    level = torch.ones_like(velocity[:1])
    level[:, UP] = 0.0
    trial = level * (velocity + gravity)
    normal = -gravity[:, UP].clamp(max=0.0)
    rough = torch.minimum(conditions.of_particles(conditions.floor_friction), conditions.friction)
    most = (rough * normal).unsqueeze(1)
    # On a smooth floor too the root has a slope at zero.
    rounded = 1.0e-3 * slow
    size = (trial.square().sum(dim=1, keepdim=True) + most.square() + rounded**2).sqrt()
    return -most * trial / size / (GRAVITY * step**2)


def damped_motion(damping: Tensor, displacements: Tensor, *, step: float, slow: Tensor) -> Tensor:
    """Local damping of each particle over its weight [-], shape [N, D].

    damping: that of `traction_features` [-], shape [N, D]; displacements: past ones [m per step], shape [H, N, D];
    step: [s]; slow: v0 [m per step].
    """
    velocity = displacements[-1]
    change = velocity - displacements[-2] if len(displacements) > 1 else torch.zeros_like(velocity)
    size = (change.square().sum(dim=1, keepdim=True) + (ROUNDED * slow) ** 2).sqrt()
    return damping * size / (GRAVITY * step**2)


def unit(vectors: Tensor, slow: Tensor) -> Tensor:
    """Directions of vectors [N, D], which fade where they are shorter than `slow`."""
    return vectors / (vectors.square().sum(dim=1, keepdim=True) + slow**2).sqrt()


def strength(cohesion: Tensor, overburden: Tensor, *, weight: float, cell: float) -> Tensor:
    """Cohesion against the weight of the column above, r / (1 + r) [-], shape [N, 1].

    cohesion: [Pa], shape [N]; overburden: height of that column [m], shape [N]; weight: rho g [N/m^3].
    """
    ratio = cohesion / (weight * (overburden + cell))
    return (ratio / (1.0 + ratio)).unsqueeze(1)


def internal_forces(
    stencil: Stencil, moved: Tensor, above: Tensor, conditions: Conditions, *, weight: float, slow: Tensor
) -> Tensor:
    """f_s, then f_p at the particles [-], shape [N, 2 D].

    moved: newest displacements [m per step], shape [N, D]; above: height of the column of material above each node [m],
    shape [B * nodes]; weight: rho g [N/m^3]; slow: d0 times the cell [m per step]. Walls bear no shear here: that is a
    feature apart.
    """
    cell, dimension, shape, size = stencil.cell, moved.shape[1], (stencil.samples, *stencil.shape), conditions.size
    strengths = torch.stack((conditions.friction, conditions.cohesion / weight), dim=1)
    carried = torch.cat((torch.ones_like(moved[:, :1]), moved, strengths), dim=1)
    sums = stencil.scatter((conditions.volume / cell**dimension).unsqueeze(1) * carried)
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
