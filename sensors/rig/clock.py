"""Device clocks against the host's: offset and skew from the lower envelope of the delays.

A message arrives after a delay that is never negative: transport, plus whatever the host was busy with. The
line below all delays, as near to them as can be, is the clock; stalls and jitter only lie above it.

A device that was unplugged, or whose clock was set, begins an *epoch* with another offset. Each epoch is
fitted by itself.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

LIMIT_SKEW = 200e-6
"""No crystal of a camera or host is off by more; a steeper envelope is jitter over a short time."""
FARTHEST_NS = 1 << 62
"""Nanoseconds by which a clock is off at most: 146 years."""
BACK, SET_ANEW = "{} is back", "{}: its clock was set"
"""Events at which a clock begins an epoch; the clock's name is in them."""
EPOCH_MARGIN_NS = 100_000_000
"""Nanoseconds before an epoch's first reading in which its readings may be stamped too: another stream of
the device is stamped earlier and arrives later. At least as long before that, there is no reading."""
MAX_EPOCHS = 10_000
"""Beginnings of one clock that are heeded: of a device that is opened every second for three hours."""
MOST_LATE_NS = 60_000_000_000
"""Nanoseconds by which an epoch's fit is moved back at most: a damaged file may state more."""
AGREE_NS, EXPOSURE_NS = 5_000_000, 20_000_000
"""Nanoseconds of delay within which readings agree; within which stamps may be of one exposure (untuned)."""


@dataclass(frozen=True)
class Clock:
    """host_ns = stamp_ns + offset_ns + skew * (stamp_ns - origin_ns)."""

    offset_ns: int
    skew: float
    origin_ns: int

    def host_ns(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Device stamps (n,) on the host's clock."""
        since = stamps_ns - self.origin_ns
        host = stamps_ns + self.offset_ns + np.rint(self.skew * since).astype(np.int64)
        return np.asarray(host, np.int64)


def fit_clock(stamps_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64]) -> Clock:
    """Fit a device's clock to the host's arrivals, both (n,), n >= 1.

    What is transported fastest is taken to arrive at once: a constant delay cannot be seen from here.
    """
    origin = int(stamps_ns[0])
    since = (stamps_ns - origin).astype(np.float64)
    delay = arrivals_ns - stamps_ns
    base = int(delay.min())
    skew, offset = _envelope(since, (delay - base).astype(np.float64))
    # A damaged file may state times that no sum of two can hold.
    return Clock(max(-FARTHEST_NS, min(FARTHEST_NS, base + round(offset))), skew, origin)


@dataclass(frozen=True)
class EpochClock:
    """Clock of one device in all its epochs. begins_ns: (k,) stamps at which epochs 1 .. k begin.

    clocks: of the epochs that have readings, by number. unsure: numbers of epochs whose readings do not agree
    on the offset: they are too few, and the first one after a device was opened is often late.
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
        """Return flags (n,) of sorted device stamps whose time on the host's clock is sure."""
        flags = np.ones(len(stamps_ns), np.bool_)
        for number, span in _spans(stamps_ns, self.begins_ns):
            flags[span] = number not in self.unsure
        return flags


def fit_epochs(
    stamps_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64], begins_ns: NDArray[np.int64]
) -> EpochClock:
    """Fit each epoch of a clock to the host's arrivals, both (n,), n >= 1.

    Readings keep their order: a fit that is later than the first reading of the epoch after it is too late.
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
    """Return epochs that have any of the sorted stamps, by number, and where in the stamps they are."""
    ends = [0, *np.searchsorted(stamps_ns, begins_ns, "left").tolist(), len(stamps_ns)]
    return [(number, slice(low, high)) for number, (low, high) in enumerate(pairwise(ends)) if low < high]


def begins_of(name: str, events: Iterable[tuple[int, str]]) -> NDArray[np.int64]:
    """Return int64 (k,): stamps from which on a clock's epochs 1 .. k are. events: (stamp in ns, text)."""
    texts = {BACK.format(name), SET_ANEW.format(name)}
    begins = sorted(
        at_ns - EPOCH_MARGIN_NS for at_ns, text in events if text in texts and 0 <= at_ns < 1 << 63
    )
    return np.array(begins[:MAX_EPOCHS], np.int64)


def _envelope(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and intercept of the line under all points (n,) with the least mean distance to them.

    It is the side of their convex hull that lies below the mean x.
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
    """Corners of the lower convex hull of points sorted by x, then y (Andrew 1979)."""
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
