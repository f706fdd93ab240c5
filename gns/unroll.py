"""The rollout loop: training, scores, the command and the inversion all step through it."""

import torch
from torch import Tensor, UntypedStorage
from torch.utils.checkpoint import checkpoint
from tqdm import tqdm

from datasets.memory import trimming
from gns.correction import stretched
from gns.simulator import Simulator
from gns.state import Conditions, State, in_model_units


def unroll(
    simulator: Simulator,
    start: State,
    conditions: Conditions,
    steps: int,
    *,
    kept_steps: int = 0,
    progress: bool = False,
    corrected: bool = True,
) -> Tensor:
    """Positions [m] at the start and after each step, shape [steps + 1, N, D]; all of it in the units of the scene.

    corrected: on the way to the end by the simulator's correction, where it has one (`gns.correction`).

    Where gradients are recorded, a step keeps only its state and is computed again in the backward pass (a
    state is a few kilobytes, the activations of a step are megabytes); the last `kept_steps` steps keep their
    activations and save that second computation. The result and the gradient do not depend on `kept_steps`.
    `step_activation_bytes` is the memory of a kept step. For a gradient with respect to state or conditions the weights
    should be frozen, as `gns.load` gives them: the backward pass is then much cheaper.
    """
    lean = trimming(simulator)
    length = conditions.units.length
    state, conditions = in_model_units(start, conditions)
    first, positions = state, [state.positions]
    for step in tqdm(range(steps), desc="rollout", unit="step", disable=not progress):
        if torch.is_grad_enabled() and step < steps - kept_steps:
            state = checkpoint(lean, state, conditions, use_reentrant=False, preserve_rng_state=False)
        else:
            state = simulator(state, conditions)
        positions.append(state.positions)
    moved = torch.stack(positions)
    if corrected and simulator.correction is not None and steps > 0:
        moved = stretched(moved, simulator.end_correction(first, state, conditions), conditions)
    return moved if length == 1.0 else moved * length


def step_activation_bytes(simulator: Simulator, state: State, conditions: Conditions) -> int:
    """Memory that one step's activations take until the backward pass [bytes].

    Measured: every storage that autograd saves is counted once, weights and inputs left out. As in the middle of a
    rollout, the state requires a gradient.
    """
    given = [*simulator.parameters(), *simulator.buffers(), conditions.friction, conditions.cohesion, conditions.volume]
    known = {each.untyped_storage().data_ptr() for each in given}
    # By address, with the storage itself: that of one which is freed could be another's.
    saved: dict[int, UntypedStorage] = {}

    def keep(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in known:
            saved[storage.data_ptr()] = storage
        return tensor

    state, conditions = in_model_units(state, conditions)
    inside = State(
        positions=state.positions.detach().clone().requires_grad_(),
        displacements=state.displacements.detach().clone().requires_grad_(),
    )
    with torch.enable_grad(), torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        simulator(inside, conditions)
    return sum(storage.nbytes() for storage in saved.values())
