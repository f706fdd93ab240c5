"""Agreement of the adjoint with central differences: Jacobians of an observation, each averaged over jitter seeds.

    cosine = A : B / (|A| |B|),    length = |A| / |B|        of the Jacobians A (adjoint) and B (differences)

Differences over a finite step see the flow's corners blurred; the adjoint sees one side of each. So a Jacobian is held
against differences of a coarse step and of a fine one: where only the fine ones agree, the flow bends in between.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from datasets.library import read_scene
from datasets.particles import initial_particles, initial_volumes
from datasets.scene import Scene
from inverse.forward.adjoint import Run
from inverse.observations import build
from inverse.observations.observation import Observation, Rollout
from inverse.parameters import kind, with_kinds
from inverse.settings import ObservationSettings
from mpm.adjoint.checks import lone_particle_step
from mpm.adjoint.gradient import pull_back_all
from mpm.adjoint.tape import FlowAdjoints, Tape
from mpm.output.request import LAST
from mpm.process import processors
from mpm.simulation import simulate_many
from validation.bench.efficiency.gradients import blocks, sampled

Floats = NDArray[np.float64]
Observe = Callable[[Tensor], Tensor]
"""Numbers [M] of the final positions [N, D]."""

COARSE = 0.02
"""Cell [m] of the layers with `--quick`."""
STEADY = 0.95
"""Steps of the flow in 3D over the largest at which a single particle does not swing on its own."""
TAPE_MIB = 4096.0
"""Budget of the tape of the seeds that run side by side."""


@dataclass(frozen=True, kw_only=True)
class Flow:
    """A row of the table: a scene, what is observed of it, and the parameters."""

    name: str
    scene: Scene
    names: tuple[str, ...]
    """Of the parameters whose columns are compared."""
    unit: str
    steps: tuple[float, ...]
    """Of the differences, the coarsest first [unit]."""
    shares: int | None = None
    """Equal parts of the particles, in the order of x, whose mean x is observed; the toe where absent."""
    seeds: int = 16

    def observe(self) -> Observe:
        """The numbers of the final positions, differentiable."""
        if self.shares is not None:
            count = self.shares
            return lambda positions: torch.stack(
                [part.mean() for part in torch.tensor_split(torch.sort(positions[:, 0]).values, count)]
            )
        toe: Observation = build(ObservationSettings(kind="toe"), self.scene)
        volumes = torch.from_numpy(initial_volumes(self.scene))
        return lambda positions: toe.predict(Rollout(positions=positions[None], times=np.zeros(1), volumes=volumes))


def flows(seeds: int, shares: int, *, quick: bool) -> list[Flow]:
    """The rows of the table."""
    layers = coarse(read_scene("layers-10")) if quick else read_scene("layers-10")
    velocities = tuple(f"masses[{index}].velocity_x" for index in range(10))
    hundred = blocks(10, 10)
    shipped = Flow(
        name="ten velocities, as shipped",
        scene=layers,
        names=velocities,
        unit="m/s",
        steps=(0.15, 0.015),
        shares=shares,
        seeds=seeds,
    )
    free = dataclasses.replace(layers, damping=0.0)
    found = [shipped, dataclasses.replace(shipped, name="ten velocities, without damping", scene=free)]
    if quick:
        return found
    few, baffles = max(1, shares // 2), read_scene("baffles-2")
    return [
        *found,
        dataclasses.replace(
            shipped,
            name="velocities of a hundred blocks, ten of them",
            scene=hundred,
            names=tuple(f"masses[{index}].velocity_x" for index in sampled(len(hundred.masses))),
            steps=(0.15, 0.005),
            shares=few,
        ),
        dataclasses.replace(
            shipped,
            name="friction of ten layers",
            names=tuple(f"masses[{index}].friction_deg" for index in range(10)),
            unit="deg",
            steps=(2.0, 0.2),
            shares=few,
        ),
        Flow(
            name="two baffles along z, in 3D, of the toe",
            scene=dataclasses.replace(baffles, step_fraction=STEADY * lone_particle_step(baffles.material, 3)),
            names=("baffles[0].z", "baffles[1].z"),
            unit="m",
            steps=(0.02, 0.002),
            seeds=seeds,
        ),
    ]


def coarse(scene: Scene) -> Scene:
    """`scene` in coarse cells."""
    return dataclasses.replace(scene, domain=dataclasses.replace(scene.domain, cell=COARSE))


def agreement(flow: Flow) -> list[dict[str, str | float]]:
    """The rows of the table of a flow, one for each step of the differences."""
    at_once = processors()
    ours: list[Floats] = []
    theirs: list[list[Floats]] = [[] for _ in flow.steps]
    cut = 0.0
    groups = [range(first, min(first + at_once, flow.seeds)) for first in range(0, flow.seeds, at_once)]
    for group in tqdm(groups, desc=flow.name, unit="group", dynamic_ncols=True):
        scenes = [dataclasses.replace(flow.scene, seed=seed) for seed in group]
        jacobians, most = by_adjoint(scenes, flow.names, flow.observe())
        ours += jacobians
        for step, found in zip(flow.steps, theirs, strict=True):
            found += [by_differences(scene, flow.names, step, flow.observe()) for scene in scenes]
        cut = max(cut, most)
    return [row(flow, step, ours, found, cut) for step, found in zip(flow.steps, theirs, strict=True)]


def row(flow: Flow, step: float, ours: list[Floats], theirs: list[Floats], cut: float) -> dict[str, str | float]:
    """A row of the table: Jacobians [M, U] of every seed by the adjoint and by differences of `step`."""
    mean, reference = np.mean(ours, axis=0), np.mean(theirs, axis=0)
    return {
        "Jacobian": flow.name,
        "numbers x unknowns": f"{len(reference)} x {reference.shape[1]}",
        "seeds": str(flow.seeds),
        "step": f"{step:g} {flow.unit}",
        "cosine": cosine(mean, reference),
        "length": float(np.linalg.norm(mean) / np.linalg.norm(reference)),
        "differences, two halves of the seeds": cosine(np.mean(theirs[::2], axis=0), np.mean(theirs[1::2], axis=0)),
        "cosine, one seed": float(np.mean([cosine(each, reference) for each in ours])),
        "cut": cut,
    }


def cosine(a: Floats, b: Floats) -> float:
    """Of two arrays as vectors."""
    return float(np.sum(a * b) / (np.linalg.norm(a) * np.linalg.norm(b)))


def by_adjoint(scenes: Sequence[Scene], names: Sequence[str], observe: Observe) -> tuple[list[Floats], float]:
    """Jacobian [M, U] of the numbers of each scene, the scenes side by side; and the largest share that was cut."""
    kinds = [kind(name) for name in names]
    count = len(observe(torch.from_numpy(initial_particles(scenes[0]).positions)))
    tape = Tape(scenes, [scenes[0].frames - 1], precision="f32", memory_mib=TAPE_MIB, outputs=count)
    given = [slopes(tape.positions(index)[-1], observe) for index in range(len(scenes))]
    adjoints = [[FlowAdjoints(own[row][None], np.zeros_like(own[row])[None]) for own in given] for row in range(count)]
    rows = pull_back_all(tape, adjoints)
    found = []
    for index, scene in enumerate(scenes):
        run, values = Run(scene, kinds=kinds), np.array([each.read(scene) for each in kinds])
        found.append(np.array([run.derivatives(row[index], values) for row in rows]))
    return found, max(each.cut for row in rows for each in row)


def slopes(positions: Floats, observe: Observe) -> Floats:
    """d(numbers)/d(positions), shape [M, N, D]."""
    points = torch.tensor(positions, requires_grad=True)
    numbers = observe(points)
    return np.stack([torch.autograd.grad(each, points, retain_graph=True)[0].numpy() for each in numbers])


def by_differences(scene: Scene, names: Sequence[str], step: float, observe: Observe) -> Floats:
    """The same by central differences, the runs side by side."""
    kinds = [kind(name) for name in names]
    values = np.array([each.read(scene) for each in kinds])
    moves = step * np.eye(len(kinds))
    scenes = [with_kinds(scene, kinds, values + sign * move) for sign in (1.0, -1.0) for move in moves]
    runs = simulate_many(scenes, record=LAST)
    found = [observe(torch.from_numpy(run.positions[-1].astype(np.float64))) for run in runs]
    ahead, behind = np.split(torch.stack(found).numpy(), 2)
    return np.asarray((ahead - behind).T / (2.0 * step))
