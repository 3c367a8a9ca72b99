"""Where the tasks of a fleet run: in this process, on all cores, or on a cluster of Dask's."""

# Dask schedules, moves data, restarts workers and tries again; nothing of that is done here. Two of
# its settings are chosen. A task that has lost three workers is given up by default, and workers
# are lost by the dozen where machines are taken back (spot instances, preempted jobs) or memory
# runs out under another task: it may lose ten. And only some tasks a worker are handed over at a
# time, so that neither the scheduler's memory nor the answers that wait grow with their number.

import contextlib
import itertools
import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from riecjax.errors import DataError

LOST_WORKERS = 10
"""Workers that may end during a task before it is given up."""
SETTINGS = {
    "distributed.scheduler.allowed-failures": LOST_WORKERS,
    # One thread for each of BLAS, and of XLA. Dask also has C's allocator give back each 64 kB at
    # once, which makes arrays of a recording 12 % slower to work on: here that is done after long
    # ones alone.
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NPROC", "PJRT_NPROC"), 1
    ),
    # It looks at the stack of what runs a hundred times a second, for a page that is not shown.
    "distributed.worker.profile.enabled": False,
}
AHEAD = 4
"""Tasks for each worker that are handed over."""
STARTS = 3
"""Times that starting this machine's processes is tried."""
WAITS = 30.0
"""Seconds to wait for a scheduler that does not answer."""

Task = tuple[Any, ...]


class Lost(NamedTuple):
    """In place of an answer, of a task that ended `LOST_WORKERS` workers: why."""

    why: str


class Here(contextlib.AbstractContextManager):
    """This process, one task after the other."""

    workers, dashboard = 1, ""

    def each(
        self, function: Callable[..., Any], tasks: Iterable[Task]
    ) -> Iterator[tuple[Task, Any]]:
        """Each task with its answer."""
        for task in tasks:
            yield task, function(*task)

    def __exit__(self, *_: object) -> None:
        """Nothing to end."""


class Cluster(contextlib.AbstractContextManager):
    """Processes of this machine, one a core, or the workers of a scheduler elsewhere."""

    def __init__(self, workers: int | None = None, scheduler: str | None = None):
        """Start the processes, or connect.

        **Raises:** `DataError` where the scheduler does not answer.
        """
        import distributed

        self._scheduler, self._here = scheduler, None
        with contextlib.ExitStack() as opened:
            opened.enter_context(_settings())
            try:
                if scheduler is None:
                    self._here = _started(opened, workers or cores())
                address = scheduler or self._here
                client = distributed.Client(
                    address, timeout=WAITS, set_as_default=False, heartbeat_interval="2s"
                )
            except (OSError, ValueError, TimeoutError, RuntimeError) as error:
                raise DataError(_no_answer(scheduler, error)) from None
            self._client = opened.enter_context(client)
            self._open = opened.pop_all()
        self.workers = max(len(client.scheduler_info()["workers"]), 1)
        self.dashboard = client.dashboard_link if _has_bokeh() else ""

    def each(
        self, function: Callable[..., Any], tasks: Iterable[Task]
    ) -> Iterator[tuple[Task, Any]]:
        """Each task with its answer, or with [`Lost`][], as they come.

        **Raises:** `DataError` where the scheduler is gone.
        """
        # Of a worker that ends Dask suspects all tasks that it was to do, and may give up those
        # beside the one that ended it: what is given up is tried again, alone.
        given_up: list[Task] = []
        for task, answer in self._each(function, iter(tasks), AHEAD * self.workers):
            if isinstance(answer, Lost):
                given_up.append(task)
            else:
                yield task, answer
        yield from self._each(function, iter(given_up), 1)

    def _each(
        self, function: Callable[..., Any], tasks: Iterator[Task], ahead: int
    ) -> Iterator[tuple[Task, Any]]:
        """The same, of so many tasks at a time."""
        from concurrent.futures import CancelledError

        import distributed
        from distributed.comm.core import CommClosedError

        running: dict[Any, Task] = {}
        waiting = distributed.as_completed(loop=self._client.loop)

        def hand_over(count: int) -> None:
            for task in itertools.islice(tasks, count):
                future = self._client.submit(function, *task, pure=False)
                running[future] = task
                waiting.add(future)

        hand_over(ahead)
        while running:
            future = self._next(waiting)
            task = running.pop(future)
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
            yield task, answer

    def _next(self, waiting: Any) -> Any:
        """The next task that is done.

        **Raises:** `DataError` where this machine's processes have ended, and none comes back.
        """
        alive = time.monotonic()
        while not waiting.has_ready():
            with waiting.thread_condition:
                waiting.thread_condition.wait(0.1)
            if self._here is None or self._here.scheduler.workers:
                alive = time.monotonic()
            elif time.monotonic() - alive > WAITS:
                raise self._gone()
        return next(waiting)

    def _gone(self) -> DataError:
        what = (
            f"the scheduler at {self._scheduler} is" if self._scheduler else "Dask's processes are"
        )
        return DataError(
            f"{what} gone. What was summed is kept: run the same command again, "
            f"which goes on from there."
        )

    def __exit__(self, *given: Any) -> None:
        """End the client, and the processes that were started."""
        self._open.__exit__(*given)


def _started(opened: contextlib.ExitStack, workers: int) -> Any:
    """Processes of this machine, which end with the stack."""
    import distributed

    settings = {
        "n_workers": workers,
        "threads_per_worker": 1,
        "processes": True,
        "dashboard_address": "127.0.0.1:0" if _has_bokeh() else None,
        "host": "127.0.0.1",
        "local_directory": opened.enter_context(tempfile.TemporaryDirectory(prefix="riecjax-")),
        "silence_logs": logging.CRITICAL,
    }
    # A process that is killed while it starts takes the others with it.
    for left in reversed(range(STARTS)):
        try:
            with _without_warnings_of_lost_memory():
                return opened.enter_context(distributed.LocalCluster(**settings))
        except RuntimeError:
            if not left:
                raise
    return None


Engine = Here | Cluster


def engine(workers: int | None, scheduler: str | None) -> Engine:
    """Where tasks run: `workers` processes, none of them for this one; or a scheduler's workers."""
    if scheduler is None and workers == 0:
        return Here()
    return Cluster(workers, scheduler)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def _settings() -> Iterator[None]:
    """Dask's for this run. What it logs of lost workers is told by the tasks that they cost."""
    import dask.config

    log = logging.getLogger("distributed")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with dask.config.set(SETTINGS):
            yield
    finally:
        log.setLevel(before)


def _no_answer(scheduler: str | None, error: Exception) -> str:
    said = " ".join(str(error).split()).removesuffix(".")
    if scheduler:
        return f"no scheduler of Dask answers at {scheduler}: {said}."
    return (
        f"Dask's processes do not start: {said}. A script calls rx.fleet below "
        f"'if __name__ == \"__main__\":', since they import it."
    )


@contextlib.contextmanager
def _without_warnings_of_lost_memory() -> Iterator[None]:
    # Python's resource tracker frees what a killed process held, and warns that it had to. It is
    # started by the first process that is, with what the environment says of warnings.
    before = os.environ.get("PYTHONWARNINGS")
    ignored = "ignore::UserWarning:multiprocessing.resource_tracker"
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (before, ignored)))
    try:
        yield
    finally:
        del os.environ["PYTHONWARNINGS"]
        if before is not None:
            os.environ["PYTHONWARNINGS"] = before


def _has_bokeh() -> bool:
    import importlib.util

    return importlib.util.find_spec("bokeh") is not None
