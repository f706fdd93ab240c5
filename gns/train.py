"""`python -m gns.train`: fit a model to trajectories of the MPM, for as many minutes as it is given."""

import csv
import dataclasses
import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from cyclopts import Parameter
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from tqdm import tqdm

from datasets import command_line, files
from datasets.errors import InputError
from datasets.samples import Flow, load_flows
from gns import checkpoint
from gns.batch import batched, perturbed
from gns.objective import Curriculum, rollout_loss, statistics, unrolled_steps
from gns.score import badness, evaluate, table
from gns.settings import ModelSettings
from gns.simulator import Simulator
from gns.unroll import unroll


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """How a model is fitted."""

    batch: int = 3
    """Samples per update."""
    unroll: tuple[int, ...] = (1, 2, 4, 4, 8, 8, 12, 12)
    """Steps to train through; the entries share the time equally."""
    learning_rate: float = 1.0e-3
    """Learning rate of Adam at the start."""
    final_learning_rate: float = 1.0e-5
    """At the end; half a cosine in between."""
    warmup: int = 100
    """Updates over which the learning rate rises from zero."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    noise: float = 5.0e-5
    """Random walk in the given displacements while training through single steps [m]."""
    loss_scale: float = 0.25
    """Errors up to this share of the accelerations' standard deviation count squared, larger ones linearly."""
    average: float = 0.998
    """Decay of the running average of the weights, which is what is scored and shipped."""
    validate_minutes: float = 5.0
    """Minutes between two validations."""
    validate_flows: int = 8
    """Flows to roll out then, half of them released at rest."""

    def __post_init__(self) -> None:
        for key in ("batch", "learning_rate", "loss_scale", "validate_minutes", "validate_flows"):
            if not getattr(self, key) > 0:
                raise InputError(f"expected a positive number, got {getattr(self, key)}", key=key)
        if not self.unroll or min(self.unroll) < 1:
            raise InputError(f"expected integers of at least 1, got {list(self.unroll)}", key="unroll")


MODEL = ModelSettings()
TRAINING = TrainingSettings()


class Run:
    """A training in progress: everything that `last.pt` must bring back."""

    def __init__(self, simulator: Simulator, training: TrainingSettings, seed: int) -> None:
        self.training = training
        self.simulator = simulator
        self.average = AveragedModel(simulator, avg_fn=self._averaged)
        self.optimiser = torch.optim.Adam(simulator.parameters(), lr=training.learning_rate)
        self.rng = np.random.default_rng(seed)
        self.generator = torch.Generator().manual_seed(seed)
        self.elapsed = 0.0
        self.updates = 0
        self.best = math.inf

    def _averaged(self, average: Tensor, current: Tensor, updates: Tensor | int) -> Tensor:
        """The running average, short at first: the weights of the beginning are forgotten soon."""
        decay = min(self.training.average, (1.0 + int(updates)) / (10.0 + int(updates)))
        return torch.lerp(current, average, decay)

    def set_learning_rate(self, progress: float) -> None:
        """At `progress` in [0, 1] of the time."""
        training = self.training
        cosine = 0.5 * (1.0 + math.cos(math.pi * progress))
        rate = training.final_learning_rate + (training.learning_rate - training.final_learning_rate) * cosine
        for group in self.optimiser.param_groups:
            group["lr"] = rate * min(1.0, (self.updates + 1) / max(training.warmup, 1))

    def update(self, curriculum: Curriculum, size: tuple[float, ...], gravity: float, steps: int) -> float:
        """One update of the weights through `steps` steps; returns the loss."""
        settings, training = self.simulator.settings, self.training
        samples = [curriculum.draw(steps, self.rng) for _ in range(training.batch)]
        batch = batched(samples, size=size, gravity=gravity, step=settings.step, history=settings.history)
        if steps == 1 and training.noise > 0.0:
            batch = perturbed(batch, training.noise, self.generator)
        positions = unroll(self.simulator, batch.state, batch.conditions, steps, kept_steps=steps)
        scale = training.loss_scale * float(self.simulator.acceleration_scale)
        loss = rollout_loss(positions, batch.targets, scale)
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.simulator.parameters(), training.clip)
        self.optimiser.step()
        self.average.update_parameters(self.simulator)
        self.updates += 1
        return loss.item()

    def save(self, path: Path) -> None:
        """Write `last.pt`."""
        content = {
            "settings": dataclasses.asdict(self.simulator.settings),
            "weights": self.simulator.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "rng": json.dumps(self.rng.bit_generator.state),
            "generator": self.generator.get_state(),
            "elapsed": self.elapsed,
            "updates": self.updates,
            "best": self.best,
        }
        with files.replacing(path) as part:
            torch.save(content, part)

    def resume(self, path: Path) -> None:
        """Bring back what `save` wrote. Raises InputError."""
        content = checkpoint.read(path)
        try:
            settings = ModelSettings(**content["settings"])
            if settings != self.simulator.settings:
                raise InputError("expected the model settings that the run was begun with", where=str(path))
            self.simulator.load_state_dict(content["weights"])
            self.average.load_state_dict(content["average"])
            self.optimiser.load_state_dict(content["optimiser"])
            self.rng.bit_generator.state = json.loads(content["rng"])
            self.generator.set_state(content["generator"])
            self.elapsed, self.updates, self.best = content["elapsed"], content["updates"], content["best"]
        except (KeyError, TypeError, RuntimeError) as error:
            raise InputError(f"expected a whole run, {str(error).splitlines()[0]}", where=str(path)) from None


def pick(flows: list[Flow], count: int) -> list[Flow]:
    """At most `count` flows, half of them released at rest where there are enough, spread over the list."""

    def spread(some: list[Flow], wanted: int) -> list[Flow]:
        wanted = min(wanted, len(some))
        return [some[index * len(some) // wanted] for index in range(wanted)]

    released = [flow for flow in flows if flow.released]
    moving = [flow for flow in flows if not flow.released]
    share = max(count - len(moving), (count + 1) // 2)
    chosen = spread(released, share)
    return chosen + spread(moving, count - len(chosen))


def load(datasets: tuple[Path, ...], settings: ModelSettings, limit: int) -> tuple[list[list[Flow]], list[Flow]]:
    """Training flows of each dataset, and the validation flows of all. Raises InputError."""
    if not datasets:
        raise InputError("expected at least one dataset, a folder that python -m mpm.generate made", key="DATASET")
    train, valid = [], []
    for dataset in datasets:
        train.append(load_flows(dataset, "train", step=settings.step, dimension=settings.dimension, progress=True))
        valid += load_flows(dataset, "valid", step=settings.step, dimension=settings.dimension, progress=True)
    first = train[0][0]
    for flow in (flow for flows in (*train, valid) for flow in flows):
        if (flow.size, flow.gravity) != (first.size, first.gravity):
            raise InputError(f"expected the domain and gravity of {first.name}", where=flow.name)
        if len(flow.positions) <= 2 * settings.history + 1:
            raise InputError(f"expected more than {len(flow.positions)} steps of {settings.step:g} s", where=flow.name)
    return train, pick(valid, limit)


def train(
    *datasets: Path,
    out: Path,
    minutes: float = 60.0,
    resume: bool = False,
    seed: int = 0,
    threads: int = 1,
    model: Annotated[ModelSettings, Parameter(name="*")] = MODEL,
    training: Annotated[TrainingSettings, Parameter(name="*")] = TRAINING,
) -> None:
    """Train a graph network simulator on trajectories of the MPM.

    Leaves OUT/best.pt (the model to use), OUT/last.pt (what --resume continues), OUT/log.csv and OUT/scores.md.

    Parameters
    ----------
    datasets
        Folders that `python -m mpm.generate` made.
    out
        Folder of the run.
    minutes
        Time to train, all parts of a resumed run together; curriculum and learning rate are laid over it.
    resume
        Continue from OUT/last.pt.
    seed
        Seed of the weights and of the samples.
    threads
        Threads of torch.
    """
    torch.set_num_threads(threads)
    torch.manual_seed(seed)
    if resume and not (out / "last.pt").exists():
        raise InputError("expected a run to resume, there is no last.pt", where=str(out))
    groups, valid = load(datasets, model, training.validate_flows)
    size, gravity = groups[0][0].size, groups[0][0].gravity
    curriculum = Curriculum(groups, model)
    simulator = Simulator(model, statistics([flow for flows in groups for flow in flows]))
    run = Run(simulator, training, seed)
    if resume:
        run.resume(out / "last.pt")
    budget = 60.0 * minutes
    provenance = {
        "command": " ".join(["python -m gns.train", *sys.argv[1:]]),
        "seed": seed,
        "minutes": minutes,
        "datasets": [f"{path.name}: {len(flows)} trajectories" for path, flows in zip(datasets, groups, strict=True)],
        "training": dataclasses.asdict(training),
    }
    losses: list[float] = []
    validated = run.elapsed
    clock = time.perf_counter()
    bar = tqdm(
        total=round(budget),
        initial=round(run.elapsed),
        unit="s",
        bar_format="{desc} {bar} {n}/{total} s, {remaining} left",
    )
    try:
        while run.elapsed < budget:
            progress = run.elapsed / budget
            steps = unrolled_steps(training.unroll, progress)
            run.set_learning_rate(progress)
            losses.append(run.update(curriculum, size, gravity, steps))
            now = time.perf_counter()
            run.elapsed, clock = run.elapsed + now - clock, now
            bar.n = min(round(run.elapsed), round(budget))
            rate = len(losses) * training.batch / max(run.elapsed - validated, 1.0e-9)
            bar.set_description_str(f"{steps} steps, loss {np.mean(losses[-100:]):.4f}, {rate:.1f} samples/s")
            if run.elapsed - validated >= 60.0 * training.validate_minutes or run.elapsed >= budget:
                validate(run, valid, out, steps, float(np.mean(losses)), provenance)
                # Validation counts as training time: the minutes given are the minutes taken.
                now = time.perf_counter()
                run.elapsed, clock = run.elapsed + now - clock, now
                validated, losses = run.elapsed, []
                run.save(out / "last.pt")
    finally:
        bar.close()
        run.save(out / "last.pt")


def validate(run: Run, valid: list[Flow], out: Path, steps: int, loss: float, provenance: dict[str, object]) -> None:
    """Score the averaged weights by rollouts, write a line of the log, keep them if they are the best so far."""
    averaged = run.average.module
    assert isinstance(averaged, Simulator)
    scores = evaluate(averaged, valid, seed=0)
    total = badness(scores)
    released = [score for score in scores if score.released] or scores
    row = {
        "minutes": round(run.elapsed / 60.0, 2),
        "updates": run.updates,
        "unrolled_steps": steps,
        "loss": round(loss, 6),
        "score": round(total, 4),
        "front_error_released": round(float(np.mean([abs(score.front_error) for score in released])), 4),
        "profile_error_released": round(float(np.mean([score.profile_error for score in released])), 4),
        "front_error": round(float(np.mean([abs(score.front_error) for score in scores])), 4),
        "profile_error": round(float(np.mean([score.profile_error for score in scores])), 4),
        "rmse_quarter": round(float(np.mean([score.rmse[0] for score in scores])), 5),
        "rmse_half": round(float(np.mean([score.rmse[1] for score in scores])), 5),
        "rmse_end": round(float(np.mean([score.rmse[2] for score in scores])), 5),
    }
    log = out / "log.csv"
    out.mkdir(parents=True, exist_ok=True)
    new = not log.exists()
    with log.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row))
        if new:
            writer.writeheader()
        writer.writerow(row)
    tqdm.write(", ".join(f"{key} {value}" for key, value in row.items()))
    if total < run.best:
        run.best = total
        checkpoint.save(out / "best.pt", averaged, {**provenance, "score": total, "log": row})
        files.write_text(out / "scores.md", table(scores))


if __name__ == "__main__":
    sys.exit(command_line.run(train, "python -m gns.train"))
