"""Data-parallel training of a model by multiple processes: `torchrun --nproc-per-node N -m gns.train ...`, `together`.

Each process draws its own samples; `DistributedDataParallel` arranges in its `forward` that the gradients are averaged,
so a model must be called as a module, never by its methods. Without either there is one process, and nothing to do.
"""

import os
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

import torch
from torch import distributed

from datasets.errors import InputError, WorkFailed
from datasets.processes import end_with_parent, without_main

ENDING = 10.0
"""Time that a process has to end after the first one [s]; it ends with it at the latest."""


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


def together(count: int, work: Callable[..., None], *arguments: Any) -> None:
    """Call `work`, which joins (`joined`), here and in `count` - 1 processes beside this one, each on one thread.

    `work` and its arguments are pickled. Raises what `work` raises here, and WorkFailed where another process ends.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    common = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": str(count)}
    own = common | {"RANK": "0"}
    others = [
        get_context("spawn").Process(target=beside, args=(common | {"RANK": str(number)}, work, arguments), daemon=True)
        for number in range(1, count)
    ]
    with without_main():
        for other in others:
            other.start()
    try:
        os.environ.update(own)
        work(*arguments)
    except WorkFailed:
        raise
    except RuntimeError as error:
        if all(other.exitcode in (None, 0) for other in others):
            raise
        raise WorkFailed("a process of the training has ended; the same command again goes on") from error
    finally:
        for name in own:
            os.environ.pop(name)
        for other in others:
            other.join(ENDING)


def beside(environment: Mapping[str, str], work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Call `work` in a process of `together`: the first one says what there is to say."""
    os.environ.update(environment)
    torch.set_num_threads(1)
    try:
        work(*arguments)
    except (KeyboardInterrupt, WorkFailed):
        raise SystemExit(1) from None
