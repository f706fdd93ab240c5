"""The simulator: one step of a granular flow, learned."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gns.model.context import channels
from gns.model.graph import radius_graph
from gns.model.grid import UP, column_features, stencil_of
from gns.model.network import Network
from gns.model.settings import ModelSettings
from gns.model.solids import feature_count, keep_out, occupancy, solid_features
from gns.model.state import Conditions, State

MATERIAL = 2
"""Features of the material of a particle: friction and cohesion."""
REFERENCE_COHESION = 1000.0
"""Scale of the logarithm of the cohesion [Pa], about the weight of 6 cm of sand."""


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


class Simulator(nn.Module):
    """x(t + dt) from x(t) and the last displacements.

        a  = g dt^2 + s A(state)         acceleration; gravity is known, the contact forces are learned
        v' = v + a                       displacement in the coming step (semi-implicit Euler)
        x' = keep_out(x + v')            walls and baffles are impenetrable; what remains of v' is x' - x
        v' <- v' r^2 / (1 + r^2)         r = |v'| / (rest_speed dt): static friction

    | symbol | variable                                | unit             |
    | A      | `Network`                               | -                |
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
        # displacements and their changes; solids; volume; material; the grid's surroundings
        motion = settings.history + (settings.history - 1 if settings.past_accelerations else 0)
        solids = feature_count(dimension, settings.baffles)
        self.network = Network(motion * dimension + solids + 1 + MATERIAL + channels(settings), MATERIAL, settings)

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step. Differentiable in the state, in friction, cohesion, volume and the corners of the baffles."""
        settings, positions = self.settings, state.positions
        graph = radius_graph(positions, settings.radius, conditions.batch)
        stencil = stencil_of(positions, conditions.size, settings.grid_cell, conditions.batch, conditions.samples)
        nodes = column_features(stencil, conditions.volume)
        if settings.baffles:
            covered = occupancy(
                stencil.shape,
                stencil.cell,
                conditions.size,
                conditions.baffles,
                conditions.samples,
                like=nodes,
            )
            nodes = torch.cat((nodes, covered), dim=1)
        fraction = (conditions.volume / settings.grid_cell**settings.dimension).unsqueeze(1)
        material = self._material(conditions)
        features = self._features(state, conditions, material, stencil.gather(nodes))
        contact = self.acceleration_scale * self.network(features, material, graph, stencil, fraction, nodes)
        fall = torch.zeros_like(positions[0])
        fall[UP] = -conditions.gravity * settings.step**2
        moved = positions + state.displacements[-1] + contact + fall
        baffles = conditions.baffles if settings.baffles else None
        stopped = keep_out(moved, positions, conditions.size, baffles, conditions.batch)
        if settings.rest_speed > 0.0:
            stopped = positions + settled(stopped - positions, settings.rest_speed * settings.step)
            if baffles is not None:
                # A shortened displacement around a corner may end inside the baffle.
                stopped = keep_out(stopped, positions, conditions.size, baffles, conditions.batch)
        displacements = torch.cat((state.displacements[1:], (stopped - positions).unsqueeze(0)))
        return State(positions=stopped, displacements=displacements)

    def _material(self, conditions: Conditions) -> Tensor:
        """Features of the material [N, MATERIAL]."""
        friction = (conditions.friction - self.friction_mean) / self.friction_std
        return torch.stack((friction, (conditions.cohesion / REFERENCE_COHESION).log1p()), dim=1)

    def _features(self, state: State, conditions: Conditions, material: Tensor, column: Tensor) -> Tensor:
        """Node features [N, F]; column: `column_features` at the particles."""
        settings = self.settings
        motion = state.displacements / self.displacement_scale
        if settings.past_accelerations:
            changes = state.displacements[1:] - state.displacements[:-1]
            motion = torch.cat((motion, changes / self.acceleration_scale))
        solids = solid_features(
            state.positions,
            conditions.size,
            conditions.baffles,
            conditions.batch,
            settings.radius,
            with_baffles=settings.baffles,
        )
        return torch.cat(
            (
                motion.movedim(0, 1).flatten(1),
                solids,
                (conditions.volume / settings.particle_volume).unsqueeze(1) - 1.0,
                material,
                column,
            ),
            dim=1,
        )


def settled(displacements: Tensor, limit: float) -> Tensor:
    """Displacements [m], shape [N, D], of which those well below `limit` [m] fade.

    A model of static friction: small errors of the acceleration no longer add up to an endless creep. Sand that begins
    to move exceeds the limit after one step, unless its acceleration is below limit / dt^2.
    """
    square = displacements.square().sum(dim=1, keepdim=True) / limit**2
    return displacements * (square / (1.0 + square))
