"""Signals that end a program: a flag while a file is written, KeyboardInterrupt elsewhere."""

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SAME_S = 0.25  # s; a signal within this of the first is the same ending (a shell and its terminal); untuned
AGAIN_S = 2 * SAME_S  # s; until a lost KeyboardInterrupt is raised again, not as a repetition
IMPORT_S = 0.05  # s; between looks whether an import is over; untuned
IMPORTER = "<frozen importlib._bootstrap>"
"""File of the frames of a running import."""


class Ending:
    """Flag that a signal sets and a loop reads.

    An attribute, because a handler that waits for the lock of a ``threading.Event`` can deadlock.
    """

    def __init__(self) -> None:
        self.asked, self._first_s = False, 0.0

    def __call__(self) -> bool:
        return self.asked

    def repeated(self) -> bool:
        """Set the flag; return whether this repeats a signal less than ``SAME_S`` seconds ago."""
        now_s = time.monotonic()
        if self.asked and now_s - self._first_s < SAME_S:
            return True
        self._first_s, self.asked = now_s, True
        return False


_BLOCKS: list[Ending] = []
"""Flags of the running blocks of ``interruptible``, the innermost last."""
_ANY_BLOCK = Ending()
"""Flag of all these blocks, because an outer one gets the repetitions of a signal that ended an inner one."""


@contextmanager
def ended_by_signals() -> Iterator[Ending]:
    """Yield a flag that the first signal of ``ENDING`` sets.

    A second signal raises KeyboardInterrupt if it comes ``SAME_S`` seconds later or more; earlier repetitions
    are ignored. For the main thread only.
    """
    ending = Ending()

    def handle(number: int, frame: FrameType | None) -> None:
        first = not ending.asked
        if not ending.repeated() and not first:
            raise KeyboardInterrupt

    with _handled(handle):
        yield ending


@contextmanager
def interrupted_by_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt at each of ``ENDING``, in a background job too; for the main thread only."""
    with _handled(_interrupt):
        yield


@contextmanager
def _handled(
    handler: Callable[[int, FrameType | None], object], numbers: tuple[signal.Signals, ...] = ENDING
) -> Iterator[None]:
    """Handle signals, except a hangup that is ignored (nohup)."""
    handled = [one for one in numbers if one != signal.SIGHUP or signal.getsignal(one) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in handled}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt for each error of a block that a signal has interrupted.

    Compiled code, imports and Numba's dispatcher turn a KeyboardInterrupt into errors of their own; in a
    callback it is lost, and raised again.
    """
    if _BLOCKS and _BLOCKS[-1].asked:
        raise KeyboardInterrupt
    ending, usual_hook = Ending(), sys.unraisablehook
    main = threading.current_thread() is threading.main_thread()
    heeded = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    _BLOCKS.append(ending)

    def hook(lost: "UnraisableHookArgs") -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt):
            _interrupt_after(AGAIN_S)
        else:
            usual_hook(lost)

    sys.unraisablehook = hook
    try:
        with _handled(_interrupt, (signal.SIGINT,) if heeded else ()):
            yield
    except SystemExit as end:
        if ending.asked and end.code not in (None, 0, 130):
            raise KeyboardInterrupt from end
        raise
    except Exception as error:
        if ending.asked or _numbas(error):
            raise KeyboardInterrupt from error
        raise
    finally:
        sys.unraisablehook = usual_hook
        _BLOCKS.pop()


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, unless the signal repeats another one in a block of ``interruptible``.

    A running import ends first, because compiled modules abort the process at an exception in their import.
    """
    if _BLOCKS:
        _BLOCKS[-1].asked = True
    if _importing(frame):
        _interrupt_after(IMPORT_S)
    elif not (_BLOCKS and _ANY_BLOCK.repeated()):
        raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    """Return whether a frame runs inside an import."""
    while frame is not None and frame.f_code.co_filename != IMPORTER:
        frame = frame.f_back
    return frame is not None


def _interrupt_after(seconds: float) -> None:
    """Send SIGINT to the main thread later.

    Without ``threading.Timer``, whose lock can deadlock in a signal handler.
    """

    def send() -> None:
        time.sleep(seconds)
        _thread.interrupt_main()

    _thread.start_new_thread(send, ())


def _numbas(error: Exception) -> bool:
    """Return whether an error is a KeyboardInterrupt that Numba turned into a chain of SystemErrors."""
    cause: BaseException | None = error
    while isinstance(cause, SystemError):
        cause = cause.__cause__
    return isinstance(cause, KeyboardInterrupt)
