"""Unwrapped 32-bit counters: the clocks of a Kinect v2 and a RealSense, frame numbers."""


class WrappingCounter:
    """Counter that continues where a 32-bit counter wraps to 0.

    Neighbouring values may lie up to half the range apart, in either direction.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def unwrap(self, value: int) -> int:
        """Return the unwrapped value; the first value is returned unchanged."""
        if self._last is None:
            self._last = value
        self._last += (value - self._last + 2**31) % 2**32 - 2**31
        return self._last
