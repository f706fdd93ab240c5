"""The simulator: one step of a granular flow, learned."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gns.model import rheology, traction
from gns.model.context import channels
from gns.model.graph import radius_graph
from gns.model.grid import REFERENCE_HEIGHT, UP, Stencil, column_features, stencil_of
from gns.model.network import Network
from gns.model.occupancy import occupancy
from gns.model.rheology import internal_forces
from gns.model.settings import GRAVITY, ModelSettings
from gns.model.solids import feature_count, keep_out, solid_features
from gns.model.state import Conditions, State
from gns.model.traction import basal_friction, damped_motion, traction_features

SLOW = 0.1
"""Displacement over the root mean square one below which the direction of motion fades from the features [-]."""
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

    displacement: float
    """Root mean square displacement of a particle in a step [m]."""
    acceleration: float
    """Root mean square change of the displacement from step to step, without that of gravity [m]."""
    friction_mean: float
    """Mean of tan(phi) [-]."""
    friction_std: float
    """Standard deviation of tan(phi) [-]."""


def conditions_count(dimension: int) -> int:
    """Features of what is constant for a particle: friction, cohesion, floor, walls, damping, direction of gravity."""
    return 5 + dimension


class Simulator(nn.Module):
    """x(t + dt) from x(t) and the last displacements.

        a  = g dt^2 + s A(state) + g dt^2 sum_k c_k(state) F_k
                                         acceleration; gravity is known, the contact forces are learned
        v' = v + a                       displacement in the coming step (semi-implicit Euler)
        x' = keep_out(x + v')            walls, ground and baffles are impenetrable; what remains of v' is x' - x
        v' <- v' r^4 / (1 + r^4)         r = |v'| / (rest_speed dt): static friction

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

    def __init__(self, settings: ModelSettings, normalisation: Normalisation) -> None:
        super().__init__()
        self.settings = settings
        for name, value in (
            ("displacement_scale", normalisation.displacement),
            ("acceleration_scale", normalisation.acceleration),
            ("friction_mean", normalisation.friction_mean),
            ("friction_std", normalisation.friction_std),
        ):
            self.register_buffer(name, torch.tensor(value, dtype=torch.get_default_dtype()))
        dimension = settings.dimension
        # displacements and their changes; solids; volume; what is constant; the grid's surroundings
        motion = (2 * settings.history - 1) * dimension
        constant = conditions_count(dimension)
        contact = feature_count(dimension) + traction.count(dimension)
        grid = channels(settings) + rheology.count(dimension)
        features = motion + contact + 2 + constant + grid + traction.sliding_count(dimension)
        self.network = Network(features, constant, FORCES, settings)

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step, all of it in the units of the model. Differentiable in the state and in all conditions."""
        return self.moved(state, conditions, self.contact(*self.hidden(state, conditions)))

    def hidden(self, state: State, conditions: Conditions) -> tuple[Tensor, Tensor]:
        """Inputs h of the network's last layer [N, H], and the known forces F over the weight [N, K, D]."""
        settings, positions = self.settings, state.positions
        graph = radius_graph(positions, settings.radius, conditions.batch)
        stencil = stencil_of(positions, conditions.size, settings.grid_cell, conditions.batch)
        columns = column_features(stencil, conditions.volume, conditions.size)
        nodes = torch.cat((columns, occupancy(stencil, conditions)), dim=1)
        fraction = (conditions.volume / settings.grid_cell**settings.dimension).unsqueeze(1)
        constant = self._constant(conditions)
        features, forces = self._features(state, conditions, constant, stencil, nodes)
        return self.network(features, constant, graph, stencil, fraction, nodes), forces

    def contact(self, hidden: Tensor, forces: Tensor) -> Tensor:
        """Acceleration by contacts, s A + g dt^2 sum_k c_k F_k [m per step^2], shape [N, D]."""
        own, shares = self.network.decoder.last(hidden).split((self.settings.dimension, FORCES), dim=1)
        known = (shares.unsqueeze(1) @ forces).squeeze(1)
        return torch.as_tensor(self.acceleration_scale * own + GRAVITY * self.settings.step**2 * known)

    def flown(self, state: State, conditions: Conditions, contact: Tensor) -> Tensor:
        """x + v': where particles of these accelerations would be without solids [m], shape [N, D]."""
        fall = conditions.of_particles(conditions.gravity) * self.settings.step**2
        return state.positions + state.displacements[-1] + contact + fall

    def moved(self, state: State, conditions: Conditions, contact: Tensor) -> State:
        """The state after a step under these accelerations, outside of all solids."""
        settings, positions = self.settings, state.positions
        stopped = keep_out(self.flown(state, conditions, contact), positions, conditions)
        if settings.rest_speed > 0.0:
            stopped = positions + settled(stopped - positions, settings.rest_speed * settings.step)
            if conditions.baffles is not None or conditions.ground is not None:
                # A shortened displacement around a corner may end inside the baffle.
                stopped = keep_out(stopped, positions, conditions)
        displacements = torch.cat((state.displacements[1:], (stopped - positions).unsqueeze(0)))
        return State(positions=stopped, displacements=displacements)

    def _constant(self, conditions: Conditions) -> Tensor:
        """Features of the material and the surroundings of each particle [N, `conditions_count`]."""
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
        settings, weight, slow = self.settings, self.settings.density * GRAVITY, SLOW * self.displacement_scale
        column = stencil.gather(nodes)
        changes = state.displacements[1:] - state.displacements[:-1]
        motion = torch.cat((state.displacements / self.displacement_scale, changes / self.acceleration_scale))
        solids = solid_features(state.positions, conditions, settings.radius)
        tractions = traction_features(
            state.positions,
            state.displacements[-1],
            solids[:, -(settings.dimension + 1) :],
            conditions,
            cutoff=settings.radius,
            slow=slow,
        )
        strong = traction.strength(
            conditions.cohesion,
            REFERENCE_HEIGHT * column[:, 1],
            weight=weight,
            cell=settings.cell,
        )
        internal = internal_forces(
            stencil,
            state.displacements[-1],
            conditions.volume,
            conditions.friction,
            conditions.cohesion / weight,
            REFERENCE_HEIGHT * nodes[:, 1],
            conditions.size,
            slow,
        )
        axes = settings.dimension
        basal = basal_friction(state.displacements[-1], conditions, step=settings.step, slow=slow)
        damped = damped_motion(tractions[:, axes:], state.displacements, step=settings.step, slow=slow)
        features = torch.cat(
            (
                motion.movedim(0, 1).flatten(1),
                solids,
                (conditions.volume / settings.particle_volume).unsqueeze(1) - 1.0,
                constant,
                column,
                tractions,
                strong,
                internal,
                basal,
                damped,
            ),
            dim=1,
        )
        forces = (basal, tractions[:, :axes], damped, internal[:, :axes], internal[:, axes:])
        return features, torch.stack(forces, dim=1)


def settled(displacements: Tensor, limit: float) -> Tensor:
    """Displacements [m], shape [N, D], of which those well below `limit` [m] fade.

    A model of static friction: small errors of the acceleration no longer add up to an endless creep. Sand that begins
    to move exceeds the limit after one step, unless its acceleration is below limit / dt^2. The fourth power leaves
    of a tenth of the limit a ten-thousandth, and takes a sixteenth of twice the limit.
    """
    fourth = (displacements.square().sum(dim=1, keepdim=True) / limit**2).square()
    return displacements * (fourth / (1.0 + fourth))
