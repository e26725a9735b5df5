"""Pairing of several cameras' readings: stamps matched within windows, values interpolated between them."""

import numpy as np
from numpy.typing import NDArray

COLOR_WINDOW_NS = 17_000_000  # half a period of 30 Hz
THERMAL_WINDOW_NS = 4_000_000  # half a period of 128 Hz; see ``thermal_window_ns``
SPOT_WINDOW_NS = 1_000_000_000  # between readings of a pyrometer, which gives several a second
CLOCK, LATENCY = "clock ", "latency "  # metadata keys: clock of a topic; ms from exposure to arrival
MAX_LATENCY_MS = 1000.0  # a recording that states more is damaged


def interpolate(
    times_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    queries_ns: NDArray[np.int64],
    window_ns: int,
) -> NDArray[np.float64]:
    """Interpolate linearly at the queries (m,) between readings (n,); NaN where these are too far apart."""
    result = np.full(len(queries_ns), np.nan)
    if len(times_ns) < 2:
        return result
    right = np.clip(np.searchsorted(times_ns, queries_ns), 1, len(times_ns) - 1)
    before, after = times_ns[right - 1], times_ns[right]
    near = (queries_ns >= before) & (queries_ns <= after) & (after - before < window_ns)
    share = (queries_ns - before)[near] / np.maximum(after - before, 1)[near]
    result[near] = (1 - share) * values[right - 1][near] + share * values[right][near]
    return result


def thermal_window_ns(stamps_ns: NDArray[np.int64]) -> int:
    """Return the greatest distance of a thermal image from its depth image. stamps_ns: (n,), sorted.

    Half a period of the stream, but at most half of the depth camera's: an image of a 9 Hz camera belongs to
    the nearest depth image alone.
    """
    period_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return int(np.clip(period_ns / 2, THERMAL_WINDOW_NS, COLOR_WINDOW_NS))


def pair_stamps(
    master_ns: NDArray[np.int64], other_ns: NDArray[np.int64], window_ns: int
) -> NDArray[np.int64]:
    """Return for each master stamp the index of its other stamp, or -1. Both (n,) and sorted.

    Two stamps at most ``window_ns`` apart pair when each is the other's nearest (the earlier of equally near
    ones). None is used twice.
    """
    if not len(master_ns) or not len(other_ns):
        return np.full(len(master_ns), -1, np.int64)
    other = _nearest(other_ns, master_ns)
    mutual = _nearest(master_ns, other_ns)[other] == np.arange(len(master_ns))
    near = np.abs(other_ns[other] - master_ns) <= window_ns
    return np.where(mutual & near, other, -1)


def _nearest(stamps_ns: NDArray[np.int64], queries_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    after = np.searchsorted(stamps_ns, queries_ns).clip(0, len(stamps_ns) - 1)
    before = np.searchsorted(stamps_ns, stamps_ns[np.maximum(after - 1, 0)])
    closer = np.abs(stamps_ns[before] - queries_ns) <= np.abs(stamps_ns[after] - queries_ns)
    return np.where(closer, before, after).astype(np.int64)
