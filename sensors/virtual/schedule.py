"""Schedule of a twin's frames: when they are due, and which faults they have."""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

QUEUE = 4  # frames kept for a slow reader by default, as V4L2 drivers do


class UnpluggedError(Exception):
    """Error of a twin that was unplugged; each twin converts it into the error of its own system."""


@dataclass(frozen=True)
class Faults:
    """Faults of a twin.

    drop, short: shares of frames lost or truncated. unplug_after: seconds. skew_ppm: of the device's clock
    against the host's. jitter_s: mean of the random delay of arrivals. hurry: speed-up; factor on the frame
    rate on the host's clock.
    """

    drop: float = 0.0
    short: float = 0.0
    unplug_after: float = float("inf")
    skew_ppm: float = 0.0
    jitter_s: float = 0.0
    hurry: float = 1.0


class Schedule:
    """Timer of a virtual camera: numbers its frames from 0, due at ``rate_hz`` from ``start`` on.

    Only one thread may ``wait``; any thread may ``stop``. queue: number of due frames kept for a slow reader;
    older ones are dropped.
    """

    def __init__(self, rate_hz: float, faults: Faults | None, queue: int = QUEUE) -> None:
        self.faults, self.queue = faults or Faults(), queue
        self._rate_hz, self._host_hz = rate_hz, rate_hz * self.faults.hurry
        self._rng = np.random.default_rng(0)
        self._next, self._delay_s = 0, 0.0
        self._start_s = float("inf")
        self._stopped = threading.Event()

    def start(self) -> None:
        """Make the first frame due one period from now."""
        self._start_s = time.monotonic()

    def stop(self) -> None:
        """End every ``wait`` with UnpluggedError."""
        self._stopped.set()

    def wait(self, timeout_s: float) -> int | None:
        """Return the number of the next frame once it is due, None after ``timeout_s``.

        Raises UnpluggedError after ``stop``, or once the twin is unplugged.
        """
        end_s = time.monotonic() + timeout_s
        while True:
            if self._start_s < float("inf"):
                late = int((time.monotonic() - self._start_s) * self._host_hz)
                self._next = max(self._next, late - self.queue)
            due_s = self._start_s + (self._next + 1) / self._host_hz + self._delay_s
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
        """Return whether the current frame is cut off."""
        return bool(self._rng.random() < self.faults.short)

    def device_s(self, number: int) -> float:
        """Return the device's clock at the exposure of frame ``number``."""
        return number / self._rate_hz * (1 + self.faults.skew_ppm * 1e-6)


def c_functions(prototypes: Mapping[str, Any], twin: object) -> dict[str, Any]:
    """Return C function pointers to the twin's methods, which have a ``_`` before the prototype's name."""
    return {name: make(getattr(twin, f"_{name}")) for name, make in prototypes.items()}
