"""Background work of the window: one task at a time, its result handed to the window's thread."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from typing import TypeVar

from PySide6.QtCore import QObject, Signal

from sensors.errors import CloudError

T = TypeVar("T")
AT_ONCE_S = 0.02
"""Time for which the window waits for work that may be ready, in seconds: a frame that was read ahead opens
without a flicker. Chosen by eye."""


class Background(QObject):
    """busy: what it works on, "" for nothing."""

    _finished = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.busy = ""
        self._pool = ThreadPoolExecutor(1, "window")
        self._after: Callable[[], None] = lambda: None
        self._finished.connect(self._finish)

    def run(
        self,
        text: str,
        work: Callable[[], T],
        then: Callable[[T], None],
        failed: Callable[[CloudError], None],
    ) -> None:
        """Do ``work`` in a thread, then ``then`` with its result, or ``failed``, on the window's thread."""
        assert not self.busy, f"{self.busy} goes on"
        self.busy = text
        future = self._pool.submit(work)

        def after() -> None:
            self.busy, self._after = "", lambda: None
            try:
                result = future.result()
            except CloudError as error:
                failed(error)
            else:
                then(result)

        if wait_for([future], AT_ONCE_S).done:
            after()
            return
        self._after = after
        future.add_done_callback(lambda _: self._finished.emit())

    def _finish(self) -> None:
        self._after()

    def close(self) -> None:
        """Wait for the work that goes on; nothing comes of it."""
        self._after = lambda: None
        self._pool.shutdown(wait=True, cancel_futures=True)
