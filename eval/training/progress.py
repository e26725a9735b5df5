"""Types of functions that show the progress of a task."""

from collections.abc import Callable
from contextlib import AbstractContextManager

Advance = Callable[[int], None]
"""Called with the number of steps finished since the last call."""
Progress = Callable[[str, int], AbstractContextManager[Advance]]
"""Shows a task by name and number of steps; yields a function to call with finished steps."""


def unseen(_: int) -> None:
    """Show nothing; an ``Advance``."""
