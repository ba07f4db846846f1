"""Runs calls on Dask distributed: on processes of this computer, or on an existing cluster."""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from queue import SimpleQueue
from typing import Any, cast

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, Status
from distributed.comm.core import CommClosedError
from tornado.ioloop import IOLoop, PeriodicCallback

from estimator.errors import InvalidInput

DEATHS_ALLOWED = 3  # workers that may die on one job before the job is taken for the cause
RECONNECTIONS, PATIENCE_S = 5, 60
LOOKS = 10
LOST_S = 60  # a worker that was killed starts again in seconds, on a busy computer in half a minute; Dask gives it up for ever after 15 s
REPLACE_EVERY_MS = 1000
ENVIRONMENT = "distributed.nanny.pre-spawn-environ"
# With this variable, Dask returns memory to the system at once, and a fit takes up to twice as long.
TRIM_VARIABLE = "MALLOC_TRIM_THRESHOLD_"

LOST = (CommClosedError, TimeoutError, OSError)  # what Dask raises where the scheduler is gone
Call = tuple[Callable[..., Any], tuple[Any, ...]]


def _words(error: BaseException | None) -> str:
    if isinstance(error, KilledWorker):
        return f"{DEATHS_ALLOWED + 1} workers died on it"
    return f"{type(error).__name__}: {error}"


def run_here(calls: Mapping[Hashable, Call], tell: Callable[[Hashable, Any], None]) -> None:
    """Make every call in this process, such as inside a call of another cluster; as `Cluster.run`."""
    for name, (function, arguments) in calls.items():
        try:
            result = function(*arguments)
        except Exception as error:
            result = RuntimeError(_words(error))
        tell(name, result)


class Cluster:
    """Runs calls on workers.

    A worker that dies is replaced, and another worker makes its calls again. If the scheduler is lost, unfinished calls are made again once
    there is a new one at the same address.
    """

    def __init__(self, client: Client, address: str) -> None:
        self._client, self._address = client, address

    def run(self, calls: Mapping[Hashable, Call], tell: Callable[[Hashable, Any], None]) -> None:
        """Make every call once, and pass each result, or the exception in its place, to `tell` as it comes.

        Raises:
            InvalidInput: The scheduler was lost and not replaced.
        """
        unfinished = dict(calls)
        for _ in range(1 + RECONNECTIONS):
            ended = SimpleQueue[Hashable]()
            futures = {name: self.start(call, partial(ended.put, name)) for name, call in unfinished.items()}
            while unfinished:
                name = ended.get()
                try:
                    result = _result(futures[name])
                except LOST:
                    break
                del unfinished[name]
                tell(name, result)
            else:
                return
            self._reconnect()
        raise InvalidInput(
            f"the scheduler must stay; it was lost {1 + RECONNECTIONS} times ({len(unfinished)} jobs left)"
        )

    def start(self, call: Call, on_end: Callable[[], None]) -> Future[Any]:
        """Begin a call and return at once.

        Args:
            call: What to call.
            on_end: Called from another thread when it has ended, however it did.
        Returns: What `outcome` and `stop` take.
        Raises:
            InvalidInput: The scheduler was lost and not replaced.
        """
        function, arguments = call
        try:
            future = self._client.submit(function, *arguments, pure=False)
        except LOST:
            self._reconnect()
            future = self._client.submit(function, *arguments, pure=False)
        future.add_done_callback(lambda _: on_end())
        return future

    def stop(self, future: Future[Any]) -> None:
        """End a call that was started; the worker that is at it is replaced, where a nanny can do that."""
        try:
            at_it: list[str] = []
            for _ in range(LOOKS):  # a call that has just begun is not at a worker yet
                at_it = [worker for worker, keys in self._client.processing().items() if future.key in keys]
                if at_it or future.status != "pending":
                    break
                time.sleep(0.1)
            self._client.cancel([future], force=True)
            if at_it:
                self._client.restart_workers(at_it, timeout=PATIENCE_S, raise_for_error=False)
        except LOST:
            return  # its scheduler is lost, and the call with it

    def _reconnect(self) -> None:
        self._client.close(timeout=1)
        try:
            self._client = Client(self._address, timeout=PATIENCE_S, set_as_default=False)
        except (OSError, TimeoutError) as error:
            raise InvalidInput(
                f"scheduler must answer within {PATIENCE_S} s; {self._address} did not (finished jobs are kept: run the command again)"
            ) from error

    def close(self) -> None:
        """Leave the cluster."""
        self._client.close()


def _result(future: Future[Any]) -> Any:
    """What a call that has ended has given, or an error in its place.

    Raises:
        LOST: The scheduler was lost, and the call with it.
    """
    how = outcome(future)
    if how == "lost":
        raise CommClosedError
    return future.result() if how == "done" else RuntimeError(how)


def outcome(future: Future[Any]) -> str | None:
    """How a call that was started has ended.

    Returns: `done`; `lost`, if it has to be made again; the reason, if it failed; None while it runs.
    """
    if future.status == "pending":
        return None
    if future.status == "error":
        return _words(future.exception())
    return "done" if future.status == "finished" else "lost"


@contextmanager
def _replacing(local: LocalCluster, n: int) -> Iterator[None]:
    """Start workers in place of those that Dask has given up: their process did not come back in time, or was killed while it started."""

    def replace() -> None:
        for name, worker in list(local.workers.items()):
            if worker.status in (Status.closed, Status.failed):
                del local.workers[name]
        if len(local.workers) < n:
            local.scale(n)

    looks, loop = PeriodicCallback(replace, REPLACE_EVERY_MS), cast(IOLoop, local.loop)  # it runs
    loop.add_callback(looks.start)
    try:
        yield
    finally:
        loop.add_callback(looks.stop)


@contextmanager
def _interruptions_blocked() -> Iterator[None]:
    """Block Ctrl-C, which a terminal sends to all, in threads and processes that begin meanwhile and in those that these start.

    This program gets it, and ends them in order.
    """
    resource_tracker.ensure_running()  # in Python 3.11 the thread that starts it would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def cluster(workers: int | None, scheduler: str | None) -> Iterator[Cluster]:
    """Start workers, or connect to those of a scheduler.

    Args:
        workers: Processes on this computer; one per processor by default. Only without a scheduler.
        scheduler: Address of an existing scheduler, such as tcp://host:8786.
    Raises:
        InvalidInput: Both arguments are given, or the scheduler does not answer.
    """
    if scheduler is not None and workers is not None:
        raise InvalidInput("workers must not be given for a scheduler that has its own; received both")
    environment = dict(dask.config.get(ENVIRONMENT))
    environment.pop(TRIM_VARIABLE, None)
    settings = {
        "distributed.scheduler.allowed-failures": DEATHS_ALLOWED,
        "distributed.deploy.lost-worker-timeout": f"{LOST_S}s",
        ENVIRONMENT: environment,
    }
    with dask.config.set(settings), ExitStack() as stack:
        address = scheduler
        if address is None:
            n = workers or len(os.sched_getaffinity(0))
            with _interruptions_blocked():
                local = LocalCluster(n_workers=n, threads_per_worker=1, dashboard_address="127.0.0.1:0")
            address = stack.enter_context(local).scheduler_address
            stack.enter_context(_replacing(local, n))
        try:
            client = Client(address, timeout=PATIENCE_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InvalidInput(f"scheduler must answer within {PATIENCE_S} s; {address} did not") from error
        connected = Cluster(client, address)
        stack.callback(connected.close)  # closes the client of that time, which may be a later one
        try:
            yield connected
        except KeyboardInterrupt:  # workers that are killed are not worth a warning then
            logging.getLogger("distributed.nanny").setLevel(logging.ERROR)
            raise
