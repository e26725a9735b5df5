"""Unwrapped 32-bit counters: the clocks of a Kinect v2 and a RealSense, frame numbers."""


class WrappingCounter:
    """Counter that goes on where one of 32 bits starts again at 0.

    Neighbouring values may lie up to half the range apart, in either direction.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def unwrap(self, value: int) -> int:
        """Return the value of an endless counter; the first is returned as it is."""
        if self._last is None:
            self._last = value
        self._last += (value - self._last + 2**31) % 2**32 - 2**31
        return self._last
