"""Start Taichi once per precision; the solver keeps its state in NumPy arrays, so a restart loses nothing."""

import os
from contextlib import redirect_stdout
from io import StringIO
from typing import Literal

import taichi as ti

Precision = Literal["f32", "f64"]

_running: tuple[Precision, int] | None = None


def start(precision: Precision = "f32", threads: int | None = None) -> None:
    """Make Taichi ready for `precision` on `threads` cores (all by default)."""
    global _running
    threads = threads or os.cpu_count() or 1
    if _running == (precision, threads):
        return
    # Taichi greets on standard output, where commands print what they found.
    with redirect_stdout(StringIO()):
        ti.init(
            arch=ti.cpu,
            default_fp=ti.f32 if precision == "f32" else ti.f64,
            cpu_max_num_threads=threads,
            # NaNs must stay visible: a run that blows up has to say so.
            fast_math=False,
            offline_cache=True,
            log_level=ti.ERROR,
        )
    _running = (precision, threads)
