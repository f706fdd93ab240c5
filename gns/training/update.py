"""A training in progress: one update of the weights, and a checkpoint that continues it to the bit."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.records import Record, from_mapping
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.training import run_file
from gns.training.batch import Particles, perturbed
from gns.training.distributed import Processes
from gns.training.objective import Curriculum, UnrolledLoss
from gns.training.optimiser import Optimiser
from gns.unroll import step_activation_bytes

LAST = "last.safetensors"
"""The file of a run that --resume continues."""
MARGIN = 1.5
"""Some batches have more neighbours a particle than the one whose memory was measured."""
SINGLE = Processes(device=torch.device("cpu"))
"""One process on the CPU."""


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """How a model is fitted."""

    batch: int = 3
    """Samples per update, of each process."""
    unroll: tuple[int, ...] = (1, 2, 4, 4, 8, 8, 12, 12)
    """Steps to train through; the entries share the budget equally."""
    learning_rate: float = 6.0e-4
    """Learning rate at the start."""
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
    first: float = 0.15
    """Share of samples that start with the flow itself: from positions and velocities alone."""
    shares: float = 0.0
    """Weight of the distance between the distributions of the particles and of the truth (`share_loss`)."""
    changes: float = 0.0
    """Weight of the error in the answer to a change, in pairs."""
    pairs: float = 0.0
    """Share of batches that are made of pairs: a flow and its variant."""
    average: float = 0.998
    """Decay of the running average of the weights, which is what is scored and shipped."""
    validate_minutes: float = 5.0
    """Minutes between two validations."""
    validate_updates: int = 500
    """Updates between two validations where the budget is in updates."""
    validate_flows: int = 8
    """Flows to roll out then, half of them released at rest."""

    def __post_init__(self) -> None:
        for key in ("batch", "learning_rate", "loss_scale", "validate_minutes", "validate_updates", "validate_flows"):
            if not getattr(self, key) > 0:
                raise InputError(f"expected a positive number, got {getattr(self, key)}", key=key)
        if not self.unroll or min(self.unroll) < 1:
            raise InputError(f"expected integers of at least 1, got {list(self.unroll)}", key="unroll")


@dataclass(kw_only=True)
class Position(Record):
    """The progress of a run."""

    seconds: float = 0.0
    """Time spent [s], by the run's clock."""
    updates: int = 0
    """Updates made. They are the position in the data too: each has a random stream of its own."""
    steps: int = 0
    """Steps that the last of them was unrolled through."""
    best: float = math.inf
    """Smallest score of a validation."""
    validated_seconds: float = 0.0
    """When the last validation ended [s]."""
    validated_updates: int = 0
    """Updates before it."""
    losses: float = 0.0
    """Sum of the losses since."""
    log_size: int = 0
    """Bytes of log.csv."""
    particle_bytes: float = 0.0
    """Memory that a step's activations take per particle, measured [bytes]; 0 before that."""

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            if getattr(self, each.name) < 0:
                raise InputError(f"expected a number of at least 0, got {getattr(self, each.name)}", key=each.name)

    def as_json(self) -> dict[str, Any]:
        """As the file has it: without the score before there is one, which is infinite."""
        return {key: value for key, value in dataclasses.asdict(self).items() if value != math.inf}

    @property
    def unscored(self) -> int:
        """Updates since the last validation."""
        return self.updates - self.validated_updates


class Run:
    """Weights, their running average, the optimiser and the position: the content of `LAST`.

    No random state is stored: update u of process r draws from the stream (seed, r, u).
    """

    def __init__(
        self,
        simulator: Simulator,
        training: TrainingSettings,
        *,
        seed: int,
        processes: Processes = SINGLE,
        mixed: bool = False,
        memory_gib: float = 4.0,
    ) -> None:
        self.simulator = simulator.to(processes.device)
        self.training, self.seed, self.processes, self.memory_gib = training, seed, processes, memory_gib
        self.average = AveragedModel(self.simulator, avg_fn=self._averaged)
        self.optimiser = Optimiser(self.simulator, training.learning_rate)
        self.model = processes.wrapped(
            UnrolledLoss(
                self.simulator,
                loss_scale=training.loss_scale,
                shares=training.shares,
                changes=training.changes,
                mixed=mixed,
            )
        )
        self.position = Position()

    def _averaged(self, average: Tensor, current: Tensor, updates: Tensor | int) -> Tensor:
        """The running average; over few updates at first, so that the initial weights soon lose their share."""
        decay = min(self.training.average, (1.0 + int(updates)) / (10.0 + int(updates)))
        return torch.lerp(current, average, decay)

    def learning_rate(self, progress: float) -> float:
        """At `progress` in [0, 1] of the budget."""
        training = self.training
        cosine = 0.5 * (1.0 + math.cos(math.pi * progress))
        rate = training.final_learning_rate + (training.learning_rate - training.final_learning_rate) * cosine
        return rate * min(1.0, (self.position.updates + 1) / max(training.warmup, 1))

    def update(self, curriculum: Curriculum, *, steps: int, rate: float) -> float:
        """One update of the weights through `steps` steps at a learning rate; returns the loss of its own samples.

        Raises WorkFailed where the gradient is not finite.
        """
        training, position = self.training, self.position
        rng = np.random.default_rng([self.seed, self.processes.rank, position.updates])
        batch = curriculum.batch(training.batch, steps, rng)
        if steps == 1 and training.noise > 0.0:
            batch = perturbed(batch, training.noise, torch.Generator().manual_seed(int(rng.integers(2**63))))
        batch = batch.to(self.processes.device)
        self.optimiser.zero_grad()
        loss = self.model(batch, self.kept_steps(batch))
        (self.processes.share(batch.targets.shape[1]) * loss).backward()
        norm = torch.nn.utils.clip_grad_norm_(self.simulator.parameters(), training.clip)
        if not math.isfinite(norm):
            raise WorkFailed(f"the gradient of update {position.updates + 1} is not finite; {LAST} is older and whole")
        self.optimiser.step(rate)
        self.average.update_parameters(self.simulator)
        value = loss.item()
        position.updates, position.steps, position.losses = position.updates + 1, steps, position.losses + value
        return float(value)

    def kept_steps(self, batch: Particles) -> int:
        """Steps whose activations fit into the memory; the others are computed a second time, to the same result."""
        particles, steps = batch.targets.shape[1], len(batch.targets)
        if not self.position.particle_bytes:
            measured = step_activation_bytes(
                self.simulator, batch.state, batch.conditions(self.simulator.settings.cell)
            )
            self.position.particle_bytes = MARGIN * measured / particles
        return min(steps, int(self.memory_gib * 2**30 / (self.position.particle_bytes * particles)))

    def save(self, path: Path) -> None:
        """Write `LAST`, by the first process alone: the others hold the same."""
        if self.processes.first:
            described = {
                "settings": dataclasses.asdict(self.simulator.settings),
                "seed": self.seed,
                "position": self.position.as_json(),
            }
            run_file.write(path, described, self.parts())

    def resume(self, path: Path) -> None:
        """Restore what `save` wrote. Raises InputError."""
        try:
            described, tensors = run_file.read(path)
            if from_mapping(ModelSettings, described["settings"]) != self.simulator.settings:
                raise InputError("expected the model settings that the run was begun with")
            if described["seed"] != self.seed:
                raise InputError(f"expected the seed of the run, {described['seed']}", key="seed")
            position = from_mapping(Position, described["position"])
            for name, like in self.parts().items():
                run_file.check(name, like, tensors[name])
        except InputError as error:
            raise error.at(str(path)) from None
        self.simulator.load_state_dict(tensors["weights"])
        self.average.load_state_dict(tensors["average"])
        self.optimiser.load_tensors(tensors["optimiser"])
        self.position = position

    def parts(self) -> dict[str, dict[str, Tensor]]:
        """All that the next update depends on: weights, their average, and the state of the optimiser."""
        return {
            "weights": self.simulator.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.tensors(),
        }
