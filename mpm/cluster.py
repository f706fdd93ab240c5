"""Simulate in processes of this machine, or on the workers of a Dask scheduler, which share the file system.

    with connected("tcp://10.0.0.1:8786") as workers:
        trajectories = workers(scenes, record=LAST)                 # stands in for mpm.simulate_many
        for number, result in workers.finished(function, tasks):    # whichever is ready first

If a Dask worker dies, only its current task is lost, and another worker repeats it. A task interrupted by a network
error is repeated too. A scene that blows up would do so everywhere and is not tried again.
"""

import signal
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context
from typing import Any, TypeVar

from datasets.errors import InputError, WorkFailed
from datasets.flow.trajectory import Trajectory
from datasets.processes import end_with_parent, without_main
from datasets.scene import Scene
from mpm.arrays.layout import Precision
from mpm.output.recording import ALL, Recording

GRACE = 0.5  # seconds to wait for a signal of its own after another was killed: a batch system signals the whole job
CONNECT = 10.0  # seconds in which a scheduler must answer
RETRIES = 2  # how often a task that an error interrupted is tried again
PATIENCE = 3600.0  # seconds to wait for the first worker: a batch system starts them one by one
QUEUED = 2  # tasks handed to each Dask worker, so that the next one is there when it finishes one

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Processes that simulate; called with scenes, they stand in for `mpm.simulate_many`."""

    executor: Executor
    width: Callable[[], int]
    """How many tasks to hand out at a time."""

    def completed(self, work: Callable[..., T], tasks: Iterable[tuple[Any, ...]]) -> Iterator[tuple[int, Future[T]]]:
        """`work(*task)` of each task with its number, in the order in which they end.

        No more tasks are submitted than the processes can take: an executor cannot withdraw queued tasks on Ctrl-C."""
        waiting, running = enumerate(tasks), dict[Future[T], int]()
        while True:
            for number, task in islice(waiting, max(0, self.width() - len(running))):
                running[self.executor.submit(work, *task)] = number
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                if future.cancelled():
                    raise WorkFailed("the scheduler has disappeared; finished work is kept")
                yield running.pop(future), future

    def finished(self, work: Callable[..., T], tasks: Iterable[tuple[Any, ...]]) -> Iterator[tuple[int, T]]:
        """The results of `completed`; raises what a task raised."""
        return ((number, future.result()) for number, future in self.completed(work, tasks))

    def __call__(
        self, scenes: Sequence[Scene], /, *, record: Recording = ALL, precision: Precision = "f32"
    ) -> list[Trajectory]:
        """The trajectories of `scenes`, each the same to the bit as on one thread here.

        Raises ScenesFailed if a scene blew up, and WorkFailed if no workers are left."""
        from mpm.simulation import whole

        outcomes = dict(self.finished(outcome_of, [(scene, record, precision) for scene in scenes]))
        return whole([outcomes[number] for number in range(len(scenes))])


def outcome_of(scene: Scene, record: Recording, precision: Precision) -> Trajectory | WorkFailed:
    """Run by a worker: the trajectory of a scene on one thread, or the failure."""
    # Only the processes that simulate import Taichi; their parent does not.
    from mpm.simulation import simulate

    try:
        return simulate(scene, record=record, precision=precision, threads=1)
    except WorkFailed as failure:
        return failure


@contextmanager
def pool(jobs: int) -> Iterator[Workers]:
    """A pool of `jobs` new processes. If the block ends early, they finish their current task and begin no other."""
    executor = ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn"), initializer=begin_worker)
    try:
        with without_main():
            yield Workers(executor=executor, width=lambda: jobs)
    except BrokenProcessPool:
        time.sleep(GRACE)
        raise WorkFailed("a process was killed, perhaps for lack of memory; try fewer jobs") from None
    finally:
        executor.shutdown(cancel_futures=True)


def begin_worker() -> None:
    """Make a process of the pool end with its parent, and ignore Ctrl-C, which the parent alone handles."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def connected(address: str) -> Iterator[Workers]:
    """The workers of the Dask scheduler at `address`, or of the one that wrote the JSON file of that name.

    Raises InputError, and WorkFailed if no worker connects."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError('expected Dask: pip install "talus[cluster]"', key="--scheduler") from None
    try:
        location = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
        client: Any = Client(**location, timeout=CONNECT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InputError(
            f"expected the address of a Dask scheduler, {error}", where=address, key="--scheduler"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise WorkFailed(f"{address}: no worker for {PATIENCE:g} s") from None
        # Taichi holds one simulation per process.
        if (threads := set(client.nthreads().values())) != {1}:
            expected = "expected workers of one thread each (dask worker --nthreads 1)"
            raise InputError(f"{expected}, got {sorted(threads)}", where=address, key="--scheduler")
        yield Workers(
            executor=client.get_executor(pure=False, retries=RETRIES),
            width=lambda: QUEUED * max(len(client.nthreads()), 1),
        )
