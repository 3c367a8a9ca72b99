"""Where the tasks of a fleet run: in this process, on all cores, or on a cluster of Dask's."""

# Dask schedules, moves data, restarts workers and tries again; nothing of that is done here. Two of
# its settings are chosen. A task that has lost three workers is given up by default, and workers
# are lost by the dozen where machines are taken back (spot instances, preempted jobs) or memory
# runs out under another task: it may lose ten. And only some tasks a worker are handed over at a
# time, so that neither the scheduler's memory nor the answers that wait grow with their number.

import contextlib
import functools
import itertools
import logging
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar

from riecjax.errors import DataError, ModelError, reason_of
from riecjax.runtime import start_jax

LOST_WORKERS = 10
"""Workers that may end during a task before it is given up."""
SETTINGS = {
    "distributed.scheduler.allowed-failures": LOST_WORKERS,
    # One thread for each of BLAS. Dask also has C's allocator give back each 64 kB at once, which
    # makes arrays of a recording 12 % slower to work on.
    # Python's resource tracker frees what a killed process held, and would warn that it had to.
    "distributed.nanny.pre-spawn-environ": {
        **dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), 1),
        "PYTHONWARNINGS": "ignore::UserWarning:multiprocessing.resource_tracker",
    },
    # It looks at the stack of what runs a hundred times a second, for a page that is not shown.
    "distributed.worker.profile.enabled": False,
}
AHEAD = 4
"""Tasks for each worker that are handed over."""
TOGETHER, LARGEST = 16, 2**22
"""Items of a task at most, and bytes of them: enough to take longer than to hand it over."""
WAITS = 30.0
"""Seconds to wait for a scheduler that does not answer; twice as long for processes to come back,
which Dask takes for lost after 15."""

Item = TypeVar("Item")
Task = Callable[[list[Item]], Any]


class Lost(NamedTuple):
    """In place of the answer of an item that ended `LOST_WORKERS` workers: why."""

    why: str


def batches(items: Iterable[Item], size: Callable[[Item], int], most: int) -> Iterator[list[Item]]:
    """Items that follow one another, at most so many together.

    **Arguments:** `size` of an item in bytes.
    """
    batch: list[Item] = []
    held = 0
    for item in items:
        if batch and (len(batch) >= most or held + size(item) > LARGEST):
            yield batch
            batch, held = [], 0
        batch.append(item)
        held += size(item)
    if batch:
        yield batch


Each = Callable[[Task[Any], Iterable[Any], Callable[[Any], int]], Iterator[tuple[list[Any], Any]]]
"""Some items at a time with the answer to them; see [`Cluster.each`][]."""


@contextlib.contextmanager
def engine(workers: int | None = None, scheduler: str | None = None) -> Iterator[Each]:
    """Where tasks run: so many processes of this machine, one a core unless it is said, none of
    them for this one; or the workers of a scheduler elsewhere.

    **Raises:** `DataError` where the processes do not start, or the scheduler does not answer.
    """
    if scheduler is None and workers == 0:
        yield lambda task, items, size: ((b, task(b)) for b in batches(items, size, TOGETHER))
        return
    import dask.config
    import distributed

    with contextlib.ExitStack() as opened:
        # What Dask logs of lost workers is told by the tasks that they cost.
        log = logging.getLogger("distributed")
        opened.callback(log.setLevel, log.level)
        log.setLevel(logging.CRITICAL)
        opened.enter_context(dask.config.set(SETTINGS))
        try:
            processes = scheduler or opened.enter_context(
                distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    # Not at a port that another fleet may have.
                    dashboard_address="127.0.0.1:0",
                    scheduler_kwargs={"dashboard": False},
                    host="127.0.0.1",
                    local_directory=opened.enter_context(
                        tempfile.TemporaryDirectory(prefix="riecjax-")
                    ),
                    silence_logs=logging.CRITICAL,
                )
            )
            client = opened.enter_context(
                distributed.Client(
                    processes, timeout=WAITS, set_as_default=False, heartbeat_interval="2s"
                )
            )
        except (OSError, ValueError, TimeoutError, RuntimeError) as error:
            why = " ".join(str(error).split()).removesuffix(".")
            raise DataError(
                f"no scheduler of Dask answers at {scheduler}: {why}."
                if scheduler
                else f"Dask's processes do not start: {why}. A script calls rx.fleet below "
                f"'if __name__ == \"__main__\":', since they import it."
            ) from None
        started = max(len(client.scheduler_info()["workers"]), 1)
        yield Cluster(client, started, None if scheduler else processes, scheduler).each


class Cluster(NamedTuple):
    """A client of Dask's with so many workers, the processes that were started for it, or else the
    address of its scheduler."""

    client: Any
    workers: int
    processes: Any
    scheduler: str | None

    def each(
        self, task: Task[Item], items: Iterable[Item], size: Callable[[Item], int]
    ) -> Iterator[tuple[list[Item], Any]]:
        """Some items at a time with the answer to them, or one with [`Lost`][], as they come.

        **Arguments:** `task` with all that it needs beside some items; `size` of an item in bytes.

        **Raises:** `DataError` where the scheduler is gone, or a process cannot read the task;
        `ModelError` where that cannot be sent.
        """
        from distributed.protocol.serialize import serialize_bytes

        # Functions and classes of a user's file go with it, and what they import must be there.
        try:
            sent = serialize_bytes(task, on_error="raise")
        except Exception as error:
            raise ModelError(
                f"the model cannot be sent to other processes: {reason_of(error)}; sum in this one "
                f"by workers=0 (--workers 0)."
            ) from error
        # Of a worker that ends Dask suspects all tasks that it was to do, and may give up those
        # beside the one that ended it: what is given up is tried again, item by item and alone.
        given_up: list[Item] = []
        together = batches(items, size, TOGETHER)
        for batch, answer in self._each(sent, together, AHEAD * self.workers):
            if isinstance(answer, Lost):
                given_up += batch
            else:
                yield batch, answer
        yield from self._each(sent, ([item] for item in given_up), 1)

    def _each(
        self, sent: bytes, waiting: Iterator[list[Item]], ahead: int
    ) -> Iterator[tuple[list[Item], Any]]:
        """The same of these batches, of so many at a time."""
        from concurrent.futures import CancelledError

        import distributed
        from distributed.comm.core import CommClosedError

        running: dict[Any, list[Item]] = {}
        done = distributed.as_completed(loop=self.client.loop)

        def hand_over(count: int) -> None:
            for batch in itertools.islice(waiting, count):
                future = self.client.submit(_by_worker, sent, batch, pure=False)
                running[future] = batch
                done.add(future)

        hand_over(ahead)
        while running:
            alive = time.monotonic()
            while not done.has_ready():
                with done.thread_condition:
                    done.thread_condition.wait(0.1)
                if self.processes is None or self.processes.scheduler.workers:
                    alive = time.monotonic()
                elif time.monotonic() - alive > 2 * WAITS:
                    raise self._gone()
                # One that ends while it starts, as on a busy machine, does not come back by itself.
                if self.processes is not None and len(self.processes.workers) < self.workers:
                    self.processes.scale(self.workers)
            future = next(done)
            hand_over(1)
            if future.status == "cancelled":  # as all are whose scheduler has ended
                raise self._gone()
            try:
                # Of a worker that has ended since the answer was there, it is found once more.
                answer = future.result()
            except distributed.KilledWorker:
                answer = Lost(f"{LOST_WORKERS + 1} workers ended while on it")
            except (CancelledError, CommClosedError):
                raise self._gone() from None
            yield running.pop(future), answer

    def _gone(self) -> DataError:
        gone = f"the scheduler at {self.scheduler} is" if self.scheduler else "Dask's processes are"
        return DataError(
            f"{gone} gone. What was summed is kept: run the same command again, which goes on from "
            f"there."
        )


def _by_worker(sent: bytes, items: list[Any]) -> Any:
    """The answer to some items in a process of Dask's."""
    return _arrived(sent)(items)


@functools.lru_cache(maxsize=2)
def _arrived(sent: bytes) -> Task[Any]:
    """The task that was sent, once for all items of a process, in which JAX starts as by the
    command line before arrays of JAX's are made.

    **Raises:** `DataError` for what needs a module that is not there.
    """
    from distributed.protocol.serialize import deserialize_bytes

    start_jax()
    try:
        return deserialize_bytes(sent)
    except Exception as error:
        raise DataError(f"a process of Dask's cannot read the model: {reason_of(error)}") from error
