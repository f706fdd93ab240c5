"""The training: the unrolled loss, and the loop that lowers it within a budget of minutes or updates.

    loss = mean_k h(|x_k - X_k| / (k s)) + h(|v_k - V_k| / s),   h(e) = e^2 / 2 below 1, e - 1/2 above

over the steps k of a rollout. An error in the displacement grows k-fold in the position. Impacts that a step cannot
resolve are far above s and count linearly only: they would drown the flow otherwise. Matrices are trained by Muon
(Jordan et al. 2024), whose steps have singular values of about one, their length matched to Adam's (Liu et al. 2025,
arXiv 2502.16982, section 2.2), so that both share a learning rate; all else by Adam. What is scored and shipped is a
running average of the weights.

| symbol | variable           | meaning                                    |
| x, v   | `positions`        | of the model, and their differences        |
| X, V   | `Particles.targets` | of the MPM                                |
| s      | `scale`            | a share of the accelerations per step [m]  |
"""

import dataclasses
import itertools
import math
import sys
import time
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel
from tqdm import tqdm

from datasets import files
from datasets.errors import InputError, WorkFailed
from datasets.lock import locked
from datasets.processes import stopping
from datasets.reading import reading
from datasets.training.samples import Flow, Flows
from gns import card, checkpoint
from gns.distributed import joined
from gns.samples import Particles, Sampler, flows_of, statistics
from gns.score import evaluate, table, validation_score
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator
from gns.unroll import step_activation_bytes, unroll

LAST = "last.pt"
"""The file of a run that --resume continues: weights, their average, optimisers, position."""
MARGIN = 1.5
"""Some batches have more neighbours a particle than the one whose memory was measured."""
RECENT = 100
"""Updates over which the shown loss is a mean."""


@dataclass(frozen=True, kw_only=True)
class Budget:
    """How long to train: minutes, or updates where they are given. Rate and unrolled steps are laid over it."""

    minutes: float
    """Time to train, all parts of a resumed run together [min]."""
    updates: int | None = None
    """Updates to make instead."""
    processor: bool = False
    """Minutes are of processor time: fair between runs on a busy machine."""

    def __post_init__(self) -> None:
        if not self.minutes > 0.0:
            raise InputError(f"expected a positive number, got {self.minutes}", key="minutes")
        if self.updates is not None and self.updates < 1:
            raise InputError(f"expected an integer of at least 1, got {self.updates}", key="updates")

    def now(self) -> float:
        """Seconds since some start."""
        return time.process_time() if self.processor else time.perf_counter()

    def progress(self, position: "Position") -> float:
        """Share of the budget that is spent, in [0, 1]."""
        spent = position.seconds / (60.0 * self.minutes) if self.updates is None else position.updates / self.updates
        return min(spent, 1.0)


@dataclass(kw_only=True)
class Position:
    """The progress of a run."""

    seconds: float = 0.0
    """Time spent [s], by the budget's clock."""
    updates: int = 0
    """Updates made. They are the position in the data too: each has a random stream of its own."""
    best: float = math.inf
    """Smallest score of a validation."""
    scored_seconds: float = 0.0
    """When the last validation ended [s]."""
    scored_updates: int = 0
    """Updates before it."""
    rows: list[dict[str, float]] = field(default_factory=list)
    """Of log.csv: one a validation."""


class UnrolledLoss(nn.Module):
    """Batch to loss: the whole unroll is one `forward`, as DistributedDataParallel requires."""

    def __init__(self, simulator: Simulator, *, loss_scale: float, memory_gib: float) -> None:
        """loss_scale: s as a share of the accelerations; memory_gib: of the activations that are kept."""
        super().__init__()
        self.simulator, self.loss_scale, self.memory = simulator, loss_scale, memory_gib * 2**30
        self._particle_bytes = 0.0

    def forward(self, batch: Particles) -> Tensor:
        """The loss of unrolling `batch` to its last target."""
        conditions, steps = batch.conditions(self.simulator.settings.cell), len(batch.targets)
        if not self._particle_bytes:
            measured = step_activation_bytes(self.simulator, batch.state, conditions)
            self._particle_bytes = MARGIN * measured / len(batch.pos)
        kept = min(steps, int(self.memory / (self._particle_bytes * len(batch.pos))))
        positions = unroll(self.simulator, batch.state, conditions, steps, kept_steps=kept)
        return rollout_loss(positions, batch.targets, self.loss_scale * self.simulator.acceleration_scale)


def rollout_loss(positions: Tensor, targets: Tensor, scale: float | Tensor) -> Tensor:
    """The loss of a rollout.

    positions: of the model at the start and after each step [m], shape [K + 1, N, D]; targets: [m], [K, N, D];
    scale: s [m].
    """
    steps = torch.arange(1, len(targets) + 1, device=targets.device).view(-1, 1, 1)
    error = (positions[1:] - targets) / scale
    before = torch.cat((torch.zeros_like(error[:1]), error[:-1]))
    zero = torch.zeros_like(error)
    return functional.smooth_l1_loss(error / steps, zero) + functional.smooth_l1_loss(error - before, zero)


def unrolled_steps(schedule: Sequence[int], progress: float) -> int:
    """Steps to train through at `progress` in [0, 1]: the entries of `schedule` share the budget equally."""
    return schedule[min(int(progress * len(schedule)), len(schedule) - 1)]


def learning_rate(training: TrainingSettings, progress: float, updates: int) -> float:
    """At `progress` in [0, 1] of the budget, after so many updates."""
    cosine = 0.5 * (1.0 + math.cos(math.pi * progress))
    rate = training.final_learning_rate + (training.learning_rate - training.final_learning_rate) * cosine
    return rate * min(1.0, (updates + 1) / max(training.warmup, 1))


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to train, on what, and how long."""

    datasets: Sequence[Path]
    """Folders that `python -m mpm.generate` made."""
    out: Path
    """Folder of the run."""
    model: ModelSettings
    training: TrainingSettings
    budget: Budget
    begin: Path | None = None
    """A model to begin with, in place of random weights."""
    resume: bool = False
    """Go on from OUT/last.pt."""
    seed: int = 0
    """Of the weights and of the samples."""
    device: str | None = None
    """cpu or cuda; a GPU where there is one unless given."""
    memory_gib: float = 4.0
    """Activations of unrolled steps to keep, of each process."""
    tensorboard: bool = False
    """Write OUT/tensorboard too."""


def fit(plan: Plan) -> None:
    """Train a model. Raises InputError, WorkFailed, and KeyboardInterrupt where a signal has stopped it."""
    out, training, budget = plan.out, plan.training, plan.budget
    if plan.resume and not (out / LAST).exists():
        raise InputError(f"expected a run to resume, there is no {LAST}", where=str(out))
    with ExitStack() as stack:
        processes = stack.enter_context(joined(plan.device))
        if processes.first:
            stack.enter_context(locked(out))
        flows, valid = load(plan, progress=processes.first)
        torch.manual_seed(plan.seed)
        simulator = (
            Simulator(plan.model, statistics(flows)) if plan.begin is None else beginning(plan.begin, plan.model)
        )
        simulator = simulator.to(processes.device)
        average = AveragedModel(simulator, avg_fn=lambda old, new, count: averaged(old, new, int(count), training))
        matrices = [weight for weight in simulator.parameters() if weight.dim() == 2]
        others = [weight for weight in simulator.parameters() if weight.dim() != 2]
        optimisers: tuple[torch.optim.Optimizer, ...] = (
            torch.optim.Muon(matrices, weight_decay=0.0, adjust_lr_fn="match_rms_adamw"),
            torch.optim.Adam(others),
        )
        loss_of: nn.Module = UnrolledLoss(simulator, loss_scale=training.loss_scale, memory_gib=plan.memory_gib)
        if processes.count > 1:
            loss_of = DistributedDataParallel(loss_of)
        sampler = Sampler(flows, plan.model, training)
        parts = {"weights": simulator, "average": average, "muon": optimisers[0], "adam": optimisers[1]}
        position = restored(out / LAST, plan, parts) if plan.resume else Position()
        board = stack.enter_context(closing(summary_writer(out, position.updates))) if plan.tensorboard else None
        bar = stack.enter_context(tqdm(total=100.0, bar_format=BAR, initial=0.0, disable=not processes.first))
        stop = stack.enter_context(stopping())
        recent: deque[float] = deque(maxlen=RECENT)
        begun = budget.now() - position.seconds
        while True:
            position.seconds = budget.now() - begun
            # The first process decides, so that all unroll the same steps, and a stop of one is a stop of all.
            own = (budget.progress(position), due(position, budget, training)) if processes.first else (0.0, 0.0)
            progress, validates, stops = processes.sums(*own, stop())
            if stops or (progress >= 1.0 and not validates):
                break
            if validates:
                if processes.first:
                    # Saved before, so that a kill costs no updates, and after.
                    save(out / LAST, plan, parts, position)
                    with stop.at_once():
                        row = validate(plan, average.module, valid, position, float(np.mean(recent or [math.nan])))
                    if board is not None:
                        for name, value in row.items():
                            board.add_scalar(f"validation/{name}", value, position.updates)
                position.seconds = position.scored_seconds = budget.now() - begun
                position.scored_updates = position.updates
                recent.clear()
                if processes.first:
                    save(out / LAST, plan, parts, position)
                continue
            steps, rate = unrolled_steps(training.unroll, progress), learning_rate(training, progress, position.updates)
            batch = sampler.batch(steps, np.random.default_rng([plan.seed, processes.rank, position.updates]))
            batch = batch.to(processes.device)
            loss = loss_of(batch)
            (processes.share(len(batch.pos)) * loss).backward()
            norm = nn.utils.clip_grad_norm_(simulator.parameters(), training.clip)
            if not math.isfinite(norm):
                raise WorkFailed(
                    f"the gradient of update {position.updates + 1} is not finite; {LAST} is older and whole"
                )
            for optimiser in optimisers:
                for group in optimiser.param_groups:
                    group["lr"] = rate
                optimiser.step()
                optimiser.zero_grad()
            average.update_parameters(simulator)
            position.updates += 1
            recent.append(loss.item())
            if board is not None:
                board.add_scalar("training/loss", recent[-1], position.updates)
                board.add_scalar("training/learning_rate", rate, position.updates)
            bar.set_description_str(f"{steps} steps, loss {np.mean(recent):.4f}", refresh=False)
            bar.update(100.0 * budget.progress(position) - bar.n)
        if processes.first:
            save(out / LAST, plan, parts, position)
        if stops:
            raise stop.interrupt
        if processes.first:
            describe(plan)


BAR = "{desc} {bar} {percentage:.0f} % [{elapsed} < {remaining}]"


def averaged(average: Tensor, current: Tensor, updates: int, training: TrainingSettings) -> Tensor:
    """The running average; over few updates at first, so that the initial weights soon lose their share."""
    return torch.lerp(current, average, min(training.average, (1.0 + updates) / (10.0 + updates)))


def due(position: Position, budget: Budget, training: TrainingSettings) -> bool:
    """Whether a validation is due: after its interval and at the end, if there were updates since the last one."""
    unscored = position.updates - position.scored_updates
    if not unscored or budget.progress(position) >= 1.0:
        return unscored > 0
    if budget.updates is not None:
        return unscored >= training.validate_updates
    return position.seconds - position.scored_seconds >= 60.0 * training.validate_minutes


def load(plan: Plan, *, progress: bool) -> tuple[list[Flows], list[Flow]]:
    """Training flows of each dataset, and the validation flows chosen of all. Raises InputError."""
    settings, training = plan.model, plan.training
    if not plan.datasets:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")
    if training.shares and len(training.shares) != len(plan.datasets):
        message = f"expected {len(plan.datasets)} shares, one of each dataset, got {len(training.shares)}"
        raise InputError(message, key="shares")
    train, valid = (
        [flows_of(dataset, split, settings, progress=progress) for dataset in plan.datasets]
        for split in ("train", "valid")
    )
    frames = max(2 * settings.history + 1, *training.unroll)
    for flow in (flow for flows in (*train, *valid) for flow in flows):
        if len(flow.positions) <= frames:
            message = f"expected at least {frames} steps of {settings.step:g} s, got {len(flow.positions) - 1}"
            raise InputError(message, where=flow.name)
    return train, pick(itertools.chain(*valid), training.validate_flows)


def pick(flows: Iterable[Flow], count: int) -> list[Flow]:
    """At most `count` flows, half of them released at rest where there are enough, spread over the list."""

    def spread(some: list[Flow], number: int) -> list[Flow]:
        number = min(number, len(some))
        return [some[index * len(some) // number] for index in range(number)]

    every = list(flows)
    released = [flow for flow in every if flow.released]
    moving = [flow for flow in every if not flow.released]
    chosen = spread(released, max(count - len(moving), (count + 1) // 2))
    return chosen + spread(moving, count - len(chosen))


def beginning(path: Path, settings: ModelSettings) -> Simulator:
    """The model at `path` to train on. Raises InputError where its settings are others, but for the speed of rest."""
    simulator = checkpoint.load(path).simulator
    there = dataclasses.asdict(dataclasses.replace(simulator.settings, rest_speed=settings.rest_speed))
    other = [key for key, value in dataclasses.asdict(settings).items() if value != there[key]]
    if other:
        raise InputError(f"expected a model of the settings given, other is {', '.join(other)}", where=str(path))
    # No weight depends on it.
    simulator.settings = settings
    return simulator.train().requires_grad_(True)


def validate(
    plan: Plan, simulator: nn.Module, flows: Sequence[Flow], position: Position, loss: float
) -> dict[str, float]:
    """Score the averaged weights by rollouts, write a row of log.csv, keep them if they are the best so far."""
    assert isinstance(simulator, Simulator)
    scores = evaluate(simulator, flows, seed=0)
    total = validation_score(scores)
    released = [score for score in scores if score.released] or scores

    def mean(name: str, some: Sequence[Any]) -> float:
        return round(float(np.mean([abs(getattr(score, name)) for score in some])), 4)

    row = {
        "minutes": round(position.seconds / 60.0, 2),
        "updates": position.updates,
        "loss": round(loss, 6),
        "score": round(total, 4),
        "front_error_released": mean("front_error", released),
        "profile_error_released": mean("profile_error", released),
        "front_error": mean("front_error", scores),
        "profile_error": mean("profile_error", scores),
        "kinetic_error": mean("kinetic_error", scores),
    }
    position.rows.append(row)
    lines = [",".join(row), *(",".join(str(value) for value in each.values()) for each in position.rows)]
    files.write_text(plan.out / "log.csv", "\n".join(lines) + "\n")
    tqdm.write(", ".join(f"{key} {value}" for key, value in row.items()))
    if total < position.best:
        position.best = total
        checkpoint.save(plan.out / "best.safetensors", simulator, {**provenance(plan), "score": total, "log": row})
        files.write_text(plan.out / "scores.md", table(scores))
    return row


def provenance(plan: Plan) -> dict[str, Any]:
    """What made the weights, for the model's file."""
    return {
        "command": " ".join(["python -m gns.train", *sys.argv[1:]]),
        "seed": plan.seed,
        "begin": None if plan.begin is None else dict(checkpoint.load(plan.begin).provenance),
        "minutes": plan.budget.minutes if plan.budget.updates is None else None,
        "datasets": [str(path) for path in plan.datasets],
        "training": dataclasses.asdict(plan.training),
    }


def describe(plan: Plan) -> None:
    """Write the card of the best model, with the table of its validation, and say how long its training was."""
    best, scores = plan.out / "best.safetensors", plan.out / "scores.md"
    model = checkpoint.load(best)
    written = card.describe(model.simulator, model.provenance, card.stored(plan.datasets), scores.read_text())
    card.write(best, written)
    line = card.length_of_training(written.data.updates or 0, plan.model.dimension)
    print(f"{line}; {best}")


def save(path: Path, plan: Plan, parts: dict[str, Any], position: Position) -> None:
    """Write what `restored` reads."""
    states = {name: part.state_dict() for name, part in parts.items()}
    settings = dataclasses.asdict(plan.model)
    with files.replacing(path) as unfinished:
        torch.save({"settings": settings, "position": dataclasses.asdict(position), **states}, unfinished)


def restored(path: Path, plan: Plan, parts: dict[str, Any]) -> Position:
    """Load the state of a run into its parts, and return its position. Raises InputError."""
    with reading(path, f"the {LAST} of a run of these settings"):
        found = torch.load(path, map_location="cpu", weights_only=True)
        if found["settings"] != dataclasses.asdict(plan.model):
            raise InputError("expected the model settings that the run was begun with")
        for name, part in parts.items():
            part.load_state_dict(found[name])
        return Position(**found["position"])


def summary_writer(out: Path, updates: int) -> Any:
    """TensorBoard's, which is another package. Raises InputError."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        message = "expected the package tensorboard to be installed: pip install tensorboard"
        raise InputError(message, key="tensorboard") from None
    return SummaryWriter(log_dir=str(out / "tensorboard"), purge_step=updates + 1)
