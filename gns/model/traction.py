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
"""

import torch
from torch import Tensor

from gns.model.grid import UP
from gns.model.settings import GRAVITY
from gns.model.state import Conditions

ROUNDED = 0.1
"""Change of the motion over `slow` below which its amount is rounded [-]: a sharp kink has no useful derivative."""


def count(dimension: int) -> int:
    """Number of `traction_features`."""
    return 2 * dimension


def sliding_count(dimension: int) -> int:
    """Numbers of `basal_friction` and `damped_motion`."""
    return 2 * dimension


def traction_features(
    positions: Tensor, velocity: Tensor, solids: Tensor, conditions: Conditions, *, cutoff: float, slow: Tensor
) -> Tensor:
    """Traction and damping of each particle [-], shape [N, `count`].

    velocity: newest displacements [m per step], shape [N, D]; solids: direction and friction of the nearest solid, the
    last D + 1 of `gns.model.solids.solid_features`; slow: v0 [m per step].
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
