"""Scheduler or worker of dask in a process forked from one with all imports."""

import os
from multiprocessing.process import BaseProcess

import dask
import distributed.cli.dask_scheduler as scheduler_
import distributed.cli.dask_worker as worker_

from tests.helpers.forking import FORKING


def begin(kind: str, line: str) -> BaseProcess:
    """Start ``dask KIND LINE``; return its process."""
    process = FORKING.Process(target=_run, args=(kind, line.split()))
    process.start()
    return process


def _run(kind: str, arguments: list[str]) -> None:
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    with dask.config.set({"distributed.worker.daemon": False}):
        {"scheduler": scheduler_, "worker": worker_}[kind].main(arguments, standalone_mode=False)
