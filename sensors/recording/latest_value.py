"""Latest-value queue, for values that may come faster than they are used."""

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class LatestValue(Generic[T]):
    """Queue of the latest values, for any number of threads; older values are dropped, read or not.

    keep: number of values that ``since`` may still return. count: of all values so far.
    """

    def __init__(self, keep: int = 1) -> None:
        self.count = 0
        self._changed = threading.Condition()
        self._values = deque[T](maxlen=keep)
        self._ended = False

    def put(self, value: T) -> None:
        """Add another value."""
        with self._changed:
            self._values.append(value)
            self.count += 1
            self._changed.notify_all()

    def after(self, seen: int, timeout_s: float) -> tuple[int, T] | None:
        """Return the number and value of the latest value after number ``seen``; 0 = any.

        Waits ``timeout_s`` seconds for it, then returns None; returns None at once after ``end``.
        """
        found = self.since(seen, timeout_s)
        return found[-1] if found else None

    def since(self, seen: int, timeout_s: float) -> list[tuple[int, T]]:
        """Return all kept values after number ``seen`` with their numbers; waits like ``after``."""
        with self._changed:
            self._changed.wait_for(lambda: self.count > seen or self._ended, timeout_s)
            first = self.count - len(self._values) + 1
            return [(number, value) for number, value in enumerate(self._values, first) if number > seen]

    def end(self) -> None:
        """End every wait, because no more values come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def ended(self) -> bool:
        """Return True if no more values come."""
        return self._ended
