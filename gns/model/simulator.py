"""The simulator: one step of a granular flow, learned."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gns.model.context import channels
from gns.model.graph import Search, radius_graph
from gns.model.grid import UP, stencil, surroundings
from gns.model.network import Network
from gns.model.settings import ModelSettings
from gns.model.solids import feature_count, features, keep_out, occupancy
from gns.model.state import Conditions, State

MATERIAL = 2
"""Numbers that describe the material of a point: friction and cohesion."""
REFERENCE_COHESION = 1000.0
"""Cohesion [Pa] above which the network sees its logarithm, about the weight of 6 cm of sand."""


@dataclass(frozen=True, kw_only=True)
class Normalisation:
    """Statistics of the training data at the model's step."""

    displacement: float
    """Root mean square displacement of a point in a step [m]."""
    acceleration: float
    """Root mean square change of the displacement from step to step, gravity taken out [m]."""
    friction_mean: float
    """Mean of tan(phi) [-]."""
    friction_std: float
    """Standard deviation of tan(phi) [-]."""


class Simulator(nn.Module):
    """x(t + dt) from x(t) and the last displacements.

        a  = g dt^2 + s A(state)         acceleration; gravity is known, the contact forces are learned
        v' = v + a                       displacement in the coming step (semi-implicit Euler)
        x' = keep_out(x + v')            walls and baffles are hard; what remains of v' is x' - x
        v' <- v' r^2 / (1 + r^2)         r = |v'| / (rest_speed dt): what hardly moves stands still

    | symbol | variable                                | unit             |
    | A      | `Network`                               | -                |
    | s      | `acceleration_scale`                    | m per step^2     |
    | v, v'  | `State.displacements[-1]`, before, after | m per step       |

    Absolute positions are no features: a point knows its neighbours, walls and baffles where they are near, and the
    grid.
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

    def forward(self, state: State, conditions: Conditions, search: Search | None = None) -> State:
        """One step. Differentiable in the state, in friction, cohesion, volume and the corners of the baffles.

        search: what finds the neighbours, e.g. a `gns.kernels.neighbours.NeighbourList`; they are searched for anew without it.
        """
        settings, positions = self.settings, state.positions
        graph = radius_graph(positions, settings.radius, conditions.batch, search)
        points = stencil(positions, conditions.size, settings.grid_cell, conditions.batch, conditions.samples)
        around = surroundings(points, conditions.volume)
        if settings.baffles:
            covered = occupancy(
                points.shape,
                points.cell,
                conditions.size,
                conditions.baffles,
                conditions.samples,
                like=around,
            )
            around = torch.cat((around, covered), dim=1)
        share = (conditions.volume / settings.grid_cell**settings.dimension).unsqueeze(1)
        material = self._material(conditions)
        seen = self._features(state, conditions, material, points.gather(around))
        contact = self.acceleration_scale * self.network(seen, material, graph, points, share, around)
        fall = torch.zeros_like(positions[0])
        fall[UP] = -conditions.gravity * settings.step**2
        moved = positions + state.displacements[-1] + contact + fall
        baffles = conditions.baffles if settings.baffles else None
        stopped = keep_out(moved, positions, conditions.size, baffles, conditions.batch)
        if settings.rest_speed > 0.0:
            stopped = positions + settled(stopped - positions, settings.rest_speed * settings.step)
            if baffles is not None:
                # Less than the whole way round a corner may end in it.
                stopped = keep_out(stopped, positions, conditions.size, baffles, conditions.batch)
        displacements = torch.cat((state.displacements[1:], (stopped - positions).unsqueeze(0)))
        return State(positions=stopped, displacements=displacements)

    def _material(self, conditions: Conditions) -> Tensor:
        """What the network is told of the material [N, MATERIAL]."""
        friction = (conditions.friction - self.friction_mean) / self.friction_std
        return torch.stack((friction, (conditions.cohesion / REFERENCE_COHESION).log1p()), dim=1)

    def _features(self, state: State, conditions: Conditions, material: Tensor, around: Tensor) -> Tensor:
        """Features of the points [N, F]."""
        settings = self.settings
        motion = state.displacements / self.displacement_scale
        if settings.past_accelerations:
            changes = state.displacements[1:] - state.displacements[:-1]
            motion = torch.cat((motion, changes / self.acceleration_scale))
        solids = features(
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
                (conditions.volume / settings.point_volume).unsqueeze(1) - 1.0,
                material,
                around,
            ),
            dim=1,
        )


def settled(displacements: Tensor, limit: float) -> Tensor:
    """Displacements [m], shape [N, D], of which those well below `limit` [m] fade.

    Static friction, as far as a step knows it: small errors of the acceleration no longer add up to a creep that never
    ends. Sand that begins to move is faster after one step, unless it is driven by less than limit / dt^2.
    """
    square = displacements.square().sum(dim=1, keepdim=True) / limit**2
    return displacements * (square / (1.0 + square))
