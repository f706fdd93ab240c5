"""The simulator: one step of a granular flow, learned."""

import dataclasses
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gns.contact import keep_out
from gns.correction import Correction
from gns.features import basal_friction, damped_motion, internal_forces, strength, traction_features
from gns.graph import radius_graph
from gns.grid import REFERENCE_HEIGHT, Stencil, column_features, occupancy, stencil_of
from gns.network import Inputs, Network
from gns.settings import GRAVITY, UP, ModelSettings, constant_count, features
from gns.solids import solid_features
from gns.state import Conditions, State

SLOW = 0.1
"""Displacement over the root mean square one below which the direction of motion fades from the features [-]."""
AT_REST = 0.2
"""Root mean square speed of a deposit at rest over the speed of rest, at most [-]."""
FORCES = 5
"""Known forces: basal friction, traction, damping, shear and pressure on the grid."""
DAMPING = 5.0
"""Factor that brings the coefficient of damping to the size of the other features [-]."""
ROUGHNESS = (0.45, 0.27)
"""Mean and standard deviation to which the friction of floor and walls is normalised [-]."""
INCLINED = 4.0
"""Factor that brings gravity along the floor to the size of the other features [-]."""
REFERENCE_COHESION = 50.0
"""Scale of the logarithm of the cohesion [Pa], about the weight of 3 mm of sand: a thin front that has any does not run
as far as a dry one."""


@dataclass(frozen=True, kw_only=True)
class Normalisation:
    """Statistics of the training data at the model's step."""

    displacement_scale: float
    """Root mean square displacement of a particle in a step [m]."""
    acceleration_scale: float
    """Root mean square change of the displacement from step to step, without that of gravity [m]."""
    friction_mean: float
    """Mean of tan(phi) [-]."""
    friction_std: float
    """Standard deviation of tan(phi) [-]."""


class Simulator(nn.Module):
    """x(t + dt) from x(t) and the last displacements.

        a  = g dt^2 + s A(state) + g dt^2 sum_k c_k(state) F_k
                                         acceleration; gravity is known, the contact forces are learned
        v' = v + a                       displacement in the coming step (semi-implicit Euler)
        x' = keep_out(x + v')            walls, ground and baffles are impenetrable; what remains of v' is x' - x
        v' <- v' r^4 / (1 + r^4)         r = |v'| / (rest_speed dt): static friction
        v' <- 0                          in a flow that is at rest (`moving`), but not while training

    | symbol | variable                                | unit             |
    | A, c   | `Network`                               | -                |
    | F      | `_features`: basal friction, traction, damping, shear and pressure on the grid, over the weight | - |
    | s      | `acceleration_scale`                    | m per step^2     |
    | v, v'  | `State.displacements[-1]`, before, after | m per step       |

    Absolute positions are no features: offsets to neighbours, distances to walls and baffles within the cutoff radius,
    and the column on the background grid are.
    """

    displacement_scale: Tensor
    acceleration_scale: Tensor
    friction_mean: Tensor
    friction_std: Tensor

    def __init__(self, settings: ModelSettings, normalisation: Normalisation, *, corrected: bool = False) -> None:
        """corrected: with a correction of its rollouts."""
        super().__init__()
        self.settings = settings
        for name, value in dataclasses.asdict(normalisation).items():
            self.register_buffer(name, torch.tensor(value, dtype=torch.get_default_dtype()))
        count = sum(features(settings).values())
        self.network = Network(count, constant_count(settings.dimension), FORCES, settings)
        self.correction = Correction(settings) if corrected else None

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step, all of it in the units of the model. Differentiable in the state and in all conditions."""
        settings, positions = self.settings, state.positions
        inputs, forces = self.inputs(state, conditions)
        outputs = self.network(inputs)
        own, shares = outputs.split((settings.dimension, FORCES), dim=1)
        known = (shares.unsqueeze(1) @ forces).squeeze(1)
        contact = self.acceleration_scale * own + GRAVITY * settings.step**2 * known
        fall = conditions.of_particles(conditions.gravity) * settings.step**2
        stopped = keep_out(positions + state.displacements[-1] + contact + fall, positions, conditions)
        if settings.rest_speed > 0.0:
            limit = settings.rest_speed * settings.step
            moved = settled(stopped - positions, limit)
            stopped = positions + (moved if self.training else moved * moving(moved, AT_REST * limit, conditions))
            if conditions.baffles is not None or conditions.ground is not None:
                # A shortened displacement around a corner may end inside the baffle.
                stopped = keep_out(stopped, positions, conditions)
        displacements = torch.cat((state.displacements[1:], (stopped - positions).unsqueeze(0)))
        return State(positions=stopped, displacements=displacements)

    def end_correction(self, start: State, end: State, conditions: Conditions) -> Tensor:
        """By how much its correction moves the end of a rollout [m], shape [N, D], all in units of the model."""
        assert self.correction is not None
        return torch.as_tensor(self.correction(start, end, self.inputs(end, conditions)[0], conditions))

    def inputs(self, state: State, conditions: Conditions) -> tuple[Inputs, Tensor]:
        """What the networks are given of a state, and known forces over the weight [N, K, D]."""
        settings, positions = self.settings, state.positions
        stencil = stencil_of(positions, conditions.size, settings.grid_cell, conditions.batch)
        columns = column_features(stencil, conditions.volume, conditions.size)
        nodes = torch.cat((columns, occupancy(stencil, conditions)), dim=1)
        constant = self._constant(conditions)
        features, forces = self._features(state, conditions, constant, stencil, nodes)
        inputs = Inputs(
            features=features,
            constant=constant,
            graph=radius_graph(positions, settings.radius, conditions.batch),
            stencil=stencil,
            fraction=(conditions.volume / settings.grid_cell**settings.dimension).unsqueeze(1),
            nodes=nodes,
        )
        return inputs, forces

    def _constant(self, conditions: Conditions) -> Tensor:
        """Features of the material and the surroundings of each particle [N, M]."""
        count = len(conditions.friction)
        mean, spread = ROUGHNESS
        rough = (torch.stack((conditions.floor_friction, conditions.wall_friction), dim=1) - mean) / spread
        inclined = conditions.gravity.new_full((self.settings.dimension,), INCLINED / GRAVITY)
        inclined[UP] = 1.0 / GRAVITY
        damping = DAMPING * conditions.damping.unsqueeze(1)
        surroundings = torch.cat((rough, damping, inclined * conditions.gravity), dim=1)
        friction = (conditions.friction - self.friction_mean) / self.friction_std
        cohesion = 0.5 * (conditions.cohesion / REFERENCE_COHESION).log1p()
        own = torch.stack((friction, cohesion), dim=1)
        return torch.cat((own, conditions.of_particles(surroundings).expand(count, -1)), dim=1)

    def _features(
        self, state: State, conditions: Conditions, constant: Tensor, stencil: Stencil, nodes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Node features [N, F], and known forces over the weight [N, K, D]; nodes: the grid's inputs."""
        settings, axes, slow = self.settings, self.settings.dimension, SLOW * self.displacement_scale
        weight, velocity, column = settings.density * GRAVITY, state.displacements[-1], stencil.gather(nodes)
        changes = state.displacements[1:] - state.displacements[:-1]
        solids = solid_features(state.positions, conditions, settings.radius)
        nearest = solids[:, -(axes + 1) :]
        tractions = traction_features(state.positions, velocity, nearest, conditions, cutoff=settings.radius, slow=slow)
        above = REFERENCE_HEIGHT * nodes[:, 1]
        internal = internal_forces(stencil, velocity, above, conditions, weight=weight, slow=slow)
        basal = basal_friction(velocity, conditions, step=settings.step, slow=slow)
        damped = damped_motion(tractions[:, axes:], state.displacements, step=settings.step, slow=slow)
        strong = strength(conditions.cohesion, REFERENCE_HEIGHT * column[:, 1], weight=weight, cell=settings.cell)
        found = {
            "past displacements": (state.displacements / self.displacement_scale).movedim(0, 1).flatten(1),
            "their changes": (changes / self.acceleration_scale).movedim(0, 1).flatten(1),
            "solids within the radius": solids,
            "volume": (conditions.volume / settings.particle_volume).unsqueeze(1) - 1.0,
            "friction, cohesion, floor, walls, damping, gravity": constant,
            "column on the grid": column,
            "tractions of surfaces and damping": tractions,
            "cohesion over the weight above": strong,
            "forces of pressure and internal friction": internal,
            "basal friction and damped motion": torch.cat((basal, damped), dim=1),
        }
        forces = (basal, tractions[:, :axes], damped, internal[:, :axes], internal[:, axes:])
        return torch.cat([found[name] for name in features(settings)], dim=1), torch.stack(forces, dim=1)


def moving(displacements: Tensor, limit: float, conditions: Conditions) -> Tensor:
    """1 for particles of flows whose displacements [m], [N, D], are above `limit` [m] (rms), else 0; shape [N or 1, 1].

    Below it the deposit is at rest, as a run of the MPM ends where its kinetic energy is small: what remains are errors
    of the acceleration. Positions that rest have the gradient of those before.
    """
    square = displacements.detach().square().sum(dim=1, keepdim=True)
    return conditions.of_particles((conditions.total(square - limit**2) > 0.0).to(square))


def settled(displacements: Tensor, limit: float) -> Tensor:
    """Displacements [m], shape [N, D], of which those well below `limit` [m] fade.

    A model of static friction: small errors of the acceleration no longer add up to an endless creep. Sand that begins
    to move exceeds the limit after one step, unless its acceleration is below limit / dt^2. The fourth power leaves
    of a tenth of the limit a ten-thousandth, and takes a sixteenth of twice the limit.
    """
    fourth = (displacements.square().sum(dim=1, keepdim=True) / limit**2).square()
    return displacements * (fourth / (1.0 + fourth))
