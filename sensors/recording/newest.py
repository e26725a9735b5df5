"""A place for the newest of values that may come faster than they are used."""

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """Holds one value; the next replaces it, whether anybody has looked or not. For any number of threads.

    count: how many values there have been.
    """

    def __init__(self) -> None:
        self.count = 0
        self._changed = threading.Condition()
        self._value: T
        self._ended = False

    def put(self, value: T) -> None:
        """Show another value."""
        with self._changed:
            self._value, self.count = value, self.count + 1
            self._changed.notify_all()

    def after(self, seen: int, timeout_s: float) -> tuple[int, T] | None:
        """The newest value and its number, once there is one after number ``seen`` (0: any at all).

        None when none has come for ``timeout_s`` seconds, and at once when none will come.
        """
        with self._changed:
            self._changed.wait_for(lambda: self.count > seen or self._ended, timeout_s)
            return (self.count, self._value) if self.count > seen else None

    def end(self) -> None:
        """Let nobody wait any longer: no more values come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def ended(self) -> bool:
        """Whether no more values come."""
        return self._ended
