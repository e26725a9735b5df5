"""Detection of a thermal camera's closed flag (shutter) in its images. Constants are untuned."""

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import Flag

FLAT_SHARE = 0.4  # of the scene's usual spread of counts, below which the flag is closed
FORGET = 0.02  # weight of the latest image in the usual spread, 0 to 1
LONGEST_S = 1.5  # s; a flag cycle takes 0.5 s, so a longer flat image is the scene itself


class FlagWatch:
    """Detector of a closed flag (shutter) from images alone.

    The flag is closed in an image that repeats the previous one bit for bit, or is far flatter than usual. A
    closed flag freezes the output, while the noise of a live detector changes every image.
    """

    def __init__(self, rate_hz: float) -> None:
        self._longest = round(LONGEST_S * rate_hz)
        self._usual: float | None = None
        self._before: NDArray[np.uint16] | None = None
        self._flat = 0

    def flag(self, counts: NDArray[np.uint16]) -> Flag:
        """Return the state of the flag in the next image, uint16 (h, w)."""
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
