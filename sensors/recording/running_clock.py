"""Running fit of a live device's clock to the host's; ``sensors.rig.clock`` fits recorded ones. Untuned."""

from collections import deque

import numpy as np

BIN_NS, BINS = 1_000_000_000, 60  # span (ns) of each least delay, and number of spans
RECENT = 5  # spans whose least delay counts as zero; 200 ppm are 1 ms in 5 s
LEAST_BINS = 20  # spans before the skew is stated; 1 ms of jitter is 50 ppm over 20 s
SCATTER = 5.0  # least drift / median scatter, because delays of a busy machine vary


class RunningClock:
    """Clock of one device. latency_ns: least time from exposure to arrival, if known."""

    def __init__(self, latency_ns: int = 0) -> None:
        self._latency_ns = latency_ns
        self._bins = deque[tuple[int, int]](maxlen=BINS)

    def host_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """Return the time of a reading on the clock of ``arrival_ns``; call once for each reading, in
        order.
        """
        delay, at = arrival_ns - stamp_ns, arrival_ns // BIN_NS
        if not self._bins or self._bins[-1][0] != at:
            self._bins.append((at, delay))
        elif delay < self._bins[-1][1]:
            self._bins[-1] = (at, delay)
        base = min(delay for _, delay in list(self._bins)[-RECENT:])
        return stamp_ns + base - self._latency_ns

    @property
    def skew_ppm(self) -> float:
        """Return the skew of the device's clock against the host's, 0 until known.

        Median slope of the least delays over time (Theil 1950, Sen 1968), on which stalls have no effect.
        """
        if len(self._bins) < LEAST_BINS:
            return 0.0
        at, delay = np.array(self._bins, np.float64).T
        i, j = np.triu_indices(len(at), 1)
        slope = float(np.median((delay[j] - delay[i]) / (at[j] - at[i])))
        off = delay - slope * at
        scatter = float(np.median(np.abs(off - np.median(off))))
        return -1e6 * slope / BIN_NS if abs(slope) * (at[-1] - at[0]) > SCATTER * scatter else 0.0
