"""A device's clock against the host's while readings come in: when each was made, how fast the clock runs."""

from collections import deque

import numpy as np

BIN_NS, BINS = 1_000_000_000, 60
"""Span of which the least delay is kept, and number of spans: a minute. Untuned."""
RECENT = 5
"""Spans whose least delay is taken for none. Untuned: in five seconds some reading is not held up, and
a clock that is off by 200 ppm moves by a millisecond."""
LEAST_BINS = 20
"""Spans before a clock's speed is stated: a jitter of a millisecond is 50 ppm over 20 s."""
SCATTER = 5.0
"""Least drift over the time watched, as a multiple of the median scatter about it: on a machine that is too
busy every delay is late, and by how much changes. Untuned."""


class HostClock:
    """Clock of one device. latency_ns: from a reading's making to its arrival at best, where it is known."""

    def __init__(self, latency_ns: int = 0) -> None:
        self._latency_ns = latency_ns
        self._bins = deque[tuple[int, int]](maxlen=BINS)

    def host_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """When a reading stamped so was made, on the clock of the arrivals; readings in their order."""
        delay, at = arrival_ns - stamp_ns, arrival_ns // BIN_NS
        if not self._bins or self._bins[-1][0] != at:
            self._bins.append((at, delay))
        elif delay < self._bins[-1][1]:
            self._bins[-1] = (at, delay)
        base = min(delay for _, delay in list(self._bins)[-RECENT:])
        return stamp_ns + base - self._latency_ns

    @property
    def skew_ppm(self) -> float:
        """How much faster the device's clock runs than the host's, in millionths; 0 until it is known.

        The median slope of the least delays over time (Theil 1950, Sen 1968): stalls do not move it.
        """
        if len(self._bins) < LEAST_BINS:
            return 0.0
        at, delay = np.array(self._bins, np.float64).T
        i, j = np.triu_indices(len(at), 1)
        slope = float(np.median((delay[j] - delay[i]) / (at[j] - at[i])))
        off = delay - slope * at
        scatter = float(np.median(np.abs(off - np.median(off))))
        return -1e6 * slope / BIN_NS if abs(slope) * (at[-1] - at[0]) > SCATTER * scatter else 0.0
