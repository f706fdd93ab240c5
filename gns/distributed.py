"""Data-parallel training of one model by multiple processes: `torchrun --nproc-per-node N -m gns.train ...`.

Each process draws its own samples; `DistributedDataParallel` arranges in its `forward` that the gradients are averaged,
so a model must be called as a module, never by its methods. Without torchrun there is one process, and nothing to do.
"""

import datetime
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import distributed

from datasets.errors import InputError
from datasets.processes import end_with_parent

TIMEOUT = datetime.timedelta(hours=6)
"""How long a process waits for the others: the first validates while they wait."""


@dataclass(frozen=True, kw_only=True)
class Processes:
    """The processes that train together, and the device of this one."""

    device: torch.device
    """Where this process computes."""
    rank: int = 0
    """Which of them this is."""
    count: int = 1
    """How many there are."""

    @property
    def first(self) -> bool:
        """Whether this is the process that validates, logs and saves."""
        return self.rank == 0

    def sums(self, *values: float) -> list[float]:
        """Each of `values`, summed over the processes."""
        if self.count == 1:
            return list(values)
        tensor = torch.tensor(values, dtype=torch.float64, device=self.device)
        distributed.all_reduce(tensor)
        return [float(value) for value in tensor.tolist()]

    def share(self, particles: int) -> float:
        """Weight of this process's mean over its `particles` in the mean over the processes [-].

        Averaged with these weights, means over the particles of each are the mean over all, and so are their
        gradients: as those of one process with all samples.
        """
        return self.count * particles / self.sums(particles)[0]


@contextmanager
def joined(device: str | None) -> Iterator[Processes]:
    """The processes that torchrun started, or this one alone, on `device`: a GPU where there is one unless given.

    Raises InputError.
    """
    kind = device or ("cuda" if torch.cuda.is_available() else "cpu")
    if kind == "cuda" and not torch.cuda.is_available():
        raise InputError("expected a GPU that torch can use, there is none", key="device")
    count = int(os.environ.get("WORLD_SIZE", "1"))
    where = torch.device(kind, int(os.environ.get("LOCAL_RANK", "0"))) if kind == "cuda" else torch.device(kind)
    if kind == "cuda":
        torch.cuda.set_device(where)
    if count == 1:
        yield Processes(device=where)
        return
    # Orphans of torchrun would train on.
    end_with_parent()
    distributed.init_process_group("nccl" if kind == "cuda" else "gloo", timeout=TIMEOUT)
    try:
        yield Processes(device=where, rank=distributed.get_rank(), count=count)
    finally:
        distributed.destroy_process_group()
