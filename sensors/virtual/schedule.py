"""Schedule of a twin's frames: when they are due, and which faults they have."""

import threading
import time
from dataclasses import dataclass

import numpy as np

QUEUE = 4
"""Frames kept for a slow reader unless its driver sets more, as V4L2 drivers do; older ones are lost."""


class UnpluggedError(Exception):
    """The twin has vanished; each twin turns this into the error of its own system."""


@dataclass(frozen=True)
class Faults:
    """drop: share of frames lost before the host. short: share of frames cut off. unplug_after: seconds.

    skew_ppm: how much faster the device's clock runs than the host's. jitter_s: mean of the random delay
    with which frames arrive.
    """

    drop: float = 0.0
    short: float = 0.0
    unplug_after: float = float("inf")
    skew_ppm: float = 0.0
    jitter_s: float = 0.0


class Schedule:
    """Frames 0, 1, 2 .. of ``rate_hz`` a second since ``start``. One thread waits; any may ``stop``.

    queue: how many frames wait for a slow reader.
    """

    def __init__(self, rate_hz: float, faults: Faults | None, queue: int = QUEUE) -> None:
        self._rate_hz, self.faults, self.queue = rate_hz, faults or Faults(), queue
        self._rng = np.random.default_rng(0)
        self._next, self._delay_s = 0, 0.0
        self._start_s = float("inf")
        self._stopped = threading.Event()

    def start(self) -> None:
        """The first frame is due one period from now."""
        self._start_s = time.monotonic()

    def stop(self) -> None:
        """End a ``wait`` under way, and every later one."""
        self._stopped.set()

    def wait(self, timeout_s: float) -> int | None:
        """Number of the next frame once it is due, None after ``timeout_s``. Raises UnpluggedError."""
        end_s = time.monotonic() + timeout_s
        while True:
            if self._start_s < float("inf"):
                late = int((time.monotonic() - self._start_s) * self._rate_hz)
                self._next = max(self._next, late - self.queue)
            due_s = self._start_s + (self._next + 1) / self._rate_hz + self._delay_s
            unplugged_s = self._start_s + self.faults.unplug_after
            until_s = min(due_s, end_s, unplugged_s)
            if self._stopped.wait(max(0.0, until_s - time.monotonic())) or until_s == unplugged_s:
                raise UnpluggedError
            if until_s < due_s:
                return None
            number, self._next = self._next, self._next + 1
            self._delay_s = float(self._rng.exponential(self.faults.jitter_s))
            if self._rng.random() >= self.faults.drop:
                return number

    def is_short(self) -> bool:
        """Whether the frame now at hand is cut off."""
        return bool(self._rng.random() < self.faults.short)

    def device_s(self, number: int) -> float:
        """The device's clock when frame ``number`` was taken."""
        return number / self._rate_hz * (1 + self.faults.skew_ppm * 1e-6)
