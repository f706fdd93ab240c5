"""Samples of the datasets for a training: drawn, thinned, turned, and side by side as a `Batch`."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from datasets import measures
from datasets.errors import InputError
from datasets.training.samples import Flow, Flows, Sample, cut, load_flows, reflected
from datasets.trajectory import open_trajectory
from gns.initial import conditions_of
from gns.settings import UP, ModelSettings, TrainingSettings
from gns.simulator import Normalisation, Simulator
from gns.state import Conditions, State, Tensors
from gns.units import Units
from gns.unroll import unroll

SHARE_EARLY = 0.12
"""Share of the samples not of the first frame that start just after it, with a history from the initial velocities."""
SHARE_MOVING = 0.70
"""Share of them that starts while the flow moves; the rest starts anywhere: deposits at rest must stay."""
TRIES = 16
"""Random times among which one is chosen at which the flow moves."""
MOMENTS = 3
"""Times before the end of a rollout at which it may end as well."""
SAMPLED_TIMES = 2048
"""Times in all over which the statistics run; where there are fewer, all."""


def flows_of(dataset: Path, split: str, settings: ModelSettings, *, progress: bool = False) -> Flows:
    """The trajectories of a split (`train`, `valid`, `test`) of a dataset, at the model's step. Raises InputError."""
    return load_flows(dataset, split, partial(flow_of, settings=settings), progress=progress)


def flow_of(path: Path, settings: ModelSettings) -> Flow:
    """The flow in a file at the model's step. Raises InputError, which names the file.

    Where the frames are a step apart in the units in which a rollout of the scene runs, so is the flow; other flows are
    taken at the size that they have.
    """
    trajectory = open_trajectory(path)
    scene, units = trajectory.scene, Units()
    if scene.dimension != settings.dimension:
        raise InputError(f"expected a {settings.dimension}D trajectory, got {scene.dimension}D", where=str(path))
    if scene.gravity > 0.0:
        own = Units.of_model(scene, settings)
        units = own if math.isclose(trajectory.frame_dt, own.time * settings.step, rel_tol=1.0e-9) else units
    flow = Flow.from_trajectory(trajectory, units.time * settings.step, str(path), spacing=units.length * settings.cell)
    return flow.over(units.length, units.time, units.stress)


def stretch(flow: Flow, settings: ModelSettings, *, now: int, steps: int, rng: np.random.Generator) -> Sample:
    """The stretch of a flow with `steps` targets after index `now`; rng: which particles stay."""
    history, cell, kept = settings.history, settings.cell, settings.particles_per_cell
    return cut(flow, now=now, steps=steps, history=history, cell=cell, kept=kept, rng=rng)


@dataclass(frozen=True, kw_only=True)
class Batch(Tensors):
    """Samples side by side: where they start, what is constant during their rollout, and where it should lead."""

    state: State
    conditions: Conditions
    targets: Tensor
    """Positions after each of the coming steps [m], shape [K, N, D]."""


def batched(samples: Sequence[Sample], settings: ModelSettings) -> Batch:
    """Join samples; they have equally many targets."""

    def joined(name: str, axis: int = 0) -> Tensor:
        return torch.from_numpy(np.concatenate([getattr(sample, name) for sample in samples], axis=axis))

    states = [
        State.observed(
            torch.from_numpy(sample.frames),
            torch.from_numpy(sample.velocity0),
            step=settings.step,
            history=settings.history,
        )
        for sample in samples
    ]
    counts = torch.tensor([len(sample.friction) for sample in samples])
    return Batch(
        state=State.joined(states),
        conditions=conditions_of(
            [sample.surroundings for sample in samples],
            friction=joined("friction"),
            cohesion=joined("cohesion"),
            volume=joined("volume"),
            spacing=settings.cell,
            batch=torch.arange(len(samples)).repeat_interleave(counts),
        ),
        targets=joined("targets", axis=1),
    )


class Sampler:
    """Draws training samples of the datasets, their flows alike, each in a random one of its symmetries."""

    def __init__(self, datasets: Sequence[Sequence[Flow]], settings: ModelSettings, training: TrainingSettings) -> None:
        self._datasets, self._settings, self._training = datasets, settings, training
        shares = np.array(training.shares or [1.0] * len(datasets))
        self._shares = shares / shares.sum()

    def batch(self, steps: int, rng: np.random.Generator) -> Batch:
        """Samples with `steps` targets, side by side."""
        samples = [self.sample(steps, rng) for _ in range(self._training.batch)]
        return batched(samples, self._settings)

    def sample(self, steps: int, rng: np.random.Generator) -> Sample:
        """A sample with `steps` targets."""
        flows = self._datasets[int(rng.choice(len(self._datasets), p=self._shares))]
        flow = flows[int(rng.integers(len(flows)))]
        now = self._start(flow, len(flow.positions) - 1 - steps, rng)
        return turned(stretch(flow, self._settings, now=now, steps=steps, rng=rng), self._settings.cell, rng)

    def _start(self, flow: Flow, last: int, rng: np.random.Generator) -> int:
        """Index at which a sample starts, at most `last`."""
        if rng.random() < self._training.first:
            return 0
        kind = rng.random()
        if kind < SHARE_EARLY:
            return min(int(rng.integers(1, 2 * self._settings.history + 1)), last)
        anywhere = rng.integers(0, last + 1, size=TRIES)
        if kind < SHARE_EARLY + SHARE_MOVING:
            # The first that moves is a random one of those that move, and only two frames of each are read.
            return next((int(now) for now in anywhere if flow.moves(int(now))), int(anywhere[0]))
        return int(anywhere[0])


@dataclass(frozen=True, kw_only=True)
class Ends(Batch):
    """Batch of rollouts by a model, from their starts to some end; the target is where the MPM's flow is then."""

    end: State
    whole: Tensor
    """`measured` of all particles of the MPM's flow then, along each level axis [m], shape [B, A, 2 + SHARES]."""


class Rollouts(Sampler):
    """Draws ends of rollouts by a model as it is; each is rolled out once, where it is first drawn, and then kept."""

    def __init__(
        self,
        datasets: Sequence[Sequence[Flow]],
        settings: ModelSettings,
        training: TrainingSettings,
        simulator: Simulator,
    ) -> None:
        super().__init__(datasets, settings, training)
        self._simulator = simulator
        self._kept: dict[tuple[int, ...], list[tuple[Sample, State, Tensor]]] = {}

    def batch(self, steps: int, rng: np.random.Generator) -> Ends:
        """Ends side by side: half of them the flow's own, the other at any time."""
        drawn = [self._drawn(rng) for _ in range(self._training.batch)]
        together = batched([sample for sample, _, _ in drawn], self._settings)
        return Ends(
            state=together.state,
            conditions=together.conditions,
            targets=together.targets,
            end=State.joined([end for _, end, _ in drawn]),
            whole=torch.stack([whole for _, _, whole in drawn]),
        )

    def _drawn(self, rng: np.random.Generator) -> tuple[Sample, State, Tensor]:
        """One of the ends of a random rollout, the last of them as often as all others."""
        dataset = int(rng.choice(len(self._datasets), p=self._shares))
        key = dataset, int(rng.integers(len(self._datasets[dataset]))), int(rng.integers(self._training.rollouts))
        if key not in self._kept:
            self._kept[key] = self._rolled_out(self._datasets[dataset][key[1]], np.random.default_rng(key))
        ends = self._kept[key]
        return ends[-1] if rng.random() < 0.5 else ends[int(rng.integers(len(ends)))]

    def _rolled_out(self, flow: Flow, rng: np.random.Generator) -> list[tuple[Sample, State, Tensor]]:
        """A rollout of the flow to its end, and `MOMENTS` before it: what it began with, with one target, where the
        model is then, and `measured` of the whole flow."""
        settings, last = self._settings, len(flow.positions) - 1
        now, seed = self._start(flow, last - 1, rng), rng.integers(2**32)
        every = dataclasses.replace(settings, particles_per_cell=len(flow.volume))
        sample, whole = (
            turned(stretch(flow, each, now=now, steps=last - now, rng=rng), settings.cell, np.random.default_rng(seed))
            for each in (settings, every)
        )
        batch = batched([sample], settings).to(self._simulator.displacement_scale.device)
        with torch.no_grad():
            positions = unroll(self._simulator, batch.state, batch.conditions, last - now, corrected=False).cpu()
        moments = sorted({last - now, *(int(each) for each in rng.integers(1, last - now + 1, size=MOMENTS))})
        moved = torch.cat((batch.state.displacements.cpu(), positions[1:] - positions[:-1]))
        return [
            (
                dataclasses.replace(sample, targets=sample.targets[step - 1 : step]),
                State(positions=positions[step].clone(), displacements=moved[step : step + settings.history].clone()),
                measured(torch.from_numpy(whole.targets[step - 1]), torch.from_numpy(whole.volume)),
            )
            for step in moments
        ]


def measured(positions: Tensor, volume: Tensor) -> Tensor:
    """Ends and equal shares of a flow along each level axis [m], shape [A, 2 + SHARES], differentiably.

    The end at larger coordinates, that at smaller ones times -1, and the middles of equal shares of the volume, as
    `datasets.measures` has them along x. positions: [m], shape [N, D]; volume: of the particles [m^D], shape [N].
    """
    found = []
    for axis in (axis for axis in range(positions.shape[1]) if axis != UP):
        x, order = positions[:, axis].sort()
        ordered = volume[order]
        for line, along in ((x, ordered), (-x.flip(0), ordered.flip(0))):
            found.append((torch.from_numpy(measures.tail_weights(along.cpu().numpy())).to(x) @ line).unsqueeze(0))
        middle = ordered.cumsum(dim=0) - 0.5 * ordered
        share = (torch.arange(measures.SHARES).to(x) + 0.5) / measures.SHARES * ordered.sum()
        after = torch.searchsorted(middle, share).clamp(1, len(x) - 1)
        part = ((share - middle[after - 1]) / (middle[after] - middle[after - 1])).clamp(0.0, 1.0)
        found.append(torch.lerp(x[after - 1], x[after], part))
    return torch.cat(found).view(-1, 2 + measures.SHARES)


def turned(sample: Sample, spacing: float, rng: np.random.Generator) -> Sample:
    """The sample in a random one of the symmetries of its box; spacing: between two elevations of its ground [m]."""
    size = sample.surroundings.size
    for axis in (axis for axis in range(len(size)) if axis != UP):
        if rng.random() < 0.5:
            sample = reflected(sample, axis, spacing)
    if len(size) == 3 and rng.random() < 0.5:
        sample = reflected(sample, None, spacing)
    return sample


def statistics(datasets: Sequence[Sequence[Flow]]) -> Normalisation:
    """Normalisation constants, over times at which the flows move.

    Of each flow as many random times are read as make `SAMPLED_TIMES` in all, at least two; always the same ones.
    """
    displacement, acceleration, count = 0.0, 0.0, 0
    friction = []
    share = max(2, -(-SAMPLED_TIMES // sum(map(len, datasets))))
    rng = np.random.default_rng(0)
    for flow in (flow for flows in datasets for flow in flows):
        friction.append(flow.friction.mean(dtype=np.float64))
        times = len(flow.positions) - 2
        for time in rng.choice(times, min(share, times), replace=False):
            if not flow.moves(time):
                continue
            moved = np.diff(flow.positions[time : time + 3], axis=0)
            change = moved[1] - moved[0]
            change -= flow.surroundings.gravity * flow.step**2
            displacement += float(np.square(moved[0], dtype=np.float64).sum())
            acceleration += float(np.square(change, dtype=np.float64).sum())
            count += change.size
    return Normalisation(
        displacement_scale=float(np.sqrt(displacement / max(count, 1))) or 1.0,
        acceleration_scale=float(np.sqrt(acceleration / max(count, 1))) or 1.0,
        friction_mean=float(np.mean(friction)),
        friction_std=float(np.std(friction)) or 1.0,
    )
