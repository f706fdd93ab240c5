"""Work on many machines: simulations by the workers of a Dask scheduler, which share the file system.

    with connected("tcp://10.0.0.1:8786") as cluster:
        trajectories = cluster(scenes, record=LAST)                 # stands in for mpm.simulate_many
        futures = [cluster.submit(function, argument) for ...]      # of concurrent.futures

A worker that dies loses nothing but its present task, which another one makes again; so does a task that was broken off
by an error of the network. A scene that blows up does so everywhere and is not tried again.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm.arrays.layout import Precision
from mpm.output.request import ALL, Recording

CONNECT = 10.0
"""Seconds in which a scheduler must answer."""
RETRIES = 2
"""How often a task that an error broke off is tried again."""
PATIENCE = 3600.0
"""Seconds without any worker after which work fails: a batch system may start new ones meanwhile."""
POLL = 2.0
"""Seconds after which one looks whether there are workers."""
QUEUED = 2
"""Tasks for each worker: the next one is there when it has finished one."""

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(kw_only=True)
class Cluster:
    """The workers of a scheduler; called with scenes, it stands in for `mpm.simulate_many`."""

    address: str
    client: Any
    executor: Executor
    seen: float
    """When there were workers last, on the monotonic clock [s]."""

    waiting: bool = False
    """That there is none was said."""

    @property
    def workers(self) -> int:
        """How many workers there are now."""
        return len(self.client.nthreads())

    @property
    def width(self) -> int:
        """How many tasks to hand out at a time."""
        return QUEUED * max(self.workers, 1)

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """`work(...)` by one of the workers."""
        return self.executor.submit(work, *args, **kwargs)

    def __call__(
        self, scenes: Sequence[Scene], /, *, record: Recording = ALL, precision: Precision = "f32"
    ) -> list[Trajectory]:
        """The trajectories of `scenes`, each the same to the bit as on one thread here.

        Raises ScenesFailed where one blew up, and WorkFailed where there are no workers any more.
        """
        from mpm.simulation import ScenesFailed

        futures = [self.submit(outcome_of, scene, record, precision) for scene in scenes]
        outcomes = [self.result(future) for future in futures]
        whole = [each for each in outcomes if isinstance(each, Trajectory)]
        if len(whole) < len(outcomes):
            raise ScenesFailed(outcomes)
        return whole

    def finished(self, work: Callable[..., T], tasks: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, T]]:
        """`work(*task)` of each task with its number, whichever is ready first; errors as `result`."""
        numbers = {self.submit(work, *task): number for number, task in enumerate(tasks)}
        running = set(numbers)
        while running:
            ended, running = wait(running, timeout=POLL, return_when=FIRST_COMPLETED)
            if not ended:
                self.check()
            for future in ended:
                yield numbers[future], self.result(future)

    def result(self, future: Future[T]) -> T:
        """The result of a task, once it is there; what it raised is raised. Raises WorkFailed as `check`."""
        while not wait([future], timeout=POLL).done:
            self.check()
        try:
            return future.result()
        except CancelledError:
            raise WorkFailed(f"{self.address}: the scheduler has gone; what was finished is kept") from None

    def check(self) -> None:
        """Raise WorkFailed where the scheduler has gone, or had no workers for PATIENCE seconds."""
        now = time.monotonic()
        try:
            if self.workers:
                self.seen, self.waiting = now, False
            elif not self.waiting:
                self.waiting = True
                print(f"talus: {self.address}: no worker; waiting for one", file=sys.stderr)
        except (OSError, ValueError):
            raise WorkFailed(f"{self.address}: the scheduler has gone; what was finished is kept") from None
        if now - self.seen > PATIENCE:
            raise WorkFailed(f"{self.address}: no worker for {PATIENCE:g} s; what was finished is kept")


def outcome_of(scene: Scene, record: Recording, precision: Precision) -> Trajectory | WorkFailed:
    """The trajectory of a scene on one thread, or why there is none; by a worker."""
    from mpm.simulation import simulate

    try:
        return simulate(scene, record=record, precision=precision, threads=1)
    except WorkFailed as failure:
        return failure


@contextmanager
def connected(address: str) -> Iterator[Cluster]:
    """The workers of the Dask scheduler at `address`, or of that which wrote the JSON file of that name.

    Raises InputError.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError('expected Dask: pip install "talus[cluster]"', key="--scheduler") from None
    try:
        found = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
        client: Any = Client(**found, timeout=CONNECT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InputError(
            f"expected the address of a Dask scheduler, {error}", where=address, key="--scheduler"
        ) from None
    with client:
        # Those of a batch job come one by one.
        threads = client.nthreads()
        if not threads:
            print(f"talus: {address}: no worker; waiting for the first", file=sys.stderr)
            with suppress(TimeoutError):
                client.wait_for_workers(1, timeout=PATIENCE)
            threads = client.nthreads()
        # Taichi holds one simulation per process.
        if not threads or set(threads.values()) != {1}:
            expected = "expected workers of one thread each (dask worker --nthreads 1)"
            raise InputError(f"{expected}, got {sorted(threads.values())}", where=address, key="--scheduler")
        executor = client.get_executor(pure=False, retries=RETRIES)
        yield Cluster(address=address, client=client, executor=executor, seen=time.monotonic())
