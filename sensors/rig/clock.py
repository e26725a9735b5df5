"""Recorded clocks of devices against the host's: offset and skew from the lower envelope of the delays.

A delay is never negative: transport, plus the host's other work. The highest line below all delays is the
clock. A device that was unplugged, or whose clock was set, begins an *epoch* with another offset; each epoch
is fitted by itself. Constants are untuned unless a source is given.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

BACK, SET_ANEW = "{} is back", "{}: its clock was set"  # events that begin an epoch of the named clock
LIMIT_SKEW = 200e-6  # beyond every crystal; a steeper envelope is jitter over a short time
FARTHEST_NS = 1 << 62  # largest offset: 146 years
EPOCH_MARGIN_NS = 100_000_000  # before an epoch's first reading: another stream is stamped earlier
MAX_EPOCHS = 10_000  # a device that is opened every second for three hours
MOST_LATE_NS = 60_000_000_000  # by which a fit is moved back at most, because a damaged file may state more
AGREE_NS, EXPOSURE_NS = 5_000_000, 20_000_000  # delays that agree; stamps that may be of one exposure


@dataclass(frozen=True)
class Clock:
    """Linear clock model: host_ns = stamp_ns + offset_ns + skew * (stamp_ns - origin_ns)."""

    offset_ns: int
    skew: float
    origin_ns: int

    def host_ns(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return device stamps (n,) on the host's clock."""
        since = stamps_ns - self.origin_ns
        host = stamps_ns + self.offset_ns + np.rint(self.skew * since).astype(np.int64)
        return np.asarray(host, np.int64)


def fit_clock(stamps_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64]) -> Clock:
    """Fit a device's clock to the host's arrivals, both (n,), n >= 1; the least delay counts as 0."""
    origin = int(stamps_ns[0])
    since = (stamps_ns - origin).astype(np.float64)
    delay = arrivals_ns - stamps_ns
    base = int(delay.min())
    skew, offset = _envelope(since, (delay - base).astype(np.float64))
    return Clock(max(-FARTHEST_NS, min(FARTHEST_NS, base + round(offset))), skew, origin)


@dataclass(frozen=True)
class EpochClock:
    """Clock of one device in all its epochs.

    begins_ns: (k,) stamps at which epochs 1 .. k begin. clocks: of the epochs that have readings, by number.
    unsure: epochs with too few readings for a reliable offset; the first reading after a device was opened is
    often late.
    """

    begins_ns: NDArray[np.int64]
    clocks: dict[int, Clock]
    unsure: frozenset[int]

    def host_ns(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return device stamps (n,), sorted and of epochs that were fitted, on the host's clock."""
        host = stamps_ns.copy()
        for number, span in _spans(stamps_ns, self.begins_ns):
            host[span] = self.clocks[number].host_ns(stamps_ns[span])
        return host

    def sure(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return flags (n,) of sorted device stamps whose time on the host's clock is reliable."""
        flags = np.ones(len(stamps_ns), np.bool_)
        for number, span in _spans(stamps_ns, self.begins_ns):
            flags[span] = number not in self.unsure
        return flags


def fit_epochs(
    stamps_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64], begins_ns: NDArray[np.int64]
) -> EpochClock:
    """Fit each epoch of a clock to the host's arrivals, both (n,), n >= 1.

    A fit that ends later than the first reading of the next epoch is shifted to earlier times, because
    readings keep their order.
    """
    order = np.argsort(stamps_ns, kind="stable")
    stamps_ns, arrivals_ns = stamps_ns[order], arrivals_ns[order]
    clocks, unsure, next_ns = dict[int, Clock](), set[int](), 1 << 62
    for number, span in reversed(_spans(stamps_ns, begins_ns)):
        stamps, arrivals = stamps_ns[span], arrivals_ns[span]
        clock = fit_clock(stamps, arrivals)
        host = clock.host_ns(stamps)
        most_ns = min(MOST_LATE_NS, max(0, int(host.min())))
        late_ns = min(max(0, int(host.max()) - next_ns + 1), most_ns)
        clocks[number] = replace(clock, offset_ns=clock.offset_ns - late_ns)
        next_ns = int(host.min()) - late_ns
        on_line = stamps[arrivals - host <= AGREE_NS]
        if len(begins_ns) and (len(on_line) < 2 or np.ptp(on_line) < EXPOSURE_NS):
            unsure.add(number)
    return EpochClock(begins_ns, clocks, frozenset(unsure))


def _spans(stamps_ns: NDArray[np.int64], begins_ns: NDArray[np.int64]) -> list[tuple[int, slice]]:
    """Return number and slice of each epoch that has any of the sorted stamps."""
    ends = [0, *np.searchsorted(stamps_ns, begins_ns, "left").tolist(), len(stamps_ns)]
    return [(number, slice(low, high)) for number, (low, high) in enumerate(pairwise(ends)) if low < high]


def begins_of(name: str, events: Iterable[tuple[int, str]]) -> NDArray[np.int64]:
    """Return the stamps int64 (k,) at which a clock's epochs 1 .. k begin. events: (stamp in ns, text)."""
    texts = {BACK.format(name), SET_ANEW.format(name)}
    begins = sorted(
        at_ns - EPOCH_MARGIN_NS for at_ns, text in events if text in texts and 0 <= at_ns < 1 << 63
    )
    return np.array(begins[:MAX_EPOCHS], np.int64)


def _envelope(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Return slope and intercept of the line below all points (n,) with the least mean distance to them.

    The line is the edge of their lower convex hull at the mean x.
    """
    order = np.lexsort((y, x))
    corner = _lower_hull(x[order].tolist(), y[order].tolist())
    x_hull, y_hull = x[order][corner], y[order][corner]
    right = int(np.clip(np.searchsorted(x_hull, x.mean()), 1, max(len(corner) - 1, 1)))
    if right >= len(corner):
        return 0.0, float(y.min())
    run, rise = x_hull[right] - x_hull[right - 1], y_hull[right] - y_hull[right - 1]
    slope = float(np.clip(rise / run, -LIMIT_SKEW, LIMIT_SKEW))
    return slope, float((y_hull - slope * x_hull).min())


def _lower_hull(x: list[float], y: list[float]) -> list[int]:
    """Return the corners of the lower convex hull of points sorted by x, then y (Andrew 1979)."""
    corner: list[int] = []
    for i in range(len(x)):
        if corner and x[corner[-1]] == x[i]:
            continue
        while len(corner) > 1:
            a, b = corner[-2:]
            if (x[b] - x[a]) * (y[i] - y[a]) > (y[b] - y[a]) * (x[i] - x[a]):
                break
            corner.pop()
        corner.append(i)
    return corner
