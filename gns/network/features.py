"""The features: the network's input for nodes and edges, in the order of its columns.

To add a feature, add an entry to `NODES`, to `EDGES` or to the channels of the background grid
(`gns.surroundings.grid.CHANNELS`): its name, its number of columns, and how they are computed and scaled. Everything
else follows: the width of the network, training, rollout and card. Absolute positions are no features.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from gns.network.graph import Graph, radius_graph
from gns.settings import GRAVITY, UP
from gns.surroundings.forces import Moment
from gns.surroundings.grid import CHANNELS, Stencil
from gns.surroundings.state import Input, columns

DAMPING = 5.0  # factor that brings the coefficient of damping to the size of the other features [-]
ROUGHNESS = (0.45, 0.27)  # mean and standard deviation to which the friction of floor and walls is normalised [-]
INCLINED = 4.0  # factor that brings gravity along the floor to the size of the other features [-]
# Scale of the logarithm of the cohesion, about the weight of 3 mm of sand: any cohesion stops a thin front sooner.
REFERENCE_COHESION = 50.0  # [Pa]
SQUARE_FLOOR = 1.0e-12  # added to d^2: stopped particles may coincide, and the root has no finite slope at zero


def constants(x: Moment) -> Tensor:
    """Friction and cohesion; friction of floor or ground and of walls, damping, gravity; shape [N, 5 + D]."""
    conditions, normalisation, count = x.conditions, x.normalisation, len(x.conditions.friction)
    friction = (conditions.friction - normalisation.friction_mean) / normalisation.friction_std
    cohesion = 0.5 * (conditions.cohesion / REFERENCE_COHESION).log1p()
    surfaces = x.bed, conditions.of_particles(conditions.wall_friction)
    rough = torch.stack([(friction.expand(count) - ROUGHNESS[0]) / ROUGHNESS[1] for friction in surfaces], dim=1)
    inclined = torch.full_like(conditions.gravity[0], INCLINED / GRAVITY)
    inclined[UP] = 1.0 / GRAVITY
    shared = torch.cat((DAMPING * conditions.damping.unsqueeze(1), inclined * conditions.gravity), dim=1)
    strengths = torch.stack((friction, cohesion), dim=1)
    return torch.cat((strengths, rough, conditions.of_particles(shared).expand(count, -1)), dim=1)


# Node features that are constant during a rollout: they also scale and shift the latents of each message-passing step.
CONSTANTS = {"friction, cohesion, floor, walls, damping, gravity": Input(lambda s: 5 + s.dimension, constants)}
# Node features, from a `Moment`.
NODES = {
    "past displacements": Input(
        lambda s: s.history * s.dimension,
        lambda x: (x.state.displacements / x.normalisation.displacement_scale).movedim(0, 1).flatten(1),
    ),
    "their changes": Input(
        lambda s: (s.history - 1) * s.dimension,
        lambda x: (x.changes / x.normalisation.acceleration_scale).movedim(0, 1).flatten(1),
    ),
    "solids within the radius": Input(lambda s: 3 * s.dimension + 2, lambda x: x.solids),
    "volume": Input(lambda s: 1, lambda x: (x.conditions.volume / x.settings.particle_volume).unsqueeze(1) - 1.0),
    **CONSTANTS,
    "column on the grid": Input(lambda s: columns(CHANNELS, s), lambda x: x.column),
    "tractions of surfaces and damping": Input(
        lambda s: 2 * s.dimension, lambda x: torch.hstack((x.traction, x.damping))
    ),
    "cohesion over the weight above": Input(lambda s: 1, lambda x: x.strength),
    "forces of pressure and internal friction": Input(lambda s: 2 * s.dimension, lambda x: x.internal),
    "basal friction and damped motion": Input(lambda s: 2 * s.dimension, lambda x: torch.hstack((x.basal, x.damped))),
    "cohesion": Input(lambda s: s.dimension, lambda x: x.together),
}
# Edge features, from the offset of the sender from the receiver over the radius [-], shape [E, D].
EDGES = {
    "offset over the radius": Input(lambda s: s.dimension, lambda d: d),
    "distance over the radius": Input(lambda s: 1, lambda d: (d.square().sum(1, keepdim=True) + SQUARE_FLOOR).sqrt()),
}


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """The network's input for a state of N particles."""

    features: Tensor  # `NODES`, shape [N, F]
    constant: Tensor  # `CONSTANTS`, shape [N, M]
    graph: Graph
    stencil: Stencil  # the particles on the background grid
    fraction: Tensor  # volume of each particle over that of a grid cell [-], shape [N, 1]
    nodes: Tensor  # `CHANNELS` of the grid, shape [B * nodes, C]

    @staticmethod
    def of_moment(moment: Moment) -> "Inputs":
        settings, conditions = moment.settings, moment.conditions
        features = {name: feature.compute(moment) for name, feature in NODES.items()}
        return Inputs(
            features=torch.cat(list(features.values()), dim=1),
            constant=torch.cat([features[name] for name in CONSTANTS], dim=1),
            graph=radius_graph(moment.state.positions, settings.radius, conditions.batch),
            stencil=moment.stencil,
            fraction=(conditions.volume / settings.grid_cell**settings.dimension).unsqueeze(1),
            nodes=moment.nodes,
        )
