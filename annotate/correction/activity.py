"""Active time: what a person spends on a frame, with the coffee left out."""

import time
from collections.abc import Callable
from datetime import UTC, datetime

from annotate.labelset.stroke import Activity

IDLE_S = 120.0
"""A gap between two events that is longer counts nothing: the person was elsewhere (inception #5909)."""


_EPOCH_S = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)


def steady_time() -> float:
    """Seconds since the epoch, by the host's clock as it stood when this process began and without its jumps.

    A clock that is set, by a person or by NTP, must neither give nor take anybody's time.
    """
    return _EPOCH_S + time.clock_gettime(time.CLOCK_BOOTTIME)


class ActiveTime:
    """Adds up the gaps between a person's events, by what each event was.

    clock: seconds since the epoch; ``steady_time``, or the simulated annotator's own.
    """

    def __init__(self, clock: Callable[[], float] = steady_time) -> None:
        self.clock = clock
        self._last: float | None = None
        self._seconds: dict[Activity, float] = {}

    def mark(self, kind: Activity) -> None:
        """A key, a click, a camera move: the time since the event before it was ``kind``."""
        now = self.clock()
        if self._last is not None and 0 < now - self._last <= IDLE_S:
            self.add(kind, now - self._last)
        self._last = now

    def add(self, kind: Activity, seconds: float) -> None:
        """Count seconds that are known otherwise: the simulated annotator's."""
        self._seconds[kind] = self._seconds.get(kind, 0.0) + seconds

    def take(self) -> dict[Activity, float]:
        """Seconds by kind since they were taken last, to the millisecond."""
        taken, self._seconds = self._seconds, {}
        return {kind: round(seconds, 3) for kind, seconds in taken.items()}

    def now(self) -> str:
        """The clock as ISO 8601 in UTC."""
        return datetime.fromtimestamp(self.clock(), UTC).isoformat(timespec="milliseconds")
