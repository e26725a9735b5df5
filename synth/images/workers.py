"""Workers that make the shards: processes of this machine, or a dask.distributed cluster."""

import logging
import os
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple

import cv2

from sensors.errors import CloudError

CONNECT_SECONDS = 10
"""Seconds to wait for a scheduler, and for its first worker. Chosen by eye."""


class Workers(NamedTuple):
    """An executor and how many tasks it can work on at once."""

    executor: Executor
    parallel: int


@contextmanager
def processes(count: int) -> Iterator[Workers]:
    """``count`` processes of this machine, each on one core. Raises CloudError when one is killed."""
    check_semaphores()
    try:
        with ProcessPoolExecutor(count, get_context("spawn"), _begin) as pool:
            yield Workers(pool, count)
    except BrokenExecutor as error:
        raise CloudError(
            "a worker process was killed, perhaps because memory ran out; give the same command again to "
            "continue, with fewer --workers if it has that option"
        ) from error


def check_semaphores() -> None:
    """Raise CloudError where processes cannot wait for each other: a container without /dev/shm."""
    try:
        get_context("spawn").Lock()
    except (OSError, ImportError) as error:
        raise CloudError(
            f"worker processes need semaphores, which this machine refuses ({error}); mount /dev/shm, e.g. "
            "docker run --shm-size 1g"
        ) from error


def _begin() -> None:
    """In a worker: one core, and no life after its parent's. A pool's workers do not notice that one dies."""
    cv2.setNumThreads(1)
    if (parent := parent_process()) is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """The workers of a dask scheduler, e.g. ``tcp://host:8786``; tasks of one that dies go to another.

    Raises CloudError when the extra is missing, nobody answers, nobody works there, or it is lost.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise CloudError("--scheduler needs dask; pip install 'annotate-cloud[cluster]'") from error
    # What distributed logs about a lost connection is said in one line by the error below.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client: Any = Client(  # type: ignore[no-untyped-call]
            address, timeout=CONNECT_SECONDS, set_as_default=False
        )
    except (OSError, ValueError) as error:
        raise CloudError(
            f"scheduler {address} does not answer; start one with 'dask scheduler', or leave out --scheduler"
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
                "workers were killed again and again at one task, perhaps because memory ran out; give each "
                "more of it, then the same command again to continue"
            ) from error
        except CancelledError as error:
            raise CloudError(
                f"scheduler {address} was lost during the run; "
                "start it and run the same command again to continue"
            ) from error
