"""Python's collector of reference cycles, kept from stopping all threads while devices are read."""

import gc
import threading
from typing import ClassVar


class QuietCollector:
    """Keeps the collector from all objects that were there at ``begin``, until the last user has ended.

    A full collection stops every thread for 60 ms (170,000 objects), on a busy machine for 120 ms. A thermal
    camera keeps its images for an eighth of a second.
    """

    _users: ClassVar[set["QuietCollector"]] = set()
    _lock = threading.Lock()

    def begin(self) -> None:
        """Leave out all objects that there are."""
        with self._lock:
            self._users.add(self)
            gc.freeze()

    def freeze(self) -> None:
        """Leave out the objects made since ``begin``, too; do nothing before ``begin`` or after ``end``."""
        with self._lock:
            if self in self._users:
                gc.freeze()

    def end(self) -> None:
        """Let the collector work as before, unless there is another user; idempotent."""
        with self._lock:
            if self in self._users:
                self._users.discard(self)
                if not self._users:
                    gc.unfreeze()
