"""The particles at one moment, their surroundings, and the forces of known laws.

A network of sums is slow to learn products of its inputs, such as a friction coefficient times the direction of motion.
Therefore such products are features; some of them are forces, for which the network gives coefficients.

    traction = -sum_s mu_s w_s u(v - (v . n_s) n_s)      Coulomb friction of floor, walls and the nearest solid
    damping  = -alpha u(v)                               u(v) = v / sqrt(|v|^2 + v0^2)
    damped   = -alpha |a| u(v) / g dt^2                  local damping of the MPM, on the last change a of the motion
    basal    = -m v* / sqrt(|v*|^2 + m^2) / g dt^2,      m = min(mu, tan(phi)) g_n dt^2
                                                         mu of a ground + |v|^2 / (xi h), Voellmy's turbulence
    strength = r / (1 + r),  r = c / (rho g (h + cell))  cohesion over the weight h of the column above
    together = strength (v_r - v_b) / g dt^2,            v_b = v + (g_t + basal g) dt^2

The basal friction is that of a layer which slides as a whole (Savage & Hutter, J. Fluid Mech. 199, 1989, eq. 2.21): its
friction on the floor or the ground or, if rougher, within itself. It acts on the displacement v* along the floor or
ground that gravity alone would cause, and at most stops it. Cohesive material holds together, so that it moves as a
rigid body rather than by the displacement v_b of single columns: v_r is the rigid motion U + omega x r nearest to v_b
by least squares, with volume times strength as weights; it has the same momentum and the same angular momentum. On the
background grid, shearing sand carries a stress of
its strength along its rate of strain (von Mises' flow rule, e.g. Jop, Forterre & Pouliquen, Nature 441, 2006, eq. 2,
without rate dependence), besides the pressure p = rho g h of the column above:

    pressure = -grad p / (rho g)
    shear    = div S / (rho g),   S = (c + p tan(phi)) D' / (|D'| + d0),   |D'| = sqrt(D' : D' / 2)

with the deviatoric rate of strain D' [1 per step]. On such coarse cells both are rough estimates.

| symbol | variable                          | meaning                                            |
| w_s    | 1 - distance / radius, at least 0 | how near the surface is                            |
| v      | `velocity`                        | newest displacement [m per step]                   |
| v0     | `slow`                            | displacement below which the direction fades       |
| g_n    | `normal`                          | gravity against the floor                          |
| g_t    | `fall` along it                   | gravity along the floor or the ground              |
| h      | `above`                           | height of the column above [m]                     |
| d0     | `slow` over the cell              | rate of strain below which the shear fades         |
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from gns.settings import GRAVITY, UP, ModelSettings
from gns.surroundings.grid import CHANNELS, REFERENCE_HEIGHT, Stencil, stencil_of
from gns.surroundings.solids import Below, solid_features, upward
from gns.surroundings.state import Conditions, State, computed

FORCES = ("basal friction", "traction", "damping", "shear", "pressure", "cohesion")  # the network gives coefficients
SLOW = 0.1  # displacement over the root mean square one below which the direction of motion fades [-]
ROUNDED = 0.1  # change of the motion over `slow` below which its size is rounded: a kink has no useful derivative [-]
EMPTY = 0.05  # filled share of a cell below which the mean of its content fades [-]
LOOSE = 0.3  # filled share of a cell below which a force counts as acting on this share of material [-]
SMOOTHED = 2  # number of means over three nodes along each horizontal axis that smooth the height of a column
UNEVEN = {2: 1.06, 3: 1.0}  # steepest tangent of such heights over that of a plane slope; in 3D smoothing removes it
LARGEST = 3.0  # upper limit of a force on the grid, over the weight of the material [-]


@dataclass(frozen=True, kw_only=True)
class Normalisation:
    """Statistics of the training data at the model's step, as numbers or as a model's tensors."""

    displacement_scale: float | Tensor = 1.0  # root mean square displacement of a particle in a step [m]
    acceleration_scale: float | Tensor = 1.0  # root mean square change of it per step, without gravity's [m]
    friction_mean: float | Tensor = 0.0  # mean of tan(phi) [-]
    friction_std: float | Tensor = 1.0  # standard deviation of tan(phi) [-]


class Moment:
    """N particles at one moment, in the units of the model; each property is computed on first access."""

    def __init__(self, state: State, conditions: Conditions, settings: ModelSettings, scales: Normalisation) -> None:
        self.state, self.conditions, self.settings, self.normalisation = state, conditions, settings, scales
        self.velocity = state.displacements[-1]
        self.changes = state.displacements[1:] - state.displacements[:-1]
        self.slow = torch.as_tensor(SLOW * scales.displacement_scale)
        self.weight = settings.density * GRAVITY
        self.fall = GRAVITY * settings.step**2
        self.drag = None if conditions.ground is None else conditions.ground.drag

    @cached_property
    def solids(self) -> Tensor:
        """`solid_features`, shape [N, 3 D + 2]; Voellmy's turbulence counts as friction of a nearby bed."""
        nearby = solid_features(self.state.positions, self.conditions, self.settings.radius)
        if self.drag is None:
            return nearby
        near = 1.0 - nearby[:, -self.settings.dimension - 2]
        return torch.cat((nearby[:, :-1], (nearby[:, -1] + near * self.turbulence).unsqueeze(1)), dim=1)

    @cached_property
    def turbulence(self) -> Tensor:
        """Voellmy's turbulence of the ground as a coefficient of friction, |v|^2 / (xi h) [-], shape [N]. Its traction
        rho g |v|^2 / xi over the pressure rho g h of the column of height h (Salm 1993)."""
        if self.drag is None:
            return torch.zeros_like(self.velocity[:, 0])
        square = self.velocity.square().sum(dim=1) / self.settings.step**2
        height = REFERENCE_HEIGHT * self.column[:, 2] + self.settings.cell
        return (self.below.value(self.drag) * square / height).clamp(max=LARGEST)

    @cached_property
    def below(self) -> Below:
        """The places of the particles on the raster of the ground, if there is one."""
        assert self.conditions.ground is not None
        return Below(self.state.positions, self.conditions.ground, self.conditions.batch)

    @cached_property
    def bed(self) -> Tensor:
        """Coulomb coefficient of the floor or of the ground above it, below each particle [-], shape [N or 1]. Nothing
        touches a floor that terrain covers, so its own friction has no effect; in the training data both are equal."""
        ground, floor = self.conditions.ground, self.conditions.of_particles(self.conditions.floor_friction)
        if ground is None:
            return floor
        # The ground is nowhere lower than the floor, but for samples of a batch that have none.
        return torch.where(self.below.value(ground.elevation) >= 0.0, self.below.value(ground.friction), floor)

    @cached_property
    def stencil(self) -> Stencil:
        return stencil_of(self.state.positions, self.conditions.size, self.settings.grid_cell, self.conditions.batch)

    @cached_property
    def nodes(self) -> Tensor:
        """Channels of the nodes of the grid, shape [B * nodes, columns of `CHANNELS`]."""
        return computed(CHANNELS, self.stencil, self.conditions)

    @cached_property
    def column(self) -> Tensor:
        """These channels at the particles, shape [N, columns of `CHANNELS`]."""
        return self.stencil.gather(self.nodes)

    @property
    def forces(self) -> Tensor:
        """`FORCES` over the weight of the particles [-], shape [N, K, D]."""
        shear, pressure = self.internal.chunk(2, dim=1)
        return torch.stack((self.basal, self.traction, self.damped, shear, pressure, self.together), dim=1)

    @cached_property
    def traction(self) -> Tensor:
        """Friction of the surfaces [-], shape [N, D]."""
        conditions, dimension = self.conditions, self.settings.dimension
        floor = self.bed.unsqueeze(1)
        wall = conditions.of_particles(conditions.wall_friction).unsqueeze(1)
        lower, upper = (1.0 - self.solids[:, : 2 * dimension]).chunk(2, dim=1)
        direction, friction = self.solids[:, -dimension - 1 : -1], self.solids[:, -1:]
        axes = torch.arange(dimension, device=direction.device)
        near = torch.where(axes == UP, floor, wall) * lower + wall * upper
        along = self.velocity.unsqueeze(1) * (axes != axes.unsqueeze(1))
        of_walls = (near.unsqueeze(2) * self.unit(along)).sum(dim=1)
        square = direction.square().sum(dim=1, keepdim=True)
        normal = direction / torch.where(square > 0.0, square, 1.0).sqrt()
        along = self.velocity - (self.velocity * normal).sum(dim=1, keepdim=True) * normal
        return -of_walls - friction * self.unit(along)

    @cached_property
    def damping(self) -> Tensor:
        """The coefficient of damping against the motion [-], shape [N, D]."""
        return -self.conditions.of_particles(self.conditions.damping).unsqueeze(1) * self.unit(self.velocity)

    @cached_property
    def damped(self) -> Tensor:
        """Local damping [-], shape [N, D]."""
        change = self.changes[-1] if len(self.changes) else torch.zeros_like(self.velocity)
        size = (change.square().sum(dim=1, keepdim=True) + (ROUNDED * self.slow) ** 2).sqrt()
        return self.damping * size / self.fall

    @cached_property
    def upwards(self) -> Tensor:
        """Normal of the floor or of the ground below each particle, shape [N or 1, D]."""
        if self.conditions.ground is not None and self.settings.bed_friction:
            return upward(self.below.value_and_slope(self.conditions.ground.elevation)[1])
        upwards = torch.zeros_like(self.velocity[:1])
        upwards[:, UP] = 1.0
        return upwards

    @cached_property
    def basal(self) -> Tensor:
        """Basal friction [-], shape [N, D]; along a ground with its own friction and Voellmy's turbulence."""
        conditions, velocity, upwards = self.conditions, self.velocity, self.upwards
        gravity = conditions.of_particles(conditions.gravity) * self.settings.step**2
        trial, friction = velocity + gravity, self.bed
        if conditions.ground is not None and self.settings.bed_friction:
            friction = friction + self.turbulence
        trial = trial - (trial * upwards).sum(dim=1, keepdim=True) * upwards
        normal = -(gravity * upwards).sum(dim=1)
        most = (torch.minimum(friction, conditions.friction) * normal.clamp(min=0.0)).unsqueeze(1)
        # So that the root has a slope at zero on a smooth floor, too.
        size = (trial.square().sum(dim=1, keepdim=True) + most.square() + (1.0e-3 * self.slow) ** 2).sqrt()
        return -most * trial / size / self.fall

    @cached_property
    def strength(self) -> Tensor:
        """Cohesion against the weight of the column above [-], shape [N, 1]."""
        ratio = self.conditions.cohesion / (self.weight * (REFERENCE_HEIGHT * self.column[:, 1] + self.settings.cell))
        return (ratio / (1.0 + ratio)).unsqueeze(1)

    @cached_property
    def together(self) -> Tensor:
        """What keeps cohesive material together [-], shape [N, D]; 0 without cohesion."""
        conditions, x = self.conditions, self.state.positions
        if not bool((conditions.cohesion > 0.0).any()):
            return torch.zeros_like(x)
        gravity = conditions.of_particles(conditions.gravity) / GRAVITY
        along = gravity - (gravity * self.upwards).sum(dim=1, keepdim=True) * self.upwards
        weight = conditions.volume.unsqueeze(1) * self.strength
        moved = self.velocity + self.fall * (along + self.basal)
        apart = from_rigid(x, moved, weight, conditions, self.settings.cell)
        return LARGEST * torch.tanh(self.strength * apart / (LARGEST * self.fall))

    @cached_property
    def internal(self) -> Tensor:
        """Shear, then pressure [-], shape [N, 2 D]; walls carry no shear here, which is part of the traction."""
        stencil, conditions, dimension = self.stencil, self.conditions, self.settings.dimension
        cell, shape, axes = stencil.cell, (stencil.samples, *stencil.shape), range(dimension)
        above = REFERENCE_HEIGHT * self.nodes[:, 1]
        strengths = torch.stack((conditions.friction, conditions.cohesion / self.weight), dim=1)
        carried = torch.cat((torch.ones_like(strengths[:, :1]), self.velocity, strengths), dim=1)
        sums = stencil.scatter((conditions.volume / cell**dimension).unsqueeze(1) * carried)
        filled, means = sums[:, :1], sums[:, 1:] / (sums[:, :1] + EMPTY)
        # Strength over rho g is a length.
        strength = means[:, dimension + 1] + above * means[:, dimension]
        fields = torch.cat((means[:, :dimension], strength.unsqueeze(1), above.unsqueeze(1)), dim=1).view(*shape, -1)
        fields = stencil.within(fields, conditions.size, axes)
        gradient = [torch.gradient(fields, spacing=cell, dim=axis + 1)[0] for axis in axes]
        mean = sum(gradient[axis][..., axis] for axis in axes) / dimension
        pairs = [(i, j) for i in axes for j in range(i, dimension)]
        rate = {(i, j): 0.5 * (gradient[j][..., i] + gradient[i][..., j]) - (mean if i == j else 0) for i, j in pairs}
        square = sum((1.0 if i == j else 2.0) * part.square() for (i, j), part in rate.items())
        # Not the root alone, which has no slope at zero.
        slow = self.slow / cell
        scale = fields[..., dimension] / ((0.5 * square + slow**2).sqrt() + slow)
        stress = stencil.within(torch.stack([scale * part for part in rate.values()], dim=-1), conditions.size, axes)
        slopes = [torch.gradient(stress, spacing=cell, dim=axis + 1)[0] for axis in axes]
        terms = [[slopes[j][..., pairs.index((min(i, j), max(i, j)))].reshape(-1) for j in axes] for i in axes]
        shear = torch.stack([torch.stack(row).sum(dim=0) for row in terms], dim=1) / filled.clamp(min=LOOSE)
        pressure = -torch.stack([gradient[axis][..., dimension + 1].reshape(-1) for axis in axes], dim=1)
        return stencil.gather(LARGEST * torch.tanh(torch.cat((shear, pressure), dim=1) / LARGEST))

    def stands(self) -> Tensor:
        """Whether each flow can stay at rest: no known law sets it in motion; bool, shape [B, 1].

            tan(a_s) <= tan(phi),    tan(a_b) + K |grad h| <= min(mu, tan(phi)),    K = (1 - sin(phi)) / (1 + sin(phi))

        for the inclinations a_s of the surface and a_b of the bed against the horizontal below every particle: limit
        equilibrium of an infinite slope, and of a column on its bed between active pressures (Rankine 1857). Column
        heights h are smoothed over neighbouring nodes, so that single particles cause no slope; steepness keeps a
        scatter of `UNEVEN`.
        """
        conditions, stencil, level = self.conditions, self.stencil, [*range(0, self.settings.dimension, 2)]
        height = REFERENCE_HEIGHT * self.nodes[:, 2].view(stencil.samples, *stencil.shape)
        for axis in level * SMOOTHED:
            height = stencil.within(height, conditions.size, level)
            height = 0.5 * height + 0.25 * (height.roll(1, axis + 1) + height.roll(-1, axis + 1))
        height = stencil.within(height, conditions.size, level)
        slopes = [torch.gradient(height, spacing=stencil.cell, dim=axis + 1)[0] for axis in level]
        slope = stencil.gather(torch.stack(slopes, dim=-1).flatten(0, -2))
        friction, bed = conditions.friction, torch.zeros_like(slope)
        if conditions.ground is not None:
            bed = self.below.value_and_slope(conditions.ground.elevation)[1]
        sine = friction / (1.0 + friction.square()).sqrt()
        thrust = (1.0 - sine) / (1.0 + sine) * slope.norm(dim=1)
        gravity = conditions.of_particles(conditions.gravity)
        slips = inclination(bed, gravity) + thrust > torch.minimum(self.bed, friction)
        slips |= inclination(bed + slope, gravity) > UNEVEN[self.settings.dimension] * friction
        return conditions.total(slips.to(slope).unsqueeze(1)) == 0.0

    def unit(self, vectors: Tensor) -> Tensor:
        """Directions of vectors [..., D]; they fade for vectors shorter than `slow`."""
        return vectors / (vectors.square().sum(dim=-1, keepdim=True) + self.slow**2).sqrt()


def from_rigid(x: Tensor, v: Tensor, weight: Tensor, conditions: Conditions, cell: float) -> Tensor:
    """v_r - v, with v_r = U + omega x r nearest to v in each sample; x, v: [N, D]; weight: [N, 1]; cell: the size of
    the smallest body that turns [m].

        sum w r x v = I omega,    I = sum w (|r|^2 + cell^2 - r r^T),    r = x - <x>    (Goldstein 2002, section 5.3)
    """
    least = torch.finfo(x.dtype).tiny  # samples without cohesion have no weight
    weight = weight / conditions.of_particles(conditions.total(weight).clamp(min=least))
    x, v = (values - conditions.of_particles(conditions.total(weight * values)) for values in (x, v))
    square = conditions.total(weight * x.square().sum(dim=1, keepdim=True)) + cell**2
    if x.shape[1] == 2:
        moment = conditions.total(weight * (x[:, :1] * v[:, 1:] - x[:, 1:] * v[:, :1]))
        spin = conditions.of_particles(moment / square)
        return torch.cat((-spin * x[:, 1:], spin * x[:, :1]), dim=1) - v
    products = conditions.total(weight * (x.unsqueeze(2) * x.unsqueeze(1)).flatten(1)).view(-1, 3, 3)
    inertia = square.unsqueeze(2) * torch.eye(3).to(x) - products
    spin = torch.linalg.solve(inertia, conditions.total(weight * torch.linalg.cross(x, v)))
    return torch.as_tensor(torch.linalg.cross(conditions.of_particles(spin).expand_as(x), x) - v)


def inclination(slope: Tensor, gravity: Tensor) -> Tensor:
    """Tangent of the angle of planes of this slope [N, D - 1] against the horizontal [-], shape [N]."""
    down = -(upward(slope) * gravity).sum(dim=1)
    along = (gravity.square().sum(dim=1) - down.square()).clamp(min=0.0).sqrt()
    return torch.where(down > 0.0, along / down, math.inf)
