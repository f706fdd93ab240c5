"""The simulator: one step of a granular flow, learned."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gns.graph import radius_graph
from gns.grid import UP, stencil, surroundings
from gns.network import Network
from gns.settings import ModelSettings
from gns.state import Conditions, State


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
        x' = clamp(x + v', 0, size)      the box is hard; what remains of v' is x' - x

    | symbol | variable                                | unit             |
    | A      | `Network`                               | -                |
    | s      | `acceleration_scale`                    | m per step^2     |
    | v, v'  | `State.displacements[-1]`, before, after | m per step       |

    Absolute positions are no features: a point knows its neighbours, the walls where they are near, and the grid.
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
        # displacements and their changes; distances to the walls; tan(phi), volume; the grid's surroundings
        motion = settings.history + (settings.history - 1 if settings.past_accelerations else 0)
        features = motion * dimension + 2 * dimension + 2 + (dimension + 2)
        self.network = Network(features, settings)

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step. Differentiable in the state, in friction and volume."""
        settings, positions = self.settings, state.positions
        graph = radius_graph(positions, settings.radius, conditions.batch)
        points = stencil(positions, conditions.size, settings.grid_cell, conditions.batch, conditions.samples)
        around = surroundings(points, conditions.volume)
        share = (conditions.volume / settings.grid_cell**settings.dimension).unsqueeze(1)
        features = self._features(state, conditions, points.gather(around))
        contact = self.acceleration_scale * self.network(features, graph, points, share, around)
        fall = torch.zeros_like(positions[0])
        fall[UP] = -conditions.gravity * settings.step**2
        moved = positions + state.displacements[-1] + contact + fall
        # Bounds as numbers: a clamp to tensors would halve the gradient of a point that rests exactly on a wall.
        stopped = torch.stack([moved[:, axis].clamp(0.0, length) for axis, length in enumerate(conditions.size)], dim=1)
        displacements = torch.cat((state.displacements[1:], (stopped - positions).unsqueeze(0)))
        return State(positions=stopped, displacements=displacements)

    def _features(self, state: State, conditions: Conditions, around: Tensor) -> Tensor:
        """Features of the points [N, F]."""
        settings = self.settings
        size = state.positions.new_tensor(conditions.size)
        motion = state.displacements / self.displacement_scale
        if settings.past_accelerations:
            changes = state.displacements[1:] - state.displacements[:-1]
            motion = torch.cat((motion, changes / self.acceleration_scale))
        walls = torch.cat((state.positions, size - state.positions), dim=1) / settings.radius
        return torch.cat(
            (
                motion.movedim(0, 1).flatten(1),
                walls.clamp(max=1.0),
                ((conditions.friction - self.friction_mean) / self.friction_std).unsqueeze(1),
                (conditions.volume / settings.point_volume).unsqueeze(1) - 1.0,
                around,
            ),
            dim=1,
        )
