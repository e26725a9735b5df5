"""Measurements side by side on two cores, with their progress."""

import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, as_completed
from time import monotonic
from typing import TypeVar

from synth.images.workers import processes

CORES = 2
Job = TypeVar("Job")
Found = TypeVar("Found")


def each(work: Callable[[Job], Found], jobs: Sequence[Job], names: Iterable[str]) -> list[Found]:
    """Return the result of each job in order, measured in ``CORES`` processes.

    work: a function that pickle finds by name. names: of the jobs, for the progress on the standard error.
    Raises CloudError when a process is killed.
    """
    began = monotonic()
    with processes(CORES) as workers:
        futures: dict[Future[Found], str] = {
            workers.executor.submit(work, job): name for job, name in zip(jobs, names, strict=True)
        }
        for done, future in enumerate(as_completed(futures), 1):
            future.result()
            minutes = (monotonic() - began) / 60
            print(
                f"  {done} of {len(jobs)}, {minutes:.1f} min: {futures[future]}", file=sys.stderr, flush=True
            )
        return [future.result() for future in futures]
