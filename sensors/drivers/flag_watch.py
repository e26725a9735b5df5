"""A thermal camera's closed flag, recognised in the images if the camera does not report its state."""

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import Flag

FLAT_SHARE = 0.4
"""A closed flag leaves at most this share of the scene's usual spread of counts. Chosen by eye."""
FORGET = 0.02
"""Weight of the newest image in the usual spread, 0 to 1. Chosen by eye."""
LONGEST_S = 1.5
"""Seconds: a flag cycle takes half a second; what stays flat longer is the scene itself. Chosen by eye."""


class FlagWatch:
    """Recognises the closed flag in the counts of ``rate_hz`` images a second; no metadata word shows it.

    The flag is taken for closed while an image repeats the one before to the last bit (the camera freezes
    its output; a live detector is never so quiet), or while it is far flatter than the scene usually is.
    """

    def __init__(self, rate_hz: float) -> None:
        self._longest = round(LONGEST_S * rate_hz)
        self._usual: float | None = None
        self._before: NDArray[np.uint16] | None = None
        self._flat = 0

    def see(self, counts: NDArray[np.uint16]) -> Flag:
        """State of the flag in the next image, uint16 (h, w)."""
        frozen = self._before is not None and np.array_equal(counts, self._before)
        self._before = counts
        spread = float(np.std(counts[::2, ::2]))
        if self._usual is None:
            self._usual = spread
        if frozen or spread < FLAT_SHARE * self._usual:
            self._flat += 1
            if frozen or self._flat <= self._longest:
                return Flag.CLOSED
            self._usual = spread
        self._flat = 0
        self._usual += FORGET * (spread - self._usual)
        return Flag.OPEN
