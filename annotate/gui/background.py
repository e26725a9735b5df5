"""Background work of the window: one task at a time, its result handed to the window's thread."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from PySide6.QtCore import QObject, Qt, Signal

from sensors.errors import CloudError

T = TypeVar("T")


class Background(QObject):
    """busy: what it works on, "" for nothing. The window never waits for it."""

    _finished = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.busy = ""
        self._pool = ThreadPoolExecutor(1, "window")
        self._after: Callable[[], None] = lambda: None
        # Queued also where the work is done at once: what comes of it is an event of its own.
        self._finished.connect(self._finish, Qt.ConnectionType.QueuedConnection)

    def run(
        self,
        text: str,
        work: Callable[[], T],
        then: Callable[[T], None],
        failed: Callable[[CloudError], None],
        idle: Callable[[], None] = lambda: None,
    ) -> None:
        """Do ``work`` in a thread, then ``then`` with its result, or ``failed``, on the window's thread.

        idle: called after either.
        """
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
            idle()

        self._after = after
        future.add_done_callback(lambda _: self._finished.emit())

    def _finish(self) -> None:
        self._after()

    def close(self) -> None:
        """Wait for the work that goes on; nothing comes of it."""
        self._after = lambda: None
        self._pool.shutdown(wait=True, cancel_futures=True)
