"""Samples of the datasets for a training: drawn, thinned, mirrored, and joined as a `SampleBatch`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from datasets.definitions.training import thin
from datasets.errors import InputError, naming, require
from datasets.flow import measures
from datasets.flow.trajectory import Floats, open_trajectory, trajectory_files
from datasets.scene import Scene
from datasets.scene.particles import observed_cohesion
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator, unroll
from gns.surroundings.forces import Normalisation
from gns.surroundings.initial import check, conditions_of, resampled
from gns.surroundings.solids import Below
from gns.surroundings.state import Conditions, State, Tensors, in_model_units
from gns.surroundings.units import Units

MOVING = 0.02  # root mean square speed above which a flow counts as moving, in the units of the model [m/s]
# Of samples that do not start at the first frame: the share that starts just after it, with a history from the initial
# velocities, and the share that starts while the flow moves. The rest starts anywhere: deposits at rest must stay.
SHARE_EARLY, SHARE_MOVING = 0.12, 0.70
NEARLY = 0.03  # share of a step: frames this close to a step apart count as a step apart
TRIES = 16  # random times, of which the first at which the flow moves is chosen
MOMENTS = 3  # further times before the end at which a rollout may end
SAMPLED_TIMES = 2048  # total number of times for the statistics; all, if there are fewer


@dataclass(frozen=True, kw_only=True)
class Flow:
    """One trajectory at a model's step, with all of its particles."""

    name: str  # the file it came from
    scene: Scene
    positions: Floats  # one step apart [m], shape [T, N, D]; may be memory-mapped
    velocity0: Floats  # initial velocities [m/s], shape [N, D]
    conditions: Conditions  # of these particles; N volumes, frictions and cohesions
    step: float  # time between two positions [s]

    @property
    def units(self) -> Units:
        return self.conditions.units

    @property
    def volume(self) -> NDArray[np.float32]:
        """Initial volume of each particle [m^D], shape [N]."""
        return self.conditions.volume.numpy()

    def moves(self, time: int) -> bool:
        """Whether the flow moves from index `time` to the next."""
        displacements = self.positions[time + 1] - self.positions[time]
        return float(np.square(displacements).sum(axis=1).mean()) > (MOVING * self.units.speed * self.step) ** 2


@dataclass(frozen=True)
class Flows(Sequence[Flow]):
    """Flows on disk, each opened when it is accessed."""

    files: Sequence[Path]
    settings: ModelSettings

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: Any) -> Any:
        with naming(self.files[index]):
            return flow_of(self.files[index], self.settings)


def flows_of(dataset: Path | str, split: str, settings: ModelSettings, *, progress: bool = False) -> Flows:
    """The flows of a split (`train`, `valid`, `test`) of a dataset, each opened once. Raises InputError."""
    dataset = Path(dataset)
    files = trajectory_files(dataset / split)
    if not files:
        raise InputError(f"expected trajectories in {split}/*.npz or *.h5, there are none", where=str(dataset))
    flows = Flows(files, settings)
    for _ in tqdm(flows, desc=f"{dataset.name}/{split}", unit="file", disable=not progress):
        pass
    return flows


def flow_of(path: Path, settings: ModelSettings) -> Flow:
    """The flow in a file at the model's step, in the units of a rollout of its scene: every n-th frame if that fits the
    step to `NEARLY`, else interpolated linearly in time. Raises InputError."""
    trajectory = open_trajectory(path)
    scene, frame_dt = trajectory.scene, trajectory.frame_dt
    check(scene, settings)
    scaled = settings.body_length is not None and scene.gravity > 0.0
    units = Units.of_model(scene, settings) if scaled else Units()
    step = units.time * settings.step
    stride = max(1, round(step / frame_dt))
    if abs(stride * frame_dt - step) <= (NEARLY if scaled else 1.0e-6) * step:
        positions, step = trajectory.positions[::stride], stride * frame_dt
        units = Units.of_time(scene, settings, step / settings.step) if scaled else units
    else:
        require(scaled, "", f"frames {step:g} s apart or a whole fraction of it", f"{frame_dt:g}")
        expected = f"frames at most {step:.4g} s apart, the model's step for a body of this size"
        require(frame_dt < step, "", expected, f"{frame_dt:g}")
        positions = resampled(trajectory, step)
    volumes = trajectory.volumes.astype(np.float32)
    cohesion = observed_cohesion(scene, np.asarray(positions[0]), trajectory.mass)
    around = conditions_of(scene, units.length * settings.cell, trajectory.friction, cohesion, volumes, units)
    velocity0 = trajectory.velocity0
    return Flow(name=str(path), scene=scene, positions=positions, velocity0=velocity0, conditions=around, step=step)


@dataclass(frozen=True, kw_only=True)
class SampleBatch(Tensors):
    """Samples side by side in the units of the model: initial states, conditions and targets."""

    state: State
    conditions: Conditions
    targets: Tensor  # positions after each of the coming steps [m], shape [K, N, D]


def stretch(flow: Flow, settings: ModelSettings, *, now: int, steps: int, rng: np.random.Generator) -> SampleBatch:
    """A sample: a part of a flow with `steps` targets after index `now`; rng chooses the particles (`thin`)."""
    cell, kept = flow.units.length * settings.cell, settings.particles_per_cell
    particles, volumes = thin(flow.positions[0], flow.volume, cell=cell, kept=kept, rng=rng)
    first = max(0, now - settings.history)
    frames = torch.from_numpy(np.asarray(flow.positions[first : now + 1 + steps, particles]))
    past, future = frames.tensor_split([now + 1 - first])
    state = State.observed(past, torch.from_numpy(flow.velocity0[particles]), step=flow.step, history=settings.history)
    of_particles = {name: getattr(flow.conditions, name)[particles] for name in ("friction", "cohesion")}
    conditions = replace(flow.conditions, volume=torch.from_numpy(volumes), **of_particles)
    state, conditions = in_model_units(state, conditions)
    return SampleBatch(state=state, conditions=conditions, targets=future / flow.units.length)


def batched(samples: Sequence[SampleBatch]) -> SampleBatch:
    """Join samples; they have equally many targets."""
    state, targets = State.joined([sample.state for sample in samples]), [sample.targets for sample in samples]
    conditions = Conditions.joined([sample.conditions for sample in samples])
    return SampleBatch(state=state, conditions=conditions, targets=torch.cat(targets, dim=1))


class Sampler:
    """Draws training samples from the datasets, all flows of one equally often, each in a random symmetry."""

    def __init__(self, datasets: Sequence[Sequence[Flow]], settings: ModelSettings, training: TrainingSettings) -> None:
        self._datasets, self._settings, self._training = datasets, settings, training
        shares = np.array(training.shares or [1.0] * len(datasets))
        self._shares = shares / shares.sum()

    def batch(self, steps: int, rng: np.random.Generator) -> SampleBatch:
        """Samples with `steps` targets, side by side."""
        return batched([self.sample(steps, rng) for _ in range(self._training.batch)])

    def sample(self, steps: int, rng: np.random.Generator) -> SampleBatch:
        dataset, index = self._drawn(rng)
        flow = self._datasets[dataset][index]
        now = self._start(flow, len(flow.positions) - 1 - steps, rng)
        return turned(stretch(flow, self._settings, now=now, steps=steps, rng=rng), rng)

    def _drawn(self, rng: np.random.Generator) -> tuple[int, int]:
        dataset = int(rng.choice(len(self._datasets), p=self._shares))
        return dataset, int(rng.integers(len(self._datasets[dataset])))

    def _start(self, flow: Flow, last: int, rng: np.random.Generator) -> int:
        """Index at which a sample starts, at most `last`."""
        if rng.random() < self._training.first:
            return 0
        kind = rng.random()
        if kind < SHARE_EARLY:
            return min(int(rng.integers(1, 2 * self._settings.history + 1)), last)
        anywhere: list[int] = rng.integers(0, last + 1, size=TRIES).tolist()
        # The first time at which the flow moves is a random such time, and only two frames are read for each.
        moving = filter(flow.moves, anywhere if kind < SHARE_EARLY + SHARE_MOVING else ())
        return next(moving, anywhere[0])


@dataclass(frozen=True, kw_only=True)
class Ends(SampleBatch):
    """A batch of rollouts by a model from their starts to some end; the target is the MPM's flow at that time."""

    end: State
    whole: Tensor  # `measured` for all particles of the MPM's flow at that time [m], shape [B, A, 2 + SHARES]


class Rollouts(Sampler):
    """Draws ends of rollouts by a fixed model; each is rolled out when it is first drawn, and then kept."""

    def __init__(self, datasets: Sequence[Sequence[Flow]], simulator: Simulator, training: TrainingSettings) -> None:
        super().__init__(datasets, simulator.settings, training)
        self._simulator = simulator
        self._kept: dict[tuple[int, ...], list[Ends]] = {}

    def batch(self, steps: int, rng: np.random.Generator) -> Ends:
        """Ends side by side: half of them at the end of a flow, the others at any time."""
        drawn = [self._end(rng) for _ in range(self._training.batch)]
        end, whole = State.joined([ends.end for ends in drawn]), torch.cat([ends.whole for ends in drawn])
        return Ends(**vars(batched(drawn)), end=end, whole=whole)

    def _end(self, rng: np.random.Generator) -> Ends:
        """One of the ends of a random rollout; the last is drawn as often as all others together."""
        dataset, index = self._drawn(rng)
        key = dataset, index, int(rng.integers(self._training.rollouts))
        if key not in self._kept:
            self._kept[key] = self._rolled_out(self._datasets[dataset][index], np.random.default_rng(key))
        ends = self._kept[key]
        return ends[-1] if rng.random() < 0.5 else ends[int(rng.integers(len(ends)))]

    def _rolled_out(self, flow: Flow, rng: np.random.Generator) -> list[Ends]:
        """A rollout of the flow to its end, and `MOMENTS` before it."""
        last = len(flow.positions) - 1
        now, seed = self._start(flow, last - 1, rng), rng.integers(2**32)
        steps, every = last - now, replace(self._settings, particles_per_cell=len(flow.volume))
        drawn = (stretch(flow, settings, now=now, steps=steps, rng=rng) for settings in (self._settings, every))
        sample, whole = (turned(part, np.random.default_rng(seed)) for part in drawn)
        there = sample.to(self._simulator.displacement_scale.device)
        with torch.no_grad():
            positions = unroll(self._simulator, there.state, there.conditions, steps, corrected=False).cpu()
        ends = []
        for step in sorted({steps, *rng.integers(1, steps + 1, size=MOMENTS).tolist()}):
            batch = replace(sample, targets=sample.targets[step - 1 : step])
            required = measured(whole.targets[step - 1], whole.conditions.volume).unsqueeze(0)
            ends.append(Ends(**vars(batch), end=sample.state.after(positions, step), whole=required))
        return ends


def measured(positions: Tensor, volume: Tensor) -> Tensor:
    """Ends and equal shares of a flow along each horizontal axis [m], shape [A, 2 + SHARES], differentiable. These are
    the end at larger coordinates, that at smaller ones times -1, and the middles of equal shares of the volume, as in
    `datasets.flow.measures` along x. positions: [m], shape [N, D]; volume: of the particles [m^D], shape [N]."""
    lengths = []
    for axis in range(0, positions.shape[1], 2):
        x, order = positions[:, axis].sort()
        ordered = volume[order]
        for line, along in ((x, ordered), (-x.flip(0), ordered.flip(0))):
            fitted = torch.from_numpy(measures.tail_weights(along.cpu().numpy())).to(x) @ line
            lengths.append(torch.minimum(fitted, line[-1]).unsqueeze(0))
        middle = ordered.cumsum(dim=0) - 0.5 * ordered
        share = (torch.arange(measures.SHARES).to(x) + 0.5) / measures.SHARES * ordered.sum()
        after = torch.searchsorted(middle, share).clamp(1, len(x) - 1)
        part = ((share - middle[after - 1]) / (middle[after] - middle[after - 1])).clamp(0.0, 1.0)
        lengths.append(torch.lerp(x[after - 1], x[after], part))
    return torch.cat(lengths).view(-1, 2 + measures.SHARES)


def turned(sample: SampleBatch, rng: np.random.Generator) -> SampleBatch:
    """The sample in a random symmetry of its box."""
    axes = sample.targets.shape[2]
    for axis in range(0, axes, 2):
        if rng.random() < 0.5:
            sample = reflected(sample, axis)
    return reflected(sample, None) if axes == 3 and rng.random() < 0.5 else sample


def reflected(sample: SampleBatch, axis: int | None) -> SampleBatch:
    """The same flow in a mirror: along a horizontal `axis`, or in 3D, if that is None, with x and z exchanged."""
    around, ground = sample.conditions, sample.conditions.ground
    order, flip, origin = list(range(around.size.shape[1])), torch.ones_like(around.size[0]), 0.0 * around.size[0]
    if axis is None:
        order.reverse()
    else:
        flip[axis], origin[axis] = -1.0, around.size[0, axis]

    def vectors(values: Tensor) -> Tensor:
        return flip * values[..., order]

    def points(values: Tensor) -> Tensor:
        return origin + vectors(values)

    if ground is not None:
        # The mirrored raster takes at each post the value of the raster at the post's mirror image.
        shape = ground.elevation.mT.shape if axis is None else ground.elevation.shape
        plan = [ground.spacing * torch.arange(count) for count in shape[1:]]
        posts = torch.stack(torch.meshgrid(plan[0], torch.zeros(1), *plan[1:], indexing="ij"), dim=-1)
        image = Below(points(posts.flatten(0, -2)), ground, None)
        rasters: dict[str, Any] = {name: raster for name, raster in vars(ground).items() if isinstance(raster, Tensor)}
        rasters |= {name: image.value(raster).view(shape) for name, raster in rasters.items()}
        ground = replace(ground, **rasters)
    conditions = replace(
        around,
        size=around.size[:, order],
        gravity=vectors(around.gravity),
        # The lower side becomes the upper.
        baffles=None if around.baffles is None else points(around.baffles).sort(dim=2).values,
        baffle_turn=None if around.baffle_turn is None else -around.baffle_turn,
        ground=ground,
    )
    state = State(positions=points(sample.state.positions), displacements=vectors(sample.state.displacements))
    return replace(sample, state=state, conditions=conditions, targets=points(sample.targets))


def statistics(datasets: Sequence[Sequence[Flow]]) -> tuple[Normalisation, float]:
    """Normalisation constants, and the mean upward acceleration without gravity's, over its scale [-]. They are taken
    over random but reproducible times at which the flows move: `SAMPLED_TIMES` in all, at least two per flow. Along
    horizontal axes the mean is 0, because samples are mirrored."""
    squares, upward, count, size, friction = np.zeros(2), 0.0, 0, 0, []
    share = max(2, -(-SAMPLED_TIMES // sum(map(len, datasets))))
    rng = np.random.default_rng(0)
    for flow in (flow for flows in datasets for flow in flows):
        friction.append(float(flow.conditions.friction.double().mean()))
        times = len(flow.positions) - 2
        fall = flow.conditions.gravity.numpy()[0] * (flow.step**2 / flow.units.length)
        for time in filter(flow.moves, rng.choice(times, min(share, times), replace=False)):
            moved, then = np.diff(flow.positions[time : time + 3], axis=0) / flow.units.length
            squares += [np.square(change, dtype=np.float64).sum() for change in (moved, then - moved - fall)]
            upward += float((then - moved - fall)[:, 1].sum(dtype=np.float64))
            count, size = count + len(moved), size + moved.size
    displacement, acceleration = (scale or 1.0 for scale in np.sqrt(squares / max(size, 1)).tolist())
    mean, std = float(np.mean(friction)), float(np.std(friction)) or 1.0
    normalisation = Normalisation(
        displacement_scale=displacement, acceleration_scale=acceleration, friction_mean=mean, friction_std=std
    )
    return normalisation, upward / max(count, 1) / acceleration
