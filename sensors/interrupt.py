"""Signals that end a program: as a flag where something is being written, as Ctrl-C elsewhere."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, a polite kill, and a terminal that was closed."""


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

    The second raises KeyboardInterrupt in the main thread. A hangup that is ignored (nohup) stays ignored.
    For the main thread only.
    """
    ending = Ending()

    def asked(number: int, frame: FrameType | None) -> None:
        if ending.asked:
            raise KeyboardInterrupt
        ending.asked = True

    handled = [one for one in ENDING if one != signal.SIGHUP or signal.getsignal(one) != signal.SIG_IGN]
    before = {number: signal.signal(number, asked) for number in handled}
    try:
        yield ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Let a polite kill (SIGTERM) raise KeyboardInterrupt, as Ctrl-C does. For the main thread only."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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
