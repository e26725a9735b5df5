"""Signals that end a program: as a flag where something is being written, as Ctrl-C elsewhere."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, a polite kill, and a terminal that was closed."""


SAME_S = 0.25
"""Seconds after a signal in which another belongs to the same ending: a shell and its terminal both hang up,
and programs that start others hand on what the terminal sends to all. A second press is later (untuned)."""


class Ending:
    """Flag that a signal sets and that a loop reads. asked: whether it is set.

    An attribute and no ``threading.Event``: a handler runs between two instructions of the main thread, which
    may hold the lock of the event that the handler would wait for.
    """

    def __init__(self) -> None:
        self.asked = False

    def __call__(self) -> bool:
        """Whether a signal has come."""
        return self.asked


@contextmanager
def ended_by_signals() -> Iterator[Ending]:
    """Let the first of ``ENDING`` set a flag, so that nothing raises into what is being written.

    A second, ``SAME_S`` later or more, raises KeyboardInterrupt in the main thread. For the main thread only.
    """
    ending, first_s = Ending(), 0.0

    def asked(number: int, frame: FrameType | None) -> None:
        nonlocal first_s
        if not ending.asked:
            first_s, ending.asked = time.monotonic(), True
        elif time.monotonic() - first_s >= SAME_S:
            raise KeyboardInterrupt

    with _handled(asked):
        yield ending


@contextmanager
def interrupted_by_signals() -> Iterator[None]:
    """Let each of ``ENDING`` raise KeyboardInterrupt, where nothing is being written yet.

    Ctrl-C too: a shell lets what it starts in the background ignore it. For the main thread only.
    """
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
    """Raise KeyboardInterrupt where an interrupt within Numba's dispatcher came out as SystemError.

    The dispatcher returns in spite of the interrupt, which Python reports as the dispatcher's mistake. So
    does the code that the dispatcher calls: each mistake is the cause of the next.
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
