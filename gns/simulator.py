"""The simulator, a learned step of a granular flow, and the rollout, the only loop that repeats the step."""

import dataclasses
import inspect
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from typing import Any, ParamSpec, Protocol, Self

import torch
from torch import Tensor, UntypedStorage, nn
from torch.autograd import Variable
from torch.utils.checkpoint import checkpoint
from tqdm import tqdm

from datasets.errors import require
from datasets.memory import trimming
from gns.network.correction import Correction, stretched
from gns.network.features import NODES, Inputs
from gns.network.network import Network
from gns.settings import GRAVITY, ModelSettings
from gns.surroundings.contact import keep_out
from gns.surroundings.forces import FORCES, Moment, Normalisation
from gns.surroundings.state import Conditions, State, columns, in_model_units

AT_REST = 0.2  # largest root mean square speed of a deposit at rest, over the speed of rest [-]
STANDING = 2.0  # the same for a step from rest of a mass that can stand (`Moment.stands`): an error [-]
P = ParamSpec("P")
Moves = Callable[[Tensor, float], Tensor]


class StepModel(Protocol):
    """The interface of a user's own network: a `torch.nn.Module` with the two members below. `gns.simulate`,
    `gns.predict`, `gns.score.evaluate` and `inverse.forward.gns.GnsForward` accept every such network."""

    settings: ModelSettings
    """Its dimension, its step, which particles it follows (`cell`, `particles_per_cell`), how many of their past
    displacements it needs (`history`), and the length and density of its training data; only `Simulator` uses the other
    settings."""

    def forward(self, state: State, conditions: Conditions, /) -> State:
        """One step of N particles in the units of the model; `advanced` keeps them out of walls and solids."""

    # Every module has the following.
    def __call__(self, state: State, conditions: Conditions, /) -> State: ...
    def to(self, device: torch.device | str, /) -> Self: ...
    def parameters(self) -> Iterator[nn.Parameter]: ...
    def buffers(self) -> Iterator[Tensor]: ...
    def requires_grad_(self, requires_grad: bool = True) -> Self: ...


def checked(model: Any) -> StepModel:
    """The model, if it is a `StepModel`. Raises InputError, which says what it lacks."""
    name = type(model).__name__
    expected = "a torch.nn.Module with settings and forward(state, conditions) (gns.simulator.StepModel)"
    require(isinstance(model, nn.Module), "model", expected, f"one of the type {name}")
    settings = getattr(model, "settings", None)
    require(isinstance(settings, ModelSettings), f"{name}.settings", "gns.settings.ModelSettings", repr(settings))
    signature = inspect.signature(model.forward)
    try:
        signature.bind("state", "conditions")
    except TypeError:
        require(False, f"{name}.forward", "forward(state, conditions)", f"forward{signature}")
    return model  # type: ignore[no-any-return]


def placed(model: StepModel) -> Tensor:
    """A number of the model: its device and its precision are those of the model, of one without any the usual ones."""
    numbers = chain(model.parameters(), model.buffers())
    return next((number for number in numbers if number.is_floating_point()), torch.zeros(()))


def advanced(
    state: State, conditions: Conditions, acceleration: Tensor, settings: ModelSettings, moves: Moves | None = None
) -> State:
    """The state after a step by the equations of `Simulator`, in the units of the model. acceleration: a of `Simulator`
    without gravity's g dt^2 [m per step^2], shape [N, D]; moves: gives the share of the displacements [N, D] that
    remains, from these and from the step's length at the speed of rest; `moving` unless given. It stops a flow whose
    particles hardly move."""
    positions, fall = state.positions, conditions.of_particles(conditions.gravity) * settings.step**2
    stopped = keep_out(positions + state.displacements[-1] + acceleration + fall, positions, conditions)
    if settings.rest_speed > 0.0:
        limit = settings.rest_speed * settings.step
        moved = settled(stopped - positions, limit)
        left = moving(moved, AT_REST * limit, conditions) if moves is None else moves(moved, limit)
        stopped = positions + moved * left
        if conditions.baffles is not None or conditions.ground is not None:
            # A shortened displacement around a corner may end inside the baffle.
            stopped = keep_out(stopped, positions, conditions)
    displacements = torch.cat((state.displacements[1:], (stopped - positions).unsqueeze(0)))
    return State(positions=stopped, displacements=displacements)


class Simulator(nn.Module):
    """x(t + dt) from x(t) and the last displacements.

        a  = g dt^2 + s A(state) + g dt^2 sum_k c_k(state) F_k
                                         acceleration; gravity is known, the contact forces are learned
        v' = v + a                       displacement in the coming step (semi-implicit Euler)
        x' = keep_out(x + v')            walls, ground and baffles are impenetrable; what remains of v' is x' - x
        v' <- v' r^4 / (1 + r^4)         r = |v'| / (rest_speed dt): static friction
        v' <- 0                          in a flow that is at rest (`moves`), but not while training

    | symbol | variable                                 | unit         |
    | A, c   | `Network`                                | -            |
    | F      | `Moment.forces`, over the weight         | -            |
    | s      | `acceleration_scale`                     | m per step^2 |
    | v, v'  | `State.displacements[-1]`, before, after | m per step   |
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
        self.network = Network(columns(NODES, settings), len(FORCES), settings)
        self.correction = Correction(settings) if corrected else None

    def forward(self, state: State, conditions: Conditions) -> State:
        """One step, all of it in the units of the model. Differentiable in the state and in all conditions."""
        settings, moment = self.settings, self.moment(state, conditions)
        learned, shares = self.network(Inputs.of_moment(moment)).split((settings.dimension, len(FORCES)), dim=1)
        force = (shares.unsqueeze(1) @ moment.forces).squeeze(1)
        contact = self.acceleration_scale * learned + GRAVITY * settings.step**2 * force
        return advanced(state, conditions, contact, settings, partial(self.moves, moment))

    def moves(self, moment: Moment, moved: Tensor, limit: float) -> Tensor:
        """`moving`, but a flow that was at rest and can stay so (`Moment.stands`) moves only above a higher speed."""
        if self.training:
            return torch.ones(())
        conditions, slow = moment.conditions, AT_REST * limit
        moves = moving(moved, slow, conditions)
        starts = moves * (1.0 - moving(moment.velocity, slow, conditions) - moving(moved, STANDING * limit, conditions))
        if not bool((starts > 0.0).any()):
            return moves
        return torch.where(conditions.of_particles(moment.stands()), moves - starts.clamp(min=0.0), moves)

    def corrected(self, start: State, end: State, positions: Tensor, conditions: Conditions) -> Tensor:
        """Positions of a rollout from `start` to `end` [m], [K + 1, N, D], with its correction, if any, applied."""
        if self.correction is None or len(positions) == 1:
            return positions
        return stretched(positions, self.correction(start, self.moment(end, conditions)), conditions)

    def moment(self, state: State, conditions: Conditions) -> Moment:
        """Features and known forces of a state, all of it in the units of the model."""
        return Moment(state, conditions, self.settings, Normalisation(**dict(self.named_buffers(recurse=False))))


def moving(displacements: Tensor, limit: float, conditions: Conditions) -> Tensor:
    """1 for particles of flows whose displacements [m], [N, D], are above `limit` [m] (rms), else 0; shape [N or 1, 1].
    Below it the deposit is at rest, as in a run of the MPM. Resting positions have the gradient of those before."""
    square = displacements.detach().square().sum(dim=1, keepdim=True)
    return conditions.of_particles((conditions.total(square - limit**2) > 0.0).to(square))


def settled(displacements: Tensor, limit: float) -> Tensor:
    """Displacements [m], shape [N, D], of which those well below `limit` [m] fade: static friction. Small errors of the
    acceleration no longer add up to a creep; sand whose acceleration exceeds limit / dt^2 begins to move."""
    fourth = (displacements.square().sum(dim=1, keepdim=True) / limit**2).square()
    return displacements * (fourth / (1.0 + fourth))


def on_threads(count: int, compute: Callable[P, Tensor], *args: P.args, **kwargs: P.kwargs) -> Tensor:
    """Call `compute` with `count` threads of torch, and use as many in the backward pass through its result. Torch then
    has as many threads as before. `gns/__init__.py` explains why few are faster. Raises InputError for less than one.
    """
    require(count >= 1, "threads", "a whole number from 1 on", count)
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        result = compute(*args, **kwargs)
    finally:
        torch.set_num_threads(before)

    def begin(_: Tensor) -> None:
        now = torch.get_num_threads()
        if now != count:
            torch.set_num_threads(count)
            # Called where the backward pass ends.
            Variable._execution_engine.queue_callback(partial(torch.set_num_threads, now))

    if result.requires_grad:
        result.register_hook(begin)  # type: ignore[no-untyped-call]
    return result


def unroll(
    simulator: StepModel,
    start: State,
    conditions: Conditions,
    steps: int,
    *,
    kept_steps: int = 0,
    progress: bool = False,
    corrected: bool = True,
) -> Tensor:
    """Positions [m] at the start and after each step, shape [steps + 1, N, D]; in the units of the scene. corrected:
    apply the simulator's correction, if it has one; kept_steps: number of last steps that keep their activations
    (`step_activation_bytes` each) if gradients are recorded. The other steps keep only their state and are recomputed
    in the backward pass, with the same result. For a gradient with respect to state or conditions, freeze the weights,
    as `gns.load` does: it is then much cheaper."""
    lean, length = trimming(simulator), conditions.units.length
    first, conditions = in_model_units(start, conditions)
    state, positions = first, [first.positions]
    for step in tqdm(range(steps), desc="rollout", unit="step", disable=not progress):
        before = state
        if torch.is_grad_enabled() and step < steps - kept_steps:
            state = checkpoint(lean, state, conditions, use_reentrant=False, preserve_rng_state=False)
        else:
            state = simulator(state, conditions)
        if step == 0:
            shapes = first.positions.shape, first.displacements.shape
            returned = (state.positions.shape, state.displacements.shape) if isinstance(state, State) else type(state)
            require(returned == shapes, "forward", f"a State of shapes {shapes}", returned)
        positions.append(state.positions)
        if not (torch.is_grad_enabled() or before.displacements.any() or state.displacements.any()):
            # After a step that changes nothing, all further steps change nothing.
            positions += (steps - step - 1) * [state.positions]
            break
    moved = torch.stack(positions)
    if corrected and isinstance(simulator, Simulator):
        moved = simulator.corrected(first, state, moved, conditions)
    return moved if length == 1.0 else moved * length


def step_activation_bytes(simulator: StepModel, state: State, conditions: Conditions) -> int:
    """Memory of a step's activations until the backward pass [bytes]: each storage once, without weights and inputs."""
    given = [*simulator.parameters(), *simulator.buffers(), conditions.friction, conditions.cohesion, conditions.volume]
    excluded = {tensor.untyped_storage().data_ptr() for tensor in given}
    # By address, with the storage itself: the address of a freed storage could be reused.
    saved: dict[int, UntypedStorage] = {}

    def keep(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in excluded:
            saved[storage.data_ptr()] = storage
        return tensor

    state, conditions = in_model_units(state, conditions)
    inside = State(**{name: tensor.detach().clone().requires_grad_() for name, tensor in vars(state).items()})
    with torch.enable_grad(), torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        simulator(inside, conditions)
    return sum(storage.nbytes() for storage in saved.values())
