"""A file's first run: bounded in memory and time, since what a network asks for is its author's choice."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import Any

STATM = Path("/proc/self/statm")
_DATA_PAGES = 5
"""Field of ``statm`` (man 5 proc): data and stack, which is what RLIMIT_DATA counts."""


@contextmanager
def memory_bounded(more_bytes: int) -> Iterator[None]:
    """Within, this process gets at most so much more memory; then an allocation fails, as on a full machine.

    Without effect where the system has no such limit (it is Linux's), and other threads share it.
    """
    try:
        import resource

        used = int(STATM.read_text("ascii").split()[_DATA_PAGES]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    except (ImportError, OSError):
        yield
        return
    limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min([used + more_bytes, *limits]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


@contextmanager
def time_bounded(seconds: float) -> Iterator[Any]:
    """ONNX Runtime's options for a run that ends, with its error, after the operator then at work."""
    import onnxruntime

    options = onnxruntime.RunOptions()
    options.log_severity_level = 4
    timer = Timer(seconds, setattr, (options, "terminate", True))
    timer.daemon = True
    timer.start()
    try:
        yield options
    finally:
        timer.cancel()
