"""Ctrl-C while compiled code runs, as Ctrl-C."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt where an interrupt within Numba's dispatcher came out as SystemError.

    The dispatcher returns in spite of the interrupt, which Python then reports as the dispatcher's mistake.
    """
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise
