"""Start Taichi once per precision; the solver keeps its state in NumPy arrays, so a restart loses nothing."""

import os
from contextlib import redirect_stdout, suppress
from datetime import datetime
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, Literal

from datasets.errors import InputError
from datasets.processes import processors
from mpm.arrays.layout import Precision

Arch = Literal["cpu", "cuda"]
ARCHES: dict[Arch, str] = {"cpu": "cpu", "cuda": "cuda"}  # by the names of Taichi

PARTICLES_PER_WORKER = 10_000  # the fewest particles for which another thread pays off
PARTS = 4  # most parts of a large scene; on 1, 2 and 4 threads the result is the same to the bit
STALE = 60.0  # seconds after which a lock on the kernel cache counts as abandoned
KERNELS = 2**30  # largest size of the compiled kernels on disk [bytes]

_running: tuple[Precision, int, Arch] | None = None


def start(
    precision: Precision = "f32", threads: int | None = None, arch: Arch = "cpu", *, enough: int | None = None
) -> None:
    """Make Taichi ready for `precision` on `threads` cores (all by default), or on a GPU.

    enough: threads that suffice if Taichi already runs, since a restart loses the compiled kernels. Raises InputError
    if there is no such GPU."""
    global _running
    threads = threads or processors()
    if _running == (precision, threads, arch):
        return
    if enough is not None and _running is not None and _running[0::2] == (precision, arch) and _running[1] >= enough:
        return
    # Imported here: planning a run and --help need no compiler.
    import taichi as ti

    trace_faster()
    cached = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or ti.lang.impl.default_cfg().offline_cache_file_path
    drop_stale_lock(Path(cached) / "ticache.lock")
    # Taichi prints a banner on standard output, where commands print their results.
    with redirect_stdout(StringIO()):
        ti.init(
            arch=getattr(ti, ARCHES[arch]),
            default_fp=ti.f32 if precision == "f32" else ti.f64,
            cpu_max_num_threads=threads,
            # NaNs must stay visible: a run that blows up has to say so.
            fast_math=False,
            # Vectors stay vectors down to LLVM, which has registers for them (`mpm.arrays.access`).
            real_matrix_scalarize=arch != "cpu",
            # LLVM finds common subexpressions itself; Taichi's own search is quadratic in the length of a kernel (43 of
            # 50 seconds for a 3D kernel with contact) and gives the same code.
            opt_level=0,
            offline_cache=True,
            # Beyond Taichi's 100 MB the kernels of older kinds of scenes would be dropped.
            offline_cache_max_size_of_files=KERNELS,
            log_level=ti.ERROR,
        )
    _running = (precision, threads, arch)
    # Where there is no GPU, Taichi quietly takes the CPU instead.
    if arch != "cpu" and ti.cfg.arch != getattr(ti, ARCHES[arch]):
        _running = None
        raise InputError(f"expected a GPU that Taichi can use with {arch}, found none", key="--arch")


@cache
def trace_faster() -> None:
    """Skip work that Taichi 1.7.4 repeats at every expression and function call; set up once per process."""
    from taichi.lang import kernel_impl
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

    def place_in_source(context: Any, node: Any) -> str:
        return f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'

    # Its own, for error messages, also quotes and underlines the lines of every expression of every kernel: a fifth of
    # the time before the first step if the kernels are cached.
    ASTTransformerContext.get_pos_info = place_in_source
    # Taichi looks for the source at every call.
    kernel_impl.getsourcelines = cache(kernel_impl.getsourcelines)


def drop_stale_lock(lock: Path) -> None:
    """Remove a lock on the kernel cache that a killed process has left.

    While the lock exists, Taichi neither reads nor writes the cache, and every run compiles again: `baffles-2` for 26 s
    instead of 4. A process holds the lock while it writes its kernels, for seconds at most."""
    with suppress(OSError):
        if datetime.now().timestamp() - lock.stat().st_mtime > STALE:
            lock.unlink()


def workers_for(particles: int, threads: int | None = None) -> int:
    """How many of `threads` (default: all processors) a scene of so many particles uses."""
    return max(1, min(threads or processors(), particles // PARTICLES_PER_WORKER))


def parts_for(particles: int, threads: int | None = None) -> int:
    """How many parts, one or several per thread, a scene of so many particles is divided into for at most `threads`."""
    threads = threads or processors()
    if PARTS % threads > 0:
        return workers_for(particles, threads)
    # A power of two, like the threads: of three parts, one of two threads would compute two while the other waits.
    return 1 << (workers_for(particles, PARTS).bit_length() - 1)
