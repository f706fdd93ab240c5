"""Data-parallel training of a model by multiple processes: `torchrun --nproc-per-node N -m gns.train ...`.

Each process draws its own samples; `DistributedDataParallel` arranges in its `forward` that the gradients are averaged,
so a model must be called as a module, never by its methods. Without it there is one process, and nothing to do.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import distributed

from datasets.errors import InputError
from datasets.processes import end_with_parent


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
    """Join the processes that torchrun started, if any; the device of this one, a GPU where there is one unless given.

    Raises InputError.
    """
    kind = device or ("cuda" if torch.cuda.is_available() else "cpu")
    if kind == "cuda" and not torch.cuda.is_available():
        raise InputError("expected a GPU that torch can use, there is none", key="device")
    where = torch.device(kind, int(os.environ.get("LOCAL_RANK", "0"))) if kind == "cuda" else torch.device(kind)
    if kind == "cuda":
        torch.cuda.set_device(where)
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield where
        return
    # Orphans of torchrun would train on.
    end_with_parent()
    distributed.init_process_group("nccl" if kind == "cuda" else "gloo")
    try:
        yield where
    finally:
        distributed.destroy_process_group()
