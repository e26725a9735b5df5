"""Signals that end a program: a flag while a file is written, KeyboardInterrupt elsewhere."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SAME_S = 0.25  # s; a signal within this of the first is the same ending (a shell and its terminal); untuned


class Ending:
    """Flag that a signal sets and a loop reads.

    An attribute, because a handler that waits for the lock of a ``threading.Event`` can deadlock.
    """

    def __init__(self) -> None:
        self.asked = False

    def __call__(self) -> bool:
        return self.asked


@contextmanager
def ended_by_signals() -> Iterator[Ending]:
    """Yield a flag that the first signal of ``ENDING`` sets.

    A second signal raises KeyboardInterrupt if it comes ``SAME_S`` seconds later or more; earlier repetitions
    are ignored. For the main thread only.
    """
    ending, first_s = Ending(), 0.0

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal first_s
        if not ending.asked:
            first_s, ending.asked = time.monotonic(), True
        elif time.monotonic() - first_s >= SAME_S:
            raise KeyboardInterrupt

    with _handled(handle):
        yield ending


@contextmanager
def interrupted_by_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt at each of ``ENDING``, in a background job too; for the main thread only."""
    with _handled(signal.default_int_handler):
        yield


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Handle the signals of ``ENDING``, except a hangup that is ignored (nohup)."""
    handled = [one for one in ENDING if one != signal.SIGHUP or signal.getsignal(one) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in handled}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt where Numba's dispatcher turned a KeyboardInterrupt into a chain of
    SystemErrors.
    """
    try:
        yield
    except SystemError as error:
        cause: BaseException | None = error
        while isinstance(cause, SystemError):
            cause = cause.__cause__
        if isinstance(cause, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise
