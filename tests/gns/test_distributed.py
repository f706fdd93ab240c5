"""Two processes train as one with both their samples."""

import multiprocessing
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.training.samples import Sample, cut, load_flows
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.training.batch import Particles, batched
from gns.training.distributed import Processes, joined
from gns.training.objective import Curriculum
from gns.training.run_file import read
from gns.training.update import Run, TrainingSettings

ROOT = Path(__file__).parents[2]
STEPS = 3


class Given(Curriculum):
    """Always these samples, in double precision."""

    def __init__(self, samples: list[Sample], settings: ModelSettings) -> None:
        self._samples, self._settings = samples, settings

    def batch(self, count: int, steps: int, rng: np.random.Generator) -> Particles:
        """All of them."""
        settings = self._settings
        joint = batched(self._samples, step=settings.step, history=settings.history)
        return joint.apply(lambda values: values.double() if values.is_floating_point() else values)


def updated(simulator: Simulator, samples: list[Sample], processes: Processes) -> dict[str, torch.Tensor]:
    """Gradients of one update, unclipped, and the weights after it."""
    run = Run(simulator, TrainingSettings(clip=1e9), seed=0, processes=processes)
    # One step keeps its activations, the others are checkpointed.
    run.kept_steps = lambda batch: 1  # type: ignore[method-assign]
    run.update(Given(samples, simulator.settings), steps=STEPS, rate=1e-3)
    gradients = {f"gradient {name}": value.grad for name, value in simulator.named_parameters()}
    return {**simulator.state_dict(), **gradients}


def worker(rank: int, port: int, simulator: Simulator, samples: list[Sample], out: Path) -> None:
    """One of two processes, as torchrun starts them."""
    environment = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": 2, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    os.environ.update({key: str(value) for key, value in environment.items()})
    with joined("cpu") as processes:
        assert (processes.rank, processes.count, processes.first) == (rank, 2, rank == 0)
        torch.save(updated(simulator, samples, processes), out / f"{rank}.pt")


def test_two_processes_give_the_gradient_of_one_with_the_joined_batch(
    lively: Simulator, settings: ModelSettings, dataset: Path, tmp_path: Path
) -> None:
    simulator, rng = lively.double(), np.random.default_rng(0)
    flows = load_flows(dataset, "train", step=settings.step, dimension=2, spacing=settings.cell)
    samples = [
        cut(flow, now=now, steps=STEPS, history=settings.history, cell=cell, kept=1, rng=rng)
        for flow, now, cell in zip(flows, (0, 5, 9), (0.01, 0.01, 0.015), strict=False)
    ]
    # Two samples here and one there, of other numbers of particles.
    parts = [samples[:2], samples[2:]]
    assert len({len(sample.friction) for sample in samples}) > 1
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # Forked: torch is there already.
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=worker, args=(rank, port, simulator, parts[rank], tmp_path)) for rank in (0, 1)]
    for each in workers:
        each.start()
    for each in workers:
        each.join(60.0)
    assert [each.exitcode for each in workers] == [0, 0]
    one = updated(simulator, samples, Processes(device=torch.device("cpu")))
    first, second = (torch.load(tmp_path / f"{rank}.pt", weights_only=True) for rank in (0, 1))
    for name, value in one.items():
        assert torch.equal(first[name], second[name])
        if name.startswith("gradient"):
            assert (first[name] - value).norm() <= 1e-6 * value.norm()
            assert value.norm() > 0.0


@pytest.mark.slow
def test_torchrun_trains_stops_and_resumes(dataset: Path, tmp_path: Path) -> None:
    tiny = ["--width", "8", "--layers", "1", "--rounds", "1", "--grid-channels", "4", "--grid-layers", "1"]
    flags = ["--unroll", "1", "--unroll", "2", "--validate-flows", "1", "--validate-updates", "3", "--device", "cpu"]

    def run(out: Path, *more: str) -> None:
        command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m"]
        command += ["gns.train", str(dataset), "--out", str(out), *tiny, *flags, *more]
        subprocess.run(command, cwd=ROOT, check=True, timeout=120)

    run(tmp_path, "--updates", "6")
    described, _ = read(tmp_path / "last.safetensors")
    assert described["position"]["updates"] == 6
    assert checkpoint.load(tmp_path / "best.safetensors").provenance["processes"] == 2
    assert len((tmp_path / "log.csv").read_text().splitlines()) == 3
    run(tmp_path, "--updates", "8", "--resume")
    assert read(tmp_path / "last.safetensors")[0]["position"]["updates"] == 8


def test_without_torchrun_there_is_one_process() -> None:
    with joined("cpu") as processes:
        assert (processes.rank, processes.count) == (0, 1)
        assert processes.sums(1.0, 2.0) == [1.0, 2.0]
        assert processes.share(7) == 1.0
