"""Background tasks of the window, one at a time; the result returns to the window's thread."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from sensors.errors import CloudError


@dataclass(frozen=True)
class Task:
    """Work for another thread. ``then`` gets its result, ``failed`` its error, both in the window's thread.

    text: description of the task. failed: None for the window's default error display.
    """

    text: str
    work: Callable[[], object]
    then: Callable[[Any], None]
    failed: Callable[[CloudError], None] | None = None


class Background(QObject):
    """Thread for tasks. busy: text of the running task, "" for none. The window stays usable meanwhile."""

    _finished = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.busy = ""
        self._pool = ThreadPoolExecutor(1, "window")
        self._after: Callable[[], None] = lambda: None
        # Queued also where the work is done at once, so that the result is an event of its own.
        self._finished.connect(self._finish, Qt.ConnectionType.QueuedConnection)

    def run(self, task: Task, failed: Callable[[CloudError], None], idle: Callable[[], None]) -> None:
        """Begin a task. failed: used for a task without its own. idle: called when the task has ended."""
        assert not self.busy, f"{self.busy} goes on"
        self.busy = task.text
        future = self._pool.submit(task.work)

        def after() -> None:
            self.busy, self._after = "", lambda: None
            try:
                result = future.result()
            except CloudError as error:
                (task.failed or failed)(error)
            else:
                task.then(result)
            idle()

        self._after = after
        future.add_done_callback(lambda _: self._finished.emit())

    def _finish(self) -> None:
        self._after()

    def close(self) -> None:
        """Wait for the running task, and drop its result."""
        self._after = lambda: None
        self._pool.shutdown(wait=True, cancel_futures=True)
