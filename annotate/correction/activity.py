"""Active time: the time a person works on a frame, without breaks."""

import time
from collections.abc import Callable
from datetime import UTC, datetime

from annotate.labelset.stroke import Activity

IDLE_S = 120.0
"""Longest gap between two events that counts, in seconds: longer ones are breaks (inception #5909)."""

_EPOCH_S = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)


def steady_time() -> float:
    """Seconds since the epoch by a clock that does not jump when a person or NTP sets the host's clock."""
    return _EPOCH_S + time.clock_gettime(time.CLOCK_BOOTTIME)


class ActiveTime:
    """Sums of the gaps between a person's events, by activity.

    clock: seconds since the epoch; ``steady_time``, or the clock of the simulated annotator.
    """

    def __init__(self, clock: Callable[[], float] = steady_time) -> None:
        self.clock = clock
        self._last: float | None = None
        self._seconds: dict[Activity, float] = {}

    def mark(self, kind: Activity) -> None:
        """Count the time since the previous event (a key, a click, a camera move) for an activity."""
        now = self.clock()
        if self._last is not None and 0 < now - self._last <= IDLE_S:
            self._seconds[kind] = self._seconds.get(kind, 0.0) + (now - self._last)
        self._last = now

    def take(self) -> dict[Activity, float]:
        """Seconds by activity since the last call, to the millisecond."""
        taken, self._seconds = self._seconds, {}
        return {kind: round(seconds, 3) for kind, seconds in taken.items()}

    def now(self) -> str:
        """The clock as ISO 8601 in UTC."""
        return datetime.fromtimestamp(self.clock(), UTC).isoformat(timespec="milliseconds")
