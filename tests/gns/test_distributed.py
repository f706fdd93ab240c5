"""Two processes train on the mean of their gradients."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn.parallel import DistributedDataParallel

from gns.losses import UnrolledLoss
from gns.samples import Batch, batched, flows_of, stretch
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator
from gns.training import LAST, joined, rank
from tests.gns.conftest import TINY, rows

ROOT = Path(__file__).parents[2]
STEPS = 3


def gradients(simulator: Simulator, samples: list[Batch]) -> dict[str, torch.Tensor]:
    """Those of one update, in double precision; one step keeps its activations, the others are checkpointed."""
    batch = batched(samples).to(dtype=torch.float64)
    model: torch.nn.Module = UnrolledLoss(simulator, TrainingSettings(memory_gib=2e-3))
    if torch.distributed.is_initialized():
        model = DistributedDataParallel(model)
    simulator.zero_grad()
    model(batch).backward()
    return {name: value.grad for name, value in simulator.named_parameters() if value.grad is not None}


def work(number: int, port: str, simulator: Simulator, parts: list[list[Batch]], out: Path) -> None:
    """One of two processes."""
    common = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2"}
    os.environ.update(common | {"RANK": str(number)})
    with joined("cpu"):
        torch.save(gradients(simulator, parts[rank()]), out / f"{rank()}.pt")


def test_two_processes_give_the_mean_of_their_gradients(
    lively: Simulator, settings: ModelSettings, dataset: Path, tmp_path: Path
) -> None:
    simulator, rng = lively.double(), np.random.default_rng(0)
    flows = flows_of(dataset, "train", settings)
    samples = [
        stretch(flow, settings, now=now, steps=STEPS, rng=rng) for flow, now in zip(flows, (0, 5, 9), strict=False)
    ]
    parts = [samples[:2], samples[2:]]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    torch.multiprocessing.start_processes(work, (port, simulator, parts, tmp_path), nprocs=2, start_method="fork")
    alone = [gradients(simulator, part) for part in parts]
    first, second = (torch.load(tmp_path / f"{rank}.pt", weights_only=True) for rank in (0, 1))
    assert alone[0].keys() == first.keys()
    for name, value in first.items():
        expected = 0.5 * (alone[0][name] + alone[1][name])
        assert torch.equal(value, second[name])
        assert (value - expected).norm() <= 1e-6 * expected.norm()
        assert expected.norm() > 0.0


@pytest.mark.slow
def test_torchrun_trains_and_resumes(dataset: Path, tmp_path: Path) -> None:
    def run(out: Path, *more: str) -> int:
        command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m"]
        command += ["gns.train", str(dataset), "--out", str(out), *TINY, "--validations", "2", *more]
        subprocess.run(command, cwd=ROOT, check=True, timeout=120)
        return int(torch.load(out / LAST, weights_only=True)["position"]["updates"])

    assert run(tmp_path, "--updates", "6") == 6
    assert len(rows(tmp_path)) == 2
    assert run(tmp_path, "--updates", "8", "--resume") == 8
