"""Counters that wrap around, counted on: time stamps in ticks, and running numbers."""


class WrappingCounter:
    """Counts on where a counter of ``bits`` bits starts again at 0.

    Kinect v2: 32 bits of 0.125 ms wrap after 149 hours. Neighbouring values may lie up to half the range
    apart, in either direction.
    """

    def __init__(self, bits: int = 32) -> None:
        self._modulus = 1 << bits
        self._last: int | None = None

    def unwrap(self, value: int) -> int:
        """The value as if the counter were endless; the first is returned as it is."""
        if self._last is None:
            self._last = value
        half = self._modulus // 2
        self._last += (value - self._last + half) % self._modulus - half
        return self._last


class RunningNumbers:
    """Finds the gaps in a stream's running numbers of ``bits`` bits."""

    def __init__(self, bits: int = 32) -> None:
        self._modulus = 1 << bits
        self._last: int | None = None

    def lost_before(self, number: int) -> int | None:
        """How many are missing before ``number``; None where it came before, or comes late."""
        if self._last is None:
            self._last = number
            return 0
        step = (number - self._last) % self._modulus
        if step == 0 or step >= self._modulus // 2:
            return None
        self._last = number
        return step - 1
