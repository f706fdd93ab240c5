"""The training: the loop that lowers a loss (`gns.training.losses`) within a budget of minutes or updates.

Matrices are trained by Muon (Jordan et al. 2024), its steps as long as Adam's (Liu et al. 2025, arXiv 2502.16982,
section 2.2), so that both share a learning rate; all else by Adam. A running average of the weights is scored and
shipped. A training fits either the steps of a model, and drops an older correction, or only its correction.

Several processes (`torchrun --nproc-per-node N -m gns.train ...`) draw their own samples and train on the mean of their
gradients, which `DistributedDataParallel` takes if a model is called as a module.
"""

import hashlib
import io
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel
from tqdm import tqdm

from datasets import files
from datasets.command_line import invocation
from datasets.errors import InputError, WorkFailed, require
from datasets.files import reading
from datasets.flow.measures import amounts
from datasets.lock import locked
from datasets.processes import end_with_parent, stopping
from datasets.scene import Scene
from gns import card, checkpoint
from gns.checkpoint import Model
from gns.library import BEST
from gns.network.correction import Correction
from gns.score import evaluate, table, validation_score
from gns.settings import SEED, ModelSettings, TrainingSettings
from gns.simulator import Simulator
from gns.training.losses import EndLoss, UnrolledLoss
from gns.training.samples import Flow, Flows, Rollouts, Sampler, flows_of, statistics

LAST = "last.pt"  # the file of a run that --resume continues: weights, their average, optimisers, position
RECENT = 100  # updates over which the shown loss is a mean
BAR = "{desc} {bar} {percentage:.0f} % [{elapsed} < {remaining}]"


@dataclass(kw_only=True)
class Position:
    """The progress of a run."""

    seconds: float = 0.0  # time spent [s], by the clock of the settings
    updates: int = 0  # also the position in the data: each update has its own random stream
    best: float = math.inf  # smallest score of a validation
    scored: tuple[float, int] = (0.0, 0)  # seconds and updates at the last validation
    rows: list[dict[str, float]] = field(default_factory=list)  # of log.csv, one per validation
    validated: list[float] = field(default_factory=list)  # time that each validation took [s]
    losses: list[float] = field(default_factory=list)  # one per update
    data: str = ""  # digest of the flows and of the initial weights: scores of others do not compare (`digest`)

    def progress(self, training: TrainingSettings) -> float:
        """Share of the budget that is spent, in [0, 1]."""
        return min(share_of(training, self.seconds, self.updates), 1.0)

    def due(self, training: TrainingSettings) -> bool:
        """Whether a validation is due: after its interval and at the end, if there were updates since the last one.
        Before the end only if this validation and the last one keep validations within their share of the minutes."""
        wanted = self.progress(training) - share_of(training, *self.scored) >= 1.0 / training.validations - 1.0e-9
        if training.updates is None and self.validated:
            spent, once, share = sum(self.validated), self.validated[-1], training.validation_share
            most = min(share * self.seconds, 60.0 * share * training.minutes - once)
            wanted = wanted and spent + once <= most
        return (wanted or self.progress(training) >= 1.0) and self.updates > self.scored[1]


def share_of(training: TrainingSettings, seconds: float, updates: int) -> float:
    """Share of the budget that `seconds` or `updates` make up."""
    return seconds / (60.0 * training.minutes) if training.updates is None else updates / training.updates


def learning_rate(training: TrainingSettings, progress: float, updates: int) -> float:
    """The learning rate at `progress` in [0, 1] of the budget, after `updates`."""
    cosine = 0.5 * (1.0 + math.cos(math.pi * progress))
    rate = training.final_learning_rate + (training.learning_rate - training.final_learning_rate) * cosine
    return rate * min(1.0, (updates + 1) / max(training.warmup, 1))


def fit(
    datasets: Sequence[Path],
    out: Path,
    *,
    model: ModelSettings,
    training: TrainingSettings,
    begin: Model | None = None,
    resume: bool = False,
    anew: bool = False,
    seed: int = 0,
    device: str | None = None,
) -> None:
    """Train a model, as `gns.train`. anew: whether to begin anew where the run to resume had other flows or other
    initial weights, which otherwise raises InputError. Raises InputError, WorkFailed and KeyboardInterrupt."""
    require(SEED.hold(seed), "--seed", SEED.expected, seed)
    if resume and not (out / LAST).exists():
        raise InputError(f"expected a run to resume, there is no {LAST}", where=str(out))
    if not resume and (out / LAST).exists():
        raise InputError(f"holds a training: --resume continues {LAST}, another --out starts anew", where=str(out))
    if training.correct and begin is None:
        raise InputError("expected a model to begin with, whose rollouts are corrected", key="--begin")
    with ExitStack() as stack:
        where, first = stack.enter_context(joined(device)), rank() == 0
        if first:
            stack.enter_context(locked(out))
        torch.manual_seed(seed)
        flows, valid = load(datasets, model, training, progress=first)
        scenes: dict[str, list[Scene]] = {}
        for path, some in zip(datasets, flows, strict=True):
            # Folders of the same name are parts of one dataset.
            scenes.setdefault(path.name, []).extend(flow.scene for flow in some)
        data = digest([*scenes.values(), [flow.scene for flow in valid]], begin)
        simulator = untrained(model, flows) if begin is None else continued(begin, model, training)
        run = TrainingRun(simulator.to(where), flows, training, out, seed, data)
        if resume:
            run.restore(anew=anew)
        provenance = {"command": invocation(), "seed": seed, "begin": begin and begin.provenance}
        provenance |= {"datasets": [str(path) for path in datasets], "training": asdict(training)}
        position, bar = run.position, stack.enter_context(tqdm(total=100.0, bar_format=BAR, disable=not first))
        stop = stack.enter_context(stopping())
        clock = time.process_time if training.clock == "cpu" else time.perf_counter
        begun, baseline = clock() - position.seconds, begin is not None and training.validations > 1
        while True:
            position.seconds = clock() - begun
            # The first process decides, so that all unroll the same steps; if one stops, all stop.
            wanted = position.due(training) or (baseline and not position.rows)
            progress, due, stops = sums(first * position.progress(training), first and wanted, stop())
            # However short the time, a training leaves a model.
            if stops or (progress >= 1.0 and not due and position.updates):
                break
            if not due:
                run.update(progress)
                what = "ends" if training.correct else f"{run.steps(progress)} steps"
                bar.set_description_str(f"{what}, loss {np.mean(position.losses[-RECENT:]):.4f}", refresh=False)
                bar.update(100.0 * position.progress(training) - bar.n)
                continue
            if first:
                # Saved before, so that a stop loses no updates, and after.
                run.save()
                with stop.at_once():
                    run.validate(valid, scenes, provenance)
            position.validated.append(clock() - begun - position.seconds)
            position.seconds = clock() - begun
            position.scored = position.seconds, position.updates
            if first:
                run.save()
        if first:
            run.save()
        if stops:
            raise stop.interrupt
        # Otherwise the line would follow the bar.
        bar.close()
        if first:
            history = checkpoint.load(out / BEST).provenance
            new, total = history["log"]["updates"], card.total_updates(history)
            of = f" of {position.updates:,}" if new < position.updates else ""
            print(f"{out / BEST}: {new:,}{of} updates" + (f", {total:,} with those before" if total > new else ""))


class TrainingRun:
    """A training: the model and its average, the samples and their loss, the optimisers, and the position."""

    def __init__(
        self, simulator: Simulator, flows: Sequence[Flows], training: TrainingSettings, out: Path, seed: int, data: str
    ) -> None:
        self.simulator, self.training, self.out, self.seed = simulator, training, out, seed
        self.average: Any = AveragedModel(simulator, avg_fn=partial(averaged, training.average))
        loss: nn.Module
        if simulator.correction is None:
            self.sampler, loss = Sampler(flows, simulator.settings, training), UnrolledLoss(simulator, training)
        else:
            self.sampler = rollouts = Rollouts(flows, simulator, training)
            loss = EndLoss(simulator, rollouts, training)
        self.loss = DistributedDataParallel(loss) if distributed.is_initialized() else loss
        self.free = [weight for weight in simulator.parameters() if weight.requires_grad]
        matrices = [weight for weight in self.free if weight.dim() == 2]
        muon = torch.optim.Muon(matrices, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
        adam = torch.optim.Adam([weight for weight in self.free if weight.dim() != 2])
        self.optimisers: tuple[torch.optim.Optimizer, ...] = muon, adam
        self.parts: dict[str, Any] = {"weights": simulator, "average": self.average, "muon": muon, "adam": adam}
        self.position = Position(data=data)

    def steps(self, progress: float) -> int:
        unrolled = self.training.unroll
        return unrolled[min(int(progress * len(unrolled)), len(unrolled) - 1)]

    def update(self, progress: float) -> None:
        """Draw a batch and lower its loss. Raises WorkFailed for a gradient that is not finite."""
        updates = self.position.updates
        rate = learning_rate(self.training, progress, updates)
        batch = self.sampler.batch(self.steps(progress), np.random.default_rng([self.seed, rank(), updates]))
        loss = self.loss(batch.to(self.free[0].device))
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.free, self.training.clip)
        if not math.isfinite(norm):
            raise WorkFailed(f"the gradient of update {updates + 1} is not finite; {LAST} holds an earlier state")
        for optimiser in self.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = rate
            optimiser.step()
            optimiser.zero_grad()
        self.average.update_parameters(self.simulator)
        self.position.updates += 1
        self.position.losses.append(loss.item())

    def validate(self, flows: Sequence[Flow], scenes: Mapping[str, list[Scene]], provenance: Mapping[str, Any]) -> None:
        """Score the average by rollouts of `flows`, log it with a picture, and save the model with its card if best."""
        simulator, position, out = self.average.module.eval(), self.position, self.out
        scores = evaluate(simulator, flows)
        total = validation_score(scores)
        loss = float(np.mean(position.losses[position.scored[1] - position.updates :] or [math.nan]))
        row = {"minutes": round(position.seconds / 60.0, 2), "updates": position.updates, "loss": round(loss, 6)}
        row |= {name: round(mean, 4) for name, mean in ({"score": total} | amounts(scores)).items()}
        position.rows.append(row)
        lines = [row, *(logged.values() for logged in position.rows)]
        files.write_text(out / "log.csv", "".join(",".join(map(str, line)) + "\n" for line in lines))
        draw(out / "log.png", position)
        tqdm.write(", ".join(f"{key} {value}" for key, value in row.items()))
        if total <= position.best:
            position.best, history = total, {**provenance, "score": total, "log": row}
            checkpoint.save(out / BEST, simulator, history)
            card.write(out / BEST, card.describe(simulator, history, scenes, table(scores)))
            files.write_text(out / "scores.md", table(scores))

    def save(self) -> None:
        states = {name: part.state_dict() for name, part in self.parts.items()}
        settings, content = asdict(self.simulator.settings), io.BytesIO()
        torch.save({"settings": settings, "position": asdict(self.position), **states}, content)
        # Written by Python: torch's own writer raises a RuntimeError if the disk is full.
        with files.replacing(self.out / LAST) as unfinished:
            unfinished.write_bytes(content.getbuffer())

    def restore(self, *, anew: bool) -> None:
        """Continue from the saved run in `out`; anew: as for `fit`. Raises InputError."""
        with reading(self.out / LAST, f"the {LAST} of a run of these settings"):
            saved = torch.load(self.out / LAST, map_location="cpu", weights_only=True)
            if saved["position"].get("data", self.position.data) != self.position.data:
                if anew:
                    return
                instead = f"another --out with --begin {self.out / BEST} trains on others"
                raise InputError(f"expected the flows and the --begin that the run was begun with; {instead}")
            if saved["settings"] != asdict(self.simulator.settings):
                raise InputError("expected the model settings that the run was begun with")
            for name, part in self.parts.items():
                part.load_state_dict(saved[name])
            self.position = Position(**saved["position"])


def digest(scenes: Sequence[Sequence[Scene]], begin: Model | None) -> str:
    """A digest of the scenes of a training, by dataset, and of the weights that it begins with."""
    weights = {} if begin is None else begin.simulator.state_dict()
    parts = repr(scenes).encode(), *(weight.numpy().tobytes() for weight in weights.values())
    return hashlib.sha256(b"".join(parts)).hexdigest()


def draw(path: Path, position: Position) -> None:
    """The loss of each update and a running mean, and the score of each validation with its parts."""
    from matplotlib.figure import Figure

    figure, losses = Figure(figsize=(9.0, 3.6), layout="constrained"), np.array(position.losses)
    left, right = figure.subplots(1, 2)
    window = max(1, min(RECENT, len(losses) // 5))
    for mean, style in ((1, {"marker": ".", "markersize": 2, "linestyle": "", "color": "0.7"}), (window, {})):
        last = np.arange(mean, len(losses) + 1)
        sums = np.append(0.0, np.cumsum(losses))
        left.plot(position.updates - len(losses) + last, (sums[last] - sums[last - mean]) / mean, **style)
    for name in ("score", "front", "profile", "thickness"):
        right.plot(*zip(*((row["updates"], row[name]) for row in position.rows), strict=True), ".-", label=name)
    right.legend(frameon=False, fontsize=8)
    for panel, title in ((left, f"loss, and its mean over {window} updates"), (right, "errors of whole rollouts")):
        panel.set_title(title, loc="left", fontsize=10)
        panel.set(xlabel="updates", yscale="log")
    with files.replacing(path) as part:
        figure.savefig(part, dpi=110)


def averaged(decay: float, average: Tensor, current: Tensor, updates: Tensor) -> Tensor:
    """The running average, at first over few updates, so that the initial weights soon lose their share."""
    return torch.lerp(current, average, min(decay, (1.0 + int(updates)) / (10.0 + int(updates))))


def load(
    datasets: Sequence[Path], settings: ModelSettings, training: TrainingSettings, *, progress: bool
) -> tuple[list[Flows], list[Flow]]:
    """Training flows of each dataset, and validation flows chosen from all. Raises InputError."""
    if not datasets:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")
    count = len(training.shares)
    require(count in (0, len(datasets)), "shares", f"{len(datasets)} shares, one of each dataset", count)
    train, valid = (
        [flows_of(dataset, split, settings, progress=progress) for dataset in datasets] for split in ("train", "valid")
    )
    frames = max(2 * settings.history + 1, 1 if training.correct else max(training.unroll))
    for flow in chain.from_iterable((*train, *valid)):
        if len(flow.positions) <= frames:
            message = f"expected at least {frames} steps of {settings.step:g} s, got {len(flow.positions) - 1}"
            raise InputError(message, where=flow.name)
    every = list(chain.from_iterable(valid))
    count = min(training.validate_flows, len(every))
    # At random, because kinds of scenes alternate: every third flow may be a column.
    chosen = np.random.default_rng(0).choice(len(every), count, replace=False)
    return train, [every[index] for index in sorted(chosen)]


def untrained(settings: ModelSettings, flows: Sequence[Flows]) -> Simulator:
    """An initial model: random weights, and the mean upward acceleration of the data, which bears the weight. Random
    weights alone start in free fall and take thousands of updates to reach it."""
    normalisation, upward = statistics(flows)
    simulator = Simulator(settings, normalisation)
    list(simulator.network.decoder.parameters())[-1].data[1] = upward
    return simulator


def continued(model: Model, settings: ModelSettings, training: TrainingSettings) -> Simulator:
    """A model to continue training. Raises InputError if its settings differ, except for the speed of rest."""
    simulator = model.simulator
    there = asdict(replace(simulator.settings, rest_speed=settings.rest_speed))
    if other := [key for key, value in asdict(settings).items() if value != there[key]]:
        raise InputError(f"expected a model with the settings given, these differ: {', '.join(other)}", key="--begin")
    # No weight depends on the speed of rest.
    simulator.settings = settings
    if not training.correct:
        simulator.correction = None
        return simulator.train().requires_grad_(True)
    correction = simulator.requires_grad_(False).correction or Correction(settings)
    simulator.correction = correction.train().requires_grad_(True)
    return simulator


def rank() -> int:
    """Which process this is; the first, 0, validates, logs and saves."""
    return distributed.get_rank() if distributed.is_initialized() else 0


def sums(*values: float) -> list[float]:
    """Each of `values`, summed over the processes."""
    tensor = torch.tensor(values, dtype=torch.float64)
    if distributed.is_initialized():
        tensor = tensor.to("cuda" if distributed.get_backend() == "nccl" else "cpu")
        distributed.all_reduce(tensor)
    return [float(value) for value in tensor.tolist()]


@contextmanager
def joined(device: str | None) -> Iterator[torch.device]:
    """Join the processes of torchrun, if any; gives this one's device, a GPU if there is one. Raises InputError."""
    kind = device or ("cuda" if torch.cuda.is_available() else "cpu")
    where = torch.device(kind)
    if kind == "cuda":
        if not torch.cuda.is_available():
            raise InputError("expected a GPU that torch can use, there is none", key="device")
        where = torch.device(kind, int(os.environ.get("LOCAL_RANK", "0")))
        torch.cuda.set_device(where)
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield where
        return
    # Otherwise orphans of torchrun would continue to train.
    end_with_parent()
    distributed.init_process_group("nccl" if kind == "cuda" else "gloo")
    try:
        yield where
    finally:
        distributed.destroy_process_group()
