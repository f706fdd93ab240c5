"""The simulator: one step of a granular flow, learned."""

import dataclasses

import torch
from torch import Tensor, nn

from gns.contact import keep_out
from gns.correction import Correction
from gns.features import NODES, Inputs
from gns.forces import FORCES, Moment, Normalisation
from gns.network import Network
from gns.settings import GRAVITY, ModelSettings
from gns.state import Conditions, State

AT_REST = 0.2
"""Root mean square speed of a deposit at rest over the speed of rest, at most [-]."""


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
    | F      | `gns.forces.FORCES`, over the weight    | -                |
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
        self.network = Network(sum(self.features.values()), len(FORCES), settings)
        self.correction = Correction(settings) if corrected else None

    @property
    def features(self) -> dict[str, int]:
        """Features of a particle in their order -> how many columns."""
        return {name: each.count(self.settings) for name, each in NODES.items()}

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step, all of it in the units of the model. Differentiable in the state and in all conditions."""
        settings, positions = self.settings, state.positions
        moment = self.moment(state, conditions)
        own, shares = self.network(Inputs.of_moment(moment)).split((settings.dimension, len(FORCES)), dim=1)
        known = (shares.unsqueeze(1) @ moment.forces).squeeze(1)
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
        return torch.as_tensor(self.correction(start, self.moment(end, conditions)))

    def moment(self, state: State, conditions: Conditions) -> Moment:
        """Features and known forces of a state, all of it in the units of the model."""
        return Moment(state, conditions, self.settings, Normalisation(**dict(self.named_buffers(recurse=False))))


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
