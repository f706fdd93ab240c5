"""Time and memory of a piece of work: measured in turns, so that other load affects all alike, or in a process."""

import ctypes
import gc
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import psutil
from tqdm import tqdm

from datasets.errors import WorkFailed
from datasets.files import read_json, write_json
from datasets.flow.array_files import FrameWriter
from datasets.processes import end_with_parent, without_main
from datasets.scene import Scene
from inverse.answer import peak_memory_mib
from mpm import Recording, simulate

P = ParamSpec("P")
Key = TypeVar("Key")
T = TypeVar("T")
Found = dict[str, Any]  # results and costs of a piece of work, by key
CLEAR = Path("/proc/self/clear_refs")
RESET_PEAK = "5"  # written into CLEAR, it resets the record of the peak


@dataclass(frozen=True)
class Spread:
    """The spread of at least one measurement; formatted as the median, with the range if there is one."""

    values: Sequence[float]

    @property
    def median(self) -> float:
        return statistics.median(self.values)

    def __format__(self, form: str) -> str:
        low, middle, high = (format(value, form) for value in (min(self.values), self.median, max(self.values)))
        return middle if low == high else f"{middle} ({low}-{high})"


def seconds_of(action: Callable[[], object]) -> float:
    """Wall time of `action` [s]."""
    began = time.perf_counter()
    action()
    return time.perf_counter() - began


def turns(work: Mapping[Key, Callable[[], float]], rounds: int, what: str) -> dict[Key, Spread]:
    """The measurements of each work: all works once, then all again, `rounds` times in total."""
    results: dict[Key, list[float]] = {key: [] for key in work}
    with tqdm(total=rounds * len(work), desc=what, unit="run", dynamic_ncols=True) as progress:
        for _ in range(rounds):
            for key, task in work.items():
                results[key].append(task())
                progress.update()
    return {key: Spread(values) for key, values in results.items()}


def isolated(work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
    """`work(...)` in a new interpreter, so that memory left behind by other work does not count. Raises the errors of
    `work`, and WorkFailed if the system killed it."""
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent)
    with without_main(), pool:
        try:
            return pool.submit(work, *args, **kwargs).result()
        except BrokenProcessPool:
            raise WorkFailed("killed, out of memory") from None


def once(path: Path, work: Callable[P, Found], /, *args: P.args, **kwargs: P.kwargs) -> Found:
    """The result of `isolated` work, read from `path` or, if it is not there, computed and stored there."""
    if (result := read_json(path)) is None:
        result = isolated(work, *args, **kwargs)
        write_json(path, result)
    return result


def recorded(scene: Callable[[], Scene], record: Recording, path: Path) -> Found:
    """Cost of a run that writes its frames to `path`: time, time before the first step [s], memory and disk [MiB]."""
    began = time.perf_counter()
    with FrameWriter(path) as file:
        flow = simulate(scene(), record=record, file=file, progress=True)
        file.put(**flow.arrays())
    seconds, compiling = flow.summary["wall_s"], flow.summary["compile_s"]
    return {
        "particles": flow.summary["particles"],
        "steps": flow.summary["steps"],
        "before": time.perf_counter() - began - seconds - compiling,
        "compile": compiling,
        "seconds": seconds,
        "memory": peak_memory_mib(),
        "disk": path.stat().st_size / 2**20,
    }


def reset_peak() -> int:
    """Reset the record of this process's peak memory (`inverse.answer.peak_memory_mib`); return the memory [bytes].
    Free memory is released first: it would hide the same amount used later."""
    gc.collect()
    if CLEAR.exists():
        ctypes.CDLL(None).malloc_trim(0)
        CLEAR.write_text(RESET_PEAK)
    return int(psutil.Process().memory_info().rss)
