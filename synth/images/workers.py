"""Workers for parallel tasks: processes of this machine, or a dask.distributed cluster."""

import logging
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Semaphore
from typing import Any, NamedTuple

import cv2

from annotate.compiler_notice import announce_compiling, is_due
from sensors.errors import CloudError, Setting

CONNECT_SECONDS = 10  # to a scheduler, and to its first worker


class Workers(NamedTuple):
    """Executor, and the number of its parallel tasks."""

    executor: Executor
    parallel: int


class _Worker(SpawnProcess):
    """Process that Ctrl-C does not reach from its first instruction on, because its parent ends it."""

    def start(self) -> None:
        """Start the process, with a blocked SIGINT that it inherits."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _WorkerContext(SpawnContext):
    """Context whose processes are ``_Worker``."""

    Process = _Worker


@contextmanager
def processes(count: int) -> Iterator[Workers]:
    """Start ``count`` processes, each on one core. Raises CloudError when a process is killed."""
    check_semaphores()
    spawn = _WorkerContext()
    lines = spawn.Semaphore(int(is_due()))
    try:
        with ProcessPoolExecutor(count, spawn, _begin, (lines,)) as pool:
            yield Workers(pool, count)
    except BrokenExecutor as error:
        raise CloudError(
            "a worker process was killed, perhaps because memory ran out; run the same command again to "
            "continue, with fewer workers if possible",
            Setting.WORKERS,
        ) from error


def check_semaphores() -> None:
    """Raise CloudError on a machine without semaphores, e.g. a container without /dev/shm."""
    try:
        get_context("spawn").Lock()
    except (OSError, ImportError) as error:
        raise CloudError(
            f"semaphores are missing on this machine ({error}); mount /dev/shm, e.g. docker run --shm-size 1g"
        ) from error


def _begin(lines: Semaphore) -> None:
    """Limit a worker to one core, and end it when its parent dies, because a pool does not do so.

    lines: number of lines about compiling that the workers may print in all.
    """
    cv2.setNumThreads(1)
    announce_compiling(partial(lines.acquire, block=False))
    if (parent := parent_process()) is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """Connect to the workers of a dask scheduler, e.g. ``tcp://host:8786``.

    Raises CloudError for a missing extra, a scheduler that does not answer, has no workers or is lost.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise CloudError("a scheduler needs dask; pip install 'annotate-cloud[cluster]'") from error
    # The errors below replace distributed's log of a lost connection.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client: Any = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise CloudError(
            f"scheduler {address} does not answer; start one with 'dask scheduler', or leave it out",
            Setting.SCHEDULER,
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_SECONDS)
        except TimeoutError as error:
            raise CloudError(
                f"scheduler {address} has no workers; start some with 'dask worker {address} --nthreads 1'"
            ) from error
        try:
            yield Workers(client.get_executor(pure=False), sum(client.nthreads().values()))
        except KilledWorker as error:
            raise CloudError(
                "workers were killed repeatedly at one task, perhaps because memory ran out; give each more "
                "memory and run the same command again to continue"
            ) from error
        except CancelledError as error:
            raise CloudError(
                f"scheduler {address} was lost during the run; "
                "start it and run the same command again to continue"
            ) from error
