"""`python -m gns.refit MODEL DATASET... --out PATH`: the last layer of a model by linear least squares.

The acceleration by contacts is linear in the weights W, C of the decoder's last layer (`gns.model.simulator`):

    a = s W h + g dt^2 sum_k (C h)_k F_k

Training finds them by small steps along noisy gradients. Here they are found at once, over all training flows, from the
accelerations of the MPM at the model's own states, a few steps after states of the MPM, so that they fit where rollouts
go (Ross, Gordon & Bagnell, A reduction of imitation learning and structured prediction to no-regret online learning,
AISTATS 2011):

    minimise  sum w |a_MPM - a - da|^2 + ridge sum_p A_pp d_p^2,      w = min(1, (s / 2) / |a_MPM - a|)

with the change d of (W, C), da linear in d, and A the matrix of the normal equations: ridge regression on the scale of
each column (Marquardt, J. SIAM 11, 1963), with Huber's weights for the impacts that a step cannot resolve (Holland &
Welsch, Communications in Statistics 6, 1977). The ridge is the one that leaves the smallest residual on the flows of
the valid split.

Members of an ensemble (`gns.uncertainty`) are fitted to a part of the flows each. What all flows together tell of the
layer, one part tells less surely: where a scene's answer hangs on it, the members differ.

| symbol | variable                     | meaning                                       |
| h, F   | `Simulator.hidden`           | inputs of the last layer; known forces        |
| s      | `acceleration_scale`         | of the network's accelerations [m per step^2] |
| A      | `NormalEquations.matrix`     |                                               |
"""

import copy
import functools
import operator
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from datasets import command_line
from datasets.errors import InputError
from datasets.training.samples import Flow
from gns.inference import member_path, model_path
from gns.model import checkpoint
from gns.model.settings import GRAVITY, ModelSettings
from gns.model.simulator import Simulator
from gns.model.state import Conditions, State
from gns.training.batch import Particles, batched
from gns.training.flows import flows_of, stretch

Floats = NDArray[np.float64]

RIDGES = (1.0e-3, 1.0e-2, 1.0e-1, 1.0, 10.0)
"""Of which the best is taken [-]."""
STEPS = 6
"""Steps of the model after a state of the MPM."""
EVERY = 9
"""Steps between two such states."""
AT_ONCE = 4
"""Flows side by side."""
MOVING = 0.05
"""Speed of the MPM [m/s] above which a particle counts: static friction holds one at rest, whatever drives it."""
TOUCHED = 1.0e-6
"""Distance [m] that a solid moves a particle by, from which on its acceleration is the solid's, not the layer's."""


@dataclass(kw_only=True)
class NormalEquations:
    """Sums over particles and axes, of residuals r and rows j of the change's Jacobian."""

    matrix: Floats
    """sum w j j^T, shape [P, P]."""
    vector: Floats
    """sum w j r, shape [P]."""
    square: float = 0.0
    """sum w r^2."""
    count: int = 0

    @staticmethod
    def of_size(parameters: int) -> "NormalEquations":
        """No sums yet."""
        return NormalEquations(matrix=np.zeros((parameters, parameters)), vector=np.zeros(parameters))

    def __add__(self, other: "NormalEquations") -> "NormalEquations":
        """The sums over what either has."""
        return NormalEquations(
            matrix=self.matrix + other.matrix,
            vector=self.vector + other.vector,
            square=self.square + other.square,
            count=self.count + other.count,
        )

    def add(self, rows: Tensor, residuals: Tensor, width: float) -> None:
        """Add rows [M, P] and residuals [M]; those above `width` count linearly only."""
        root = (width / residuals.abs().clamp(min=width)).sqrt()
        rows, residuals = rows * root.unsqueeze(1), residuals * root
        self.matrix += (rows.T @ rows).double().numpy()
        self.vector += (rows.T @ residuals).double().numpy()
        self.square += float(residuals.square().sum())
        self.count += len(residuals)

    def solution(self, ridge: float) -> Floats:
        """The change d, shape [P]."""
        diagonal = np.diag(self.matrix)
        # What no particle has ever had an influence on stays as it is.
        damped = ridge * np.maximum(diagonal, 1.0e-12 * diagonal.max())
        return np.asarray(np.linalg.solve(self.matrix + np.diag(damped), self.vector))

    def residual(self, change: Floats) -> float:
        """Root mean square residual after a change [m per step^2]."""
        left = float(self.square - 2.0 * change @ self.vector + change @ self.matrix @ change)
        return float(np.sqrt(max(left, 0.0) / max(self.count, 1)))


def equations(
    simulator: Simulator, datasets: Sequence[Sequence[Flow]], *, parts: int = 1, seed: int = 0, progress: bool = False
) -> list[NormalEquations]:
    """The normal equations over stretches of all flows, of as many equal parts of each dataset."""
    rng = np.random.default_rng(seed)
    last = simulator.network.decoder.last
    found = [NormalEquations.of_size(last.out_features * (last.in_features + 1)) for _ in range(parts)]
    bar = tqdm(total=sum(map(len, datasets)), desc="least squares", unit="flow", disable=not progress)
    with bar, torch.no_grad():
        for flows in datasets:
            # What follows each other stays together: a flow and its variant tell nearly the same.
            ends = [len(flows) * part // parts for part in range(parts + 1)]
            for sums, begin, end in zip(found, ends, ends[1:], strict=False):
                for first in range(begin, end, AT_ONCE):
                    group = [flows[index] for index in range(first, min(first + AT_ONCE, end))]
                    for batch in stretches(group, simulator.settings, rng):
                        follow(simulator, batch, sums)
                    bar.update(len(group))
    return found


def stretches(flows: Sequence[Flow], settings: ModelSettings, rng: np.random.Generator) -> Iterator[Particles]:
    """Stretches of `STEPS` steps, one of each flow side by side, `EVERY` steps apart."""
    for now in range(0, min(len(flow.positions) for flow in flows) - STEPS, EVERY):
        samples = [stretch(flow, settings, now=now, steps=STEPS, rng=rng) for flow in flows]
        yield batched(samples, step=settings.step, history=settings.history)


def follow(simulator: Simulator, batch: Particles, sums: NormalEquations) -> None:
    """Add the equations along a rollout of the model beside the MPM's."""
    settings = simulator.settings
    state, conditions = batch.state, batch.conditions(settings.cell)
    fall = conditions.of_particles(conditions.gravity) * settings.step**2
    before, displaced = batch.pos, state.displacements[-1]
    for target in batch.targets:
        moved = target - before
        state = accumulate(simulator, state, conditions, moved - displaced - fall, moved, sums)
        before, displaced = target, moved


def accumulate(
    simulator: Simulator, state: State, conditions: Conditions, truth: Tensor, moved: Tensor, sums: NormalEquations
) -> State:
    """Add the equations of one step, and return the state after it.

    truth: acceleration by contacts of the MPM [m per step^2]; moved: its displacements [m]; both [N, D].
    """
    step, dimension = simulator.settings.step, truth.shape[1]
    hidden, forces = simulator.hidden(state, conditions)
    contact = simulator.contact(hidden, forces)
    after = simulator.moved(state, conditions, contact)
    free = (after.positions - simulator.flown(state, conditions, contact)).abs() < TOUCHED
    moves = moved.norm(dim=1) > MOVING * step
    width = 0.5 * float(simulator.acceleration_scale)
    for axis in range(dimension):
        chosen = free[:, axis] & moves
        rows = jacobian(simulator, hidden[chosen], forces[chosen], axis)
        sums.add(rows, (truth - contact)[chosen, axis], width)
    return after


def jacobian(simulator: Simulator, hidden: Tensor, forces: Tensor, axis: int) -> Tensor:
    """Derivative of accelerations along an axis by weights and bias of the last layer, output by output [M, P]."""
    inputs = torch.cat((hidden, torch.ones_like(hidden[:, :1])), dim=1)
    own = torch.zeros_like(forces[:, 0])
    own[:, axis] = simulator.acceleration_scale
    known = GRAVITY * simulator.settings.step**2 * forces[:, :, axis]
    return (torch.cat((own, known), dim=1).unsqueeze(2) * inputs.unsqueeze(1)).flatten(1)


def best_ridge(train: NormalEquations, valid: NormalEquations) -> float:
    """The ridge whose solution on `train` leaves the smallest residual on `valid`."""
    return min(RIDGES, key=lambda ridge: valid.residual(train.solution(ridge)))


def changed(simulator: Simulator, by: Floats) -> Simulator:
    """The model with its last layer changed, in the order of `jacobian`."""
    found = copy.deepcopy(simulator)
    last = found.network.decoder.last
    step = torch.from_numpy(by).to(last.weight.dtype).view(last.out_features, last.in_features + 1)
    with torch.no_grad():
        last.weight.add_(step[:, :-1])
        last.bias.add_(step[:, -1])
    return found


def refit(model: Path, /, *datasets: Path, out: Path, members: int = 0, seed: int = 0, threads: int = 1) -> None:
    """Fit the last layer of a model to its training flows by least squares; leaves OUT.

    Score both models before the new one is used: fitted are accelerations, not deposits.

    Parameters
    ----------
    model
        The model's file, or the name of a shipped one.
    datasets
        Folders that python -m mpm.generate made.
    out
        File of the new model, NAME.safetensors.
    members
        Fit as many members of an ensemble beside it, NAME-1.safetensors and so on, each to a part of the flows.
    seed
        Of the choice of the particles that stay.
    threads
        Threads of torch.
    """
    torch.set_num_threads(threads)
    if out.suffix != checkpoint.ENDING:
        raise InputError(f"expected a name that ends in {checkpoint.ENDING}", where=str(out), key="--out")
    if members < 0 or members == 1:
        raise InputError(f"expected none, or two or more, got {members}", key="--members")
    if not datasets:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")
    loaded = checkpoint.load(model_path(model))
    simulator, settings = loaded.simulator, loaded.simulator.settings

    # Both are opened before minutes are spent on the first.
    train, valid = ([flows_of(dataset, split, settings) for dataset in datasets] for split in ("train", "valid"))
    if (fewest := min(map(len, train))) < members:
        raise InputError(f"expected at most one member per training flow, {fewest}, got {members}", key="--members")
    parts = equations(simulator, train, parts=max(1, members), seed=seed, progress=True)
    (other,) = equations(simulator, valid, seed=seed, progress=True)
    whole = functools.reduce(operator.add, parts)
    for sums, split in ((whole, "train"), (other, "valid")):
        if sums.count == 0:
            raise InputError(f"expected moving flows of more than {STEPS} steps in {split}", where=str(datasets[0]))
    ridge = best_ridge(whole, other)
    found = whole.solution(ridge)
    unit = GRAVITY * settings.step**2
    residuals = {
        name: [round(sums.residual(by) / unit, 4) for by in (0.0 * found, found)]
        for name, sums in (("train", whole), ("valid", other))
    }
    own = {"command": " ".join(["python -m gns.refit", *sys.argv[1:]]), "ridge": ridge, "residuals": residuals}
    provenance = {**loaded.provenance, "refit": own}
    for number, sums in enumerate(parts if members else (), start=1):
        checkpoint.save(member_path(out, number), changed(simulator, sums.solution(ridge)), provenance)
    checkpoint.save(out, changed(simulator, found), provenance)
    for name, (before, after) in residuals.items():
        print(f"{name}: residual acceleration {before:.4f} g before, {after:.4f} g after (ridge {ridge:g})")


if __name__ == "__main__":
    sys.exit(command_line.run(refit, "python -m gns.refit"))
