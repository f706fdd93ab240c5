"""The MPM as a differentiable forward model with its own adjoint: a PyTorch layer.

The forward pass is a run of the solver with checkpoints, the backward pass `mpm.adjoint`: no graph of steps is built,
and memory stays within `memory_mib`.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from datasets.errors import require
from datasets.scene import Scene
from datasets.scene.particles import initial_volumes
from inverse.forward import Simulate
from inverse.forward.mpm import MpmForward
from inverse.observations import Observation, Rollout, Values
from inverse.parameters import Kind, Vector, kind, with_kinds
from inverse.parameters.kind import Velocity
from inverse.problem import Problem
from mpm.adjoint.gradient import Gradient, pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape, steady


class AdjointFlow(NamedTuple):
    """The observable quantities of a run, at T frames."""

    positions: Tensor
    """Positions of the particles [m], shape [T, N, D]."""
    velocities: Tensor
    """Velocities of the particles [m/s], shape [T, N, D]."""
    impulses: Tensor
    """Impulse on each solid since the start [N s], in 2D per metre of width, shape [T, solids, D]."""


class AdjointRun:
    """A run as a function of its scene's parameters (`inverse.parameters`), with checkpoints.
    frames: the returned frames, by default the last. Options and errors as in `mpm.adjoint.tape.Tape`, by default in
    single precision. Only differentiable steps are used (`mpm.adjoint.tape.steady`)."""

    def __init__(
        self, scene: Scene, names: Sequence[str], *, frames: Sequence[int] | None = None, **options: Any
    ) -> None:
        self.scene, self.options = scene, {"precision": "f32"} | options
        self.frames = [scene.frames - 1] if frames is None else sorted(frames)
        self.kinds = [kind(name) for name in names]
        for parameter in self.kinds:
            parameter.check(scene)

    def __call__(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Positions [m] and velocities [m/s] of the particles at the frames, shape [T, N, D], for parameters [U]."""
        flow = self.flow(parameters)
        return flow.positions, flow.velocities

    def flow(self, parameters: Tensor) -> AdjointFlow:
        """All observable quantities at the frames, for parameters [U]."""
        (flow,) = self.flows(parameters, [self.scene.seed])
        return flow

    def flows(self, parameters: Tensor, seeds: Sequence[int]) -> list[AdjointFlow]:
        """The same for several jitter seeds in parallel: a mean over seeds is smoother in the parameters."""
        values = parameters.detach().numpy().astype(np.float64)
        scene = steady(with_kinds(self.scene, self.kinds, values))

        def slopes(gradient: Gradient) -> Tensor:
            return torch.from_numpy(derivatives(gradient, self.kinds, values, self.scene))

        tape = Tape([dataclasses.replace(scene, seed=seed) for seed in seeds], self.frames, **self.options)
        outputs = _Flow.apply(tape, slopes, parameters)  # type: ignore[no-untyped-call]
        return [AdjointFlow(*outputs[first : first + 3]) for first in range(0, len(outputs), 3)]


def derivatives(gradient: Gradient, kinds: Sequence[Kind], values: Vector, scene: Scene) -> Vector:
    """dJ/d(parameters) at `values` [U] of `scene`, shape [U], from the gradient with respect to a run's start."""
    slopes = np.zeros(len(values))
    by_mass, run = gradient.of_mass(gradient.velocities), gradient.scene
    given = dataclasses.replace(scene, seed=run.seed, step_fraction=run.step_fraction, fields=run.fields)
    for index, parameter in enumerate(kinds):
        if isinstance(parameter, Velocity):
            slopes[index] = by_mass[parameter.index, parameter.axis]
            continue
        # A number of one body or solid changes nothing else; a shared constant also affects bodies with own constants.
        body = parameter.group, parameter.index
        siblings = [n for n, other in enumerate(kinds) if (other.group, other.index) == body]
        base, moved = (run, siblings) if parameter.group else (given, list(range(len(kinds))))

        def scene_at(value: float, index: int = index, base: Scene = base, moved: list[int] = moved) -> Scene:
            return with_kinds(base, [kinds[n] for n in moved], [value if n == index else values[n] for n in moved])

        slopes[index] = gradient.along(scene_at, float(values[index]))
    return slopes


class _Flow(torch.autograd.Function):
    """The observed quantities of a tape, three tensors for each scene; backwards, its vector-Jacobian product."""

    @staticmethod
    def forward(ctx: Any, tape: Tape, slopes: Callable[[Gradient], Tensor], parameters: Tensor) -> tuple[Tensor, ...]:
        ctx.tape, ctx.slopes, ctx.dtype = tape, slopes, parameters.dtype
        observed, count = (tape.positions, tape.velocities, tape.impulses), len(tape.batch.scenes)
        return tuple(torch.from_numpy(observable(index)) for index in range(count) for observable in observed)

    @staticmethod
    def backward(ctx: Any, *adjoints: Tensor) -> tuple[Any, ...]:
        given = [adjoint.detach().numpy().astype(np.float64) for adjoint in adjoints]
        positions, velocities, impulses = given[::3], given[1::3], given[2::3]
        # Most objectives depend on no force, and then forces cost nothing.
        forces: list[Any] = impulses if any(impulse.any() for impulse in impulses) else [None] * len(impulses)
        flows = map(FlowAdjoints, positions, velocities, forces)
        (gradients,) = pull_back_all(ctx.tape, [list(flows)])
        return None, None, sum(map(ctx.slopes, gradients)).to(ctx.dtype)


class AdjointForward(MpmForward):
    """The MPM, differentiable; its observation is the smooth one of the last frame or, over time, of all frames."""

    def __init__(self, problem: Problem, observation: Observation, simulate: Simulate, **options: Any) -> None:
        """options: of `AdjointRun`."""
        super().__init__(problem, observation, simulate)
        scene = problem.scene
        require("time_offset" not in problem.names, "unknowns", "numbers of the scene for the adjoint", "time_offset")
        frames = range(scene.frames) if observation.over_time else (0, scene.frames - 1)
        self.run = AdjointRun(scene, problem.names, frames=[*frames], **options)
        self.times = np.array(self.run.frames) * scene.frame_dt

    def predict(self, parameters: Tensor, /) -> Tensor:
        """The smooth observation, float64 of shape [m] or [S, m], of parameters, float64 of shape [U] or [S, U]."""
        if parameters.dim() == 2:
            return torch.stack([self.predict(vector) for vector in parameters])
        flow = self.run.flow(parameters)
        followed = self.indices if self.observation.every_particle else slice(None)
        volumes = torch.from_numpy(initial_volumes(self.problem.scene_at(parameters.detach().numpy()))[followed])
        positions, impulses = flow.positions[:, followed], flow.impulses
        rollout = Rollout(positions=positions, times=self.times, volumes=volumes, impulses=impulses)
        return self.observation.predict(rollout)

    def observe(self, parameters: Sequence[Vector], /) -> list[Values]:
        """The smooth observation [m] at each vector of parameters [U], one after the other."""
        with torch.no_grad():
            return [self.predict(torch.from_numpy(values)).numpy() for values in parameters]
