"""Pairing of several cameras' readings: stamps matched within windows, values interpolated between them."""

import numpy as np
from numpy.typing import NDArray

COLOR_WINDOW_NS = 17_000_000
"""Colour belongs to a depth image when at most half a period of 30 Hz away."""
THERMAL_WINDOW_NS = 4_000_000
"""Thermal belongs to a depth image when at most half a period of 128 Hz away; see ``thermal_window_ns``."""
SPOT_WINDOW_NS = 1_000_000_000
"""Between readings of a pyrometer farther apart nothing is interpolated (it gives several a second)."""
CLOCK = "clock "
"""Metadata keys that name a topic's clock begin with it."""
LATENCY = "latency "
"""Metadata keys of the milliseconds from a topic's exposure to its arrival begin with it."""
MAX_LATENCY_MS = 1000.0
"""Milliseconds; a recording that states more is not believed."""


def interpolate(
    times_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    queries_ns: NDArray[np.int64],
    window_ns: int,
) -> NDArray[np.float64]:
    """Linear interpolation at the queries (m,) between readings (n,); NaN where those are too far apart."""
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
    """How far a thermal image may lie from the depth image that it belongs to. stamps_ns: (n,), sorted.

    Half a period of its stream, but at most half of the depth camera's: an image of a camera with 9 a second
    belongs to the one depth image that is nearest, and the others in between have none.
    """
    period_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return int(np.clip(period_ns / 2, THERMAL_WINDOW_NS, COLOR_WINDOW_NS))


def pair_stamps(
    master_ns: NDArray[np.int64], other_ns: NDArray[np.int64], window_ns: int
) -> NDArray[np.int64]:
    """For each master stamp the index of the other stamp that belongs to it, or -1.

    Two stamps belong together when each is the other's nearest (the earlier where equally near) and they
    are at most ``window_ns`` apart, so none is used twice. Both (n,) and sorted.
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
