"""`python -m gns.train`: fit a model to trajectories of the MPM, within a budget of minutes or updates."""

import dataclasses
import itertools
import sys
from collections.abc import Iterable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
from cyclopts import Parameter
from tqdm import tqdm

from datasets import command_line, files
from datasets.errors import InputError
from datasets.lock import locked
from datasets.processes import stopping
from datasets.training.samples import Flow, Flows
from gns.card import length_of_training
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.score import evaluate, table, validation_score
from gns.training.budget import Budget, Clock
from gns.training.convergence import total_updates
from gns.training.distributed import joined
from gns.training.flows import flows_of
from gns.training.log import Log
from gns.training.objective import Curriculum, statistics, unrolled_steps
from gns.training.progress import Bar
from gns.training.update import LAST, Run, TrainingSettings

MODEL = ModelSettings()
TRAINING = TrainingSettings()


def train(
    *datasets: Path,
    out: Path,
    minutes: float = 60.0,
    updates: int | None = None,
    clock: Literal["wall", "cpu"] = "wall",
    resume: bool = False,
    begin: Path | None = None,
    seed: int = 0,
    threads: int = 1,
    device: Literal["cpu", "cuda"] | None = None,
    mixed: bool = False,
    memory_gib: float = 4.0,
    tensorboard: bool = False,
    model: Annotated[ModelSettings, Parameter(name="*")] = MODEL,
    training: Annotated[TrainingSettings, Parameter(name="*")] = TRAINING,
) -> None:
    """Train a graph network simulator on trajectories of the MPM.

    Leaves OUT/best.safetensors (the model to use), OUT/last.safetensors (what --resume continues), OUT/log.csv and
    OUT/scores.md. Ctrl-C ends the update in progress and leaves OUT/last.safetensors. On several GPUs or processes:
    torchrun --nproc-per-node N -m gns.train ...

    Parameters
    ----------
    datasets
        Folders that `python -m mpm.generate` made.
    out
        Folder of the run.
    minutes
        Time to train, all parts of a resumed run together; curriculum and learning rate are laid over it.
    updates
        Updates to make instead: on a CPU such a run can be repeated to the bit, broken off and resumed or not.
    clock
        What the minutes are: wall time, or time that the process computes.
    resume
        Continue from OUT/last.safetensors; give the other flags again.
    begin
        A model to begin with instead of random weights, of the same settings but for --rest-speed; its
        normalisation stays.
    seed
        Seed of the weights and of the samples.
    threads
        Threads of torch.
    device
        cpu or cuda; a GPU where there is one unless given.
    mixed
        Matrix products in bfloat16, on a GPU.
    memory_gib
        Activations of unrolled steps to keep, per process; what does not fit is computed a second time.
    tensorboard
        Write OUT/tensorboard too.
    """
    torch.set_num_threads(threads)
    torch.manual_seed(seed)
    if resume and not (out / LAST).exists():
        raise InputError(f"expected a run to resume, there is no {LAST}", where=str(out))
    if not memory_gib >= 0.0:
        raise InputError(f"expected a number of at least 0, got {memory_gib}", key="memory_gib")
    budget = Budget(minutes=minutes, updates=updates)
    with joined(device) as processes, locked(out) if processes.first else nullcontext():
        if mixed and processes.device.type != "cuda":
            raise InputError(f"expected a GPU, got {processes.device.type}", key="mixed")
        groups, valid = load(datasets, model, training, progress=processes.first)
        simulator = Simulator(model, statistics(groups)) if begin is None else starting_model(begin, model)
        run = Run(simulator, training, seed=seed, processes=processes, mixed=mixed, memory_gib=memory_gib)
        if resume:
            run.resume(out / LAST)
        provenance = {
            "command": " ".join(["python -m gns.train", *sys.argv[1:]]),
            "seed": seed,
            "begin": None if begin is None else dict(checkpoint.load(begin).provenance),
            "minutes": minutes if updates is None else None,
            "updates": updates,
            "clock": clock,
            "device": str(processes.device),
            "processes": processes.count,
            "mixed": mixed,
            "datasets": [
                f"{path.name}: {len(flows)} trajectories" for path, flows in zip(datasets, groups, strict=True)
            ],
            "training": dataclasses.asdict(training),
        }
        log = None
        if processes.first:
            position = run.position
            log = Log(out, size=position.log_size, updates=position.updates, tensorboard=tensorboard)
        outputs = Outputs(out=out, log=log, valid=valid, provenance=provenance)
        try:
            fit(
                run,
                Curriculum(groups, model, first=training.first, pairs=training.pairs),
                budget,
                Clock(clock),
                outputs,
            )
            if log is not None:
                report_length(out, log, total_updates(provenance) + run.position.updates, model.dimension)
        finally:
            if log is not None:
                log.close()


def load(
    datasets: Sequence[Path], settings: ModelSettings, training: TrainingSettings, *, progress: bool
) -> tuple[list[Flows], list[Flow]]:
    """Training flows of each dataset, and the validation flows chosen of all. Raises InputError."""
    if not datasets:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")

    train, valid = (
        [flows_of(dataset, split, settings, progress=progress) for dataset in datasets] for split in ("train", "valid")
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
    share = max(count - len(moving), (count + 1) // 2)
    chosen = spread(released, share)
    return chosen + spread(moving, count - len(chosen))


def starting_model(path: Path, settings: ModelSettings) -> Simulator:
    """The model at `path` to train on. Raises InputError where its settings are others, but for the speed of rest."""
    simulator = checkpoint.load(path).simulator
    there = dataclasses.asdict(dataclasses.replace(simulator.settings, rest_speed=settings.rest_speed))
    other = [key for key, value in dataclasses.asdict(settings).items() if value != there[key]]
    if other:
        raise InputError(f"expected a model of the settings given, other is {', '.join(other)}", where=str(path))
    # No weight depends on it.
    simulator.settings = settings
    return simulator.train()


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Where a run writes, and the flows of its validations."""

    out: Path
    """Folder of the run."""
    log: Log | None
    """Of the first process."""
    valid: list[Flow]
    """Flows to roll out."""
    provenance: dict[str, object]
    """What made the weights, for the model's file."""


def fit(run: Run, curriculum: Curriculum, budget: Budget, clock: Clock, outputs: Outputs) -> None:
    """Update until the budget is spent, with validations in between. Raises KeyboardInterrupt where it was stopped."""
    training, position, processes = run.training, run.position, run.processes
    last = outputs.out / LAST
    started = clock.now() - position.seconds
    bar = Bar(budget, training.unroll, seconds=position.seconds, batch=training.batch, shown=processes.first)
    # Closed whatever happens: an open bar would be drawn again, after the line that says why the training ended.
    with stopping() as stop, closing(bar):
        while True:
            position.seconds = clock.now() - started
            # The first process decides, so that all unroll the same steps, and a stop of one is a stop of all.
            own = (budget.progress(position.seconds, position.updates), validation_due(run, budget))
            progress, validates, stops = processes.sums(*(own if processes.first else (0.0, 0.0)), stop())
            if stops or (progress >= 1.0 and not position.unscored):
                break
            if validates:
                # Saved first: a stop in the middle of a validation then costs the validation alone.
                run.save(last)
                if outputs.log is not None:
                    with stop.at_once():
                        validate(run, outputs, outputs.log)
                position.seconds = position.validated_seconds = clock.now() - started
                position.validated_updates, position.losses = position.updates, 0.0
                run.save(last)
                continue
            steps, rate = unrolled_steps(training.unroll, progress), run.learning_rate(progress)
            loss = run.update(curriculum, steps=steps, rate=rate)
            if outputs.log is not None:
                outputs.log.update(position.updates, {"loss": loss, "learning_rate": rate})
            position.seconds = clock.now() - started
            progress = budget.progress(position.seconds, position.updates)
            bar.show(progress, seconds=position.seconds, steps=steps, loss=loss)
        run.save(last)
        if stops:
            raise stop.interrupt


def validation_due(run: Run, budget: Budget) -> bool:
    """Whether a validation is due: after its interval and at the end, if there were updates since the last one."""
    training, position = run.training, run.position
    if not position.unscored:
        return False
    if budget.progress(position.seconds, position.updates) >= 1.0:
        return True
    if budget.updates is not None:
        return position.unscored >= training.validate_updates
    return position.seconds - position.validated_seconds >= 60.0 * training.validate_minutes


def validate(run: Run, outputs: Outputs, log: Log) -> None:
    """Score the averaged weights by rollouts, write a row of the log, keep them if they are the best so far."""
    position, averaged = run.position, run.average.module
    assert isinstance(averaged, Simulator)
    scores = evaluate(averaged, outputs.valid, seed=0)
    total = validation_score(scores)
    released = [score for score in scores if score.released] or scores
    row = {
        "minutes": round(position.seconds / 60.0, 2),
        "updates": position.updates,
        "unrolled_steps": position.steps,
        "loss": round(position.losses / position.unscored, 6),
        "score": round(total, 4),
        "front_error_released": round(float(np.mean([abs(score.front_error) for score in released])), 4),
        "profile_error_released": round(float(np.mean([score.profile_error for score in released])), 4),
        "front_error": round(float(np.mean([abs(score.front_error) for score in scores])), 4),
        "profile_error": round(float(np.mean([score.profile_error for score in scores])), 4),
        "kinetic_error": round(float(np.mean([score.kinetic_error for score in scores])), 4),
    }
    log.row(row)
    position.log_size = log.size
    tqdm.write(", ".join(f"{key} {value}" for key, value in row.items()))
    if total < position.best:
        position.best = total
        checkpoint.save(outputs.out / "best.safetensors", averaged, {**outputs.provenance, "score": total, "log": row})
        files.write_text(outputs.out / "scores.md", table(scores))


def report_length(out: Path, log: Log, updates: int, dimension: int) -> None:
    """Print how the training compares with that of the shipped model, and write it below the table of OUT/scores.md."""
    line = length_of_training(updates, dimension, log.column("score"))
    print(line)
    scores = (out / "scores.md").read_text().split("\n\n")[0].rstrip()
    files.write_text(out / "scores.md", f"{scores}\n\n{line}\n")


if __name__ == "__main__":
    sys.exit(command_line.run(train, "python -m gns.train"))
