"""The learned simulator as a forward model: from the scene to the deposit, differentiably, many scenes in one batch.

Its error in an observation is the observation of its deposit, moved within its band, minus that of its deposit.

A model card gives the errors of fronts and profiles of held-out flows as shares b_f and b_p of the extent L (95 %).
With s = (x - rear) / L, across the flow s = (z - middle) / width, positions are moved along this axis by

    b_f L / 1.96 s    and    b_p L / 1.96 sin(k pi s) / sqrt(K),  k = 1 .. K

one displacement after the other, in proportion to time. The change of the numbers by each displacement is a column e_k
of their covariance, sum_k e_k e_k^T.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.processes import processors
from datasets.scene import Scene
from gns import card
from gns.ranges import outside
from gns.settings import ModelSettings
from gns.simulator import StepModel, checked, on_threads, placed, step_activation_bytes, unroll
from gns.surroundings.initial import InitialState, check, initial_state
from gns.surroundings.state import Conditions, State
from inverse.observations import Observation, Rollout, Values
from inverse.parameters import Vector, in_order
from inverse.problem import Problem
from mpm.footprint import SPEED
from mpm.resolution import particle_steps

MEMORY_GIB = 2.0  # activations stored for the backward pass instead of being recomputed [GiB]
NODES = 4_000  # most particles in a batch without gradients: larger batches are no cheaper per particle
WAVES = 3  # K
NORMAL = 1.96  # half of a 95 % interval over the standard deviation
PREDICTIONS = 5.0
"""Cost of an MPM run, in predictions, above which a surrogate is used: it predicts two to five times for each run that
it saves."""
Flow = tuple[Tensor, InitialState]  # positions [m] at the times of an initial state, shape [T, n, D], and this state


@dataclass(frozen=True, kw_only=True)
class Band:
    """Largest error of a surrogate's deposit in 95 of 100 flows of the MPM, over its extent [-]."""

    front: float = 0.05  # b_f
    profile: float = 0.03  # b_p

    def moved(self, positions: Tensor) -> Iterator[Tensor]:
        """Positions [m], shape [T, n, D], moved by one displacement after the other."""
        time = torch.linspace(0.0, 1.0, len(positions), dtype=positions.dtype)[:, None]
        for axis in range(0, positions.shape[2], 2):
            along, last = positions[:, :, axis], positions[-1, :, axis]
            origin = positions[0, :, axis].min() if axis == 0 else 0.5 * (last.min() + last.max())
            extent = last.max() - (origin if axis == 0 else last.min())
            share = (along - origin) / extent
            waves = [torch.sin(k * math.pi * share) / math.sqrt(WAVES) for k in range(1, WAVES + 1)]
            for shape in (self.front * share, *(self.profile * wave for wave in waves)):
                other = positions.clone()
                other[:, :, axis] += extent / NORMAL * time * shape
                yield other


class GnsForward:
    """A rollout of the surrogate as a differentiable function of the problem's parameters, in SI units. Unknowns that
    change the particles (thickness of a layer) are no inputs: each flow then has its own initial state, without a
    derivative, and flows run one after the other. A single torch thread computes everything."""

    def __init__(
        self,
        simulator: StepModel,
        problem: Problem,
        observation: Observation,
        band: Band | None = None,
        flows: dict[bytes, Flow] | None = None,
    ) -> None:
        """The weights are frozen, which makes the backward pass much cheaper. band: its errors. flows: parameters ->
        predicted flow, which observations of one scene may share. Raises InputError."""
        self.simulator = checked(simulator).requires_grad_(False)
        self.problem, self.observation, self.kinds, self.band = problem, observation, problem.kinds, band or Band()
        self.other_particles = any(kind.input is None for kind in self.kinds)
        self.initial = self.begin(problem.scene)
        self.flows = {} if flows is None else flows
        self.indices = self.initial.indices
        bytes_per_step = step_activation_bytes(simulator, self.initial.state, self.initial.conditions)
        self.kept_steps = int(MEMORY_GIB * 2**30 / max(bytes_per_step, 1))

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The smooth observation, float64 of shape [m] or [S, m], of parameters, float64 of shape [U] or [S, U]. The
        scenes of several vectors form one graph, so that one backward pass gives all gradients."""
        if parameters.dim() == 1:
            return self.predict(parameters.unsqueeze(0))[0]
        return torch.stack([self.observed(*flow) for flow in self._flows(parameters)])

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The smooth observation [m] at each vector of parameters [U], in batches of at most `NODES` particles."""
        size = max(1, NODES // len(self.indices))
        missing = [vector for vector in parameters if vector.tobytes() not in self.flows]
        with torch.no_grad():
            for first in range(0, len(missing), size):
                batch = missing[first : first + size]
                flows = self._flows(torch.from_numpy(np.stack(batch)))
                self.flows |= {vector.tobytes(): flow for vector, flow in zip(batch, flows, strict=True)}
            return [self.observed(*self.flows[vector.tobytes()]).numpy() for vector in parameters]

    def errors(self, parameters: Vector, /) -> NDArray[np.float64]:
        """Errors of the numbers at parameters [U] from the band, shape [K, m]. Each number of a single particle also
        has its own error, between independent errors as large as that of a profile and one common error with M^(1/2)
        times the effect."""
        with torch.no_grad():
            start = self.entered(torch.from_numpy(parameters))
            path = self.unrolled([start])
            numbers = self.observed(path, start)
            moved = [self.observed(other, start) - numbers for other in self.band.moved(path)]
            differences = torch.stack(moved).numpy()
        if self.observation.every_particle:
            count = differences.shape[1]
            extent = float(path[-1, :, 0].max() - path[0, :, 0].min())
            single = self.band.profile * extent / NORMAL * count**0.25 * np.eye(count)
            differences = np.concatenate([differences, single])
        return differences

    def deposit(self, parameters: Vector, /) -> NDArray[np.floating]:
        with torch.no_grad():
            return self.unrolled([self.entered(torch.from_numpy(parameters))])[-1].numpy()

    def select(self, target: Values, /) -> Values:
        return self.observation.of_particles(target, self.indices)

    def entered(self, parameters: Tensor) -> InitialState:
        """The initial state with parameters [U], differentiable in those that are inputs."""
        initial = self.initial
        if self.other_particles:
            initial = self.begin(self.problem.scene_at(parameters.detach().numpy()))
        for index in in_order(self.kinds):
            kind = self.kinds[index]
            if kind.input is not None:
                initial = kind.input(kind, initial, parameters[index])
        return initial

    def begin(self, scene: Scene) -> InitialState:
        """The initial state of a scene, in the precision of the weights."""
        return initial_state(scene, self.simulator.settings).to(dtype=placed(self.simulator).dtype)

    def observed(self, path: Tensor, start: InitialState) -> Tensor:
        """The smooth observation [m] of one flow's positions [m], shape [T, n, D], with its initial state."""
        rollout = Rollout(positions=path, times=start.times, volumes=start.conditions.volume)
        return self.observation.predict(rollout)

    def _flows(self, parameters: Tensor) -> list[Flow]:
        """The flow for each of parameters [S, U], all in one batch if their particles are the same."""
        starts = [self.entered(vector) for vector in parameters]
        if self.other_particles:
            return [(self.unrolled([start]), start) for start in starts]
        paths = self.unrolled(starts)
        flows = paths.reshape(len(paths), len(starts), -1, paths.shape[2])
        return [(path, self.initial) for path in flows.unbind(1)]

    def unrolled(self, starts: Sequence[InitialState]) -> Tensor:
        """Positions [m] of flows with the same particles, in one batch, at the times of each, shape [T, flows n, D]."""
        state, conditions, steps = starts[0].state, starts[0].conditions, starts[0].steps
        if len(starts) > 1:
            state = State.joined([start.state for start in starts])
            conditions = Conditions.joined([start.conditions for start in starts])
        kept = min(steps, self.kept_steps // len(starts))
        return on_threads(1, unroll, self.simulator, state, conditions, steps, kept_steps=kept)


def band_of(weights: Path, scene: Scene) -> Band:
    """The band of the model in the file `weights` for `scene`, from its card; the default one without an entry."""
    described = card.read(weights)
    calibration = described.calibration(scene) if described is not None else None
    return Band() if calibration is None else Band(front=calibration.front["0.95"], profile=calibration.profile["0.95"])


def require_predicted(problem: Problem) -> None:
    """Raise InputError, which names the key, for numbers or observations that no surrogate supports."""
    for index, parameter in enumerate(problem.parameters):
        if not parameter.kind.predicted:
            message = f"expected an input of the surrogate, {parameter.name} is none"
            raise InputError(message, where=problem.name, key=f"unknowns[{index}]")
    for index, operator in enumerate(problem.operators):
        if not operator.of_positions:
            message = f"expected what follows from positions, no surrogate predicts {operator.label}"
            raise InputError(message, where=problem.name, key=f"observations[{index}]")


def unfamiliar(weights: Path, settings: ModelSettings, scene: Scene) -> str:
    """The properties of a scene outside the training range of the model `weights`, in words; empty if none are."""
    described = card.read(weights)
    strange = outside(scene, described.ranges) if described is not None else []
    try:
        check(scene, settings)
    except InputError as error:
        strange = strange or [str(error)]
    return f"{weights.name} was not trained on such a flow: {'; '.join(strange)}" if strange else ""


def seconds_of_run(scene: Scene) -> float:
    """Expected time of an MPM run [s], not measured on this machine, so that the decision is reproducible."""
    return particle_steps(scene) / (SPEED[scene.dimension] * processors())


def priced(scene: Scene, predict: Callable[[], object]) -> tuple[bool, str]:
    """Whether an MPM run costs `PREDICTIONS` or more, and both times in words; predict: makes one prediction."""
    run, began = seconds_of_run(scene), time.perf_counter()
    predict()
    prediction = time.perf_counter() - began
    return run >= PREDICTIONS * prediction, f"a run of the MPM takes {run:.2g} s, a prediction {prediction:.2g} s"
