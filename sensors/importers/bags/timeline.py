"""Order and times of the messages of a topic, and pairs of messages of two topics.

Stamps are the sender's times, receive times are the recorder's. A sender's clock may step back, may differ
from the clock of the next camera, or may be missing. Constants are untuned.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sensors.errors import Note, Setting
from sensors.rig.frame import FRAME_PERIOD_NS, regular_times_ns
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps

Times = NDArray[np.int64]

MOVED, LATE_NS = 3, 500_000_000  # most that transport moves a message: farther back is a clock's step
EQUAL_SHARE = 0.1  # of messages with the stamp of the previous one; above it stamps are too coarse
PAIRED_SHARE = 0.5  # of the images of the slower stream; below it stamps pair too few
_S = 1e9


@dataclass(frozen=True)
class Timeline:
    """Messages of one topic in reading order, each array (n,).

    recorded: indices of the messages in the order of receive times. times_ns: final times, never decreasing.
    stamps_ns, received_ns: as recorded. epochs: number of earlier backward steps of the clock. notes:
    assumptions.
    """

    recorded: Times
    times_ns: Times
    stamps_ns: Times
    received_ns: Times
    epochs: Times
    notes: tuple[str, ...] = ()
    stamped: bool = True


@dataclass(frozen=True)
class Stamps:
    """Times of a topic's messages in the order of receive times. same: function that returns whether two
    messages hold the same bytes.
    """

    name: str
    stamps_ns: Times
    received_ns: Times
    same: Callable[[int, int], bool]


def timeline_of(given: Stamps) -> Timeline:
    """Order a topic's messages and compute their times.

    A repeated message is read once. A message that was received at most a few positions late is moved. After
    a backward step of the clock the recorded order stays, and times continue by the receive times.
    """
    stamps_ns, received_ns, name = given.stamps_ns, given.received_ns, given.name
    order, notes = np.arange(len(stamps_ns)), list[str]()
    if len(order) and (not stamps_ns.any() or (len(order) > 1 and np.ptp(stamps_ns) == 0)):
        order, notes = _once(given, order, received_ns)
        return _received(given, order, notes)
    if (np.diff(stamps_ns) < 0).any():
        by_stamp = np.argsort(stamps_ns, kind="stable")
        if np.abs(by_stamp - order).max() <= MOVED and not _steps_back(stamps_ns, received_ns):
            notes.append(f"{name}: {np.count_nonzero(by_stamp != order)} messages were received out of order")
            order = by_stamp
    order, twice = _once(given, order, stamps_ns)
    notes += twice
    equal = int(np.count_nonzero(np.diff(stamps_ns[order]) == 0))
    if equal > EQUAL_SHARE * len(order) and np.count_nonzero(np.diff(received_ns[order]) == 0) < equal:
        coarse = _received(given, np.sort(order), [])
        return replace(coarse, notes=(*notes, *coarse.notes))
    if equal:
        notes.append(f"{name}: {equal} messages have the stamp of the message before")
    times_ns, epochs, stepped = _bridged(name, stamps_ns[order], received_ns[order])
    return Timeline(order, times_ns, stamps_ns[order], received_ns[order], epochs, (*notes, *stepped))


def paired(depth: Timeline, color: Timeline) -> tuple[Times, tuple[str, ...]]:
    """Return for each depth image the index of its colour image, or -1, and notes.

    Images are paired by stamps. Receive times are used where stamps pair less than half of the images and
    receive times pair more.
    """
    slower = min(len(depth.times_ns), len(color.times_ns))
    pairs, notes = paired_by_stamps(depth, color, COLOR_WINDOW_NS), list[str]()
    if np.count_nonzero(pairs >= 0) < PAIRED_SHARE * slower:
        received = _paired_by_received(depth, color)
        has = received >= 0
        if np.count_nonzero(has) > np.count_nonzero(pairs >= 0):
            pairs, why = received, ""
            if depth.stamped and color.stamped:
                apart = _apart(depth.stamps_ns[has], color.stamps_ns[received[has]])
                why = f": its stamps are {apart} than depth's"
            notes.append(f"colour paired by receive times{why}")
    found = int(np.count_nonzero(pairs >= 0))
    if found < len(pairs):
        why = ""
        if slower and not found:
            nearest = pair_stamps(depth.times_ns, color.times_ns, 1 << 62)
            has = nearest >= 0
            apart = _apart(depth.times_ns[has], color.times_ns[nearest[has]])
            why = f"; colour is {apart} than depth: record both on one clock"
        window = f"{COLOR_WINDOW_NS / 1e6:.0f} ms"
        notes.append(f"{found} of {len(pairs)} depth images have a colour image within {window}{why}")
    return pairs, tuple(notes)


def paired_by_stamps(depth: Timeline, other: Timeline, window_ns: int) -> Times:
    """Pair as ``pair_stamps`` does, within each epoch of the clock; no pairs where the epochs differ."""
    pairs = np.full(len(depth.times_ns), -1, np.int64)
    if not len(other.times_ns) or not len(depth.times_ns) or not (depth.stamped and other.stamped):
        return pairs
    if depth.epochs[-1] != other.epochs[-1]:
        return pairs
    for epoch in range(int(depth.epochs[-1]) + 1):
        mine, its = (np.flatnonzero(each.epochs == epoch) for each in (depth, other))
        found = pair_stamps(depth.stamps_ns[mine], other.stamps_ns[its], window_ns)
        pairs[mine[found >= 0]] = its[found[found >= 0]]
    return pairs


def _paired_by_received(depth: Timeline, color: Timeline) -> Times:
    pairs = np.full(len(depth.times_ns), -1, np.int64)
    mine, its = (np.argsort(each.received_ns, kind="stable") for each in (depth, color))
    found = pair_stamps(depth.received_ns[mine], color.received_ns[its], COLOR_WINDOW_NS)
    pairs[mine[found >= 0]] = its[found[found >= 0]]
    return pairs


def _steps_back(stamps_ns: Times, received_ns: Times) -> bool:
    """Return whether the clock stepped back; otherwise transport delayed single messages.

    After a step all later messages have a larger delay (receive time minus stamp), after a delayed message
    they have not.
    """
    late_ns = int((np.maximum.accumulate(stamps_ns) - stamps_ns).max())
    if late_ns > LATE_NS:
        return True
    if np.ptp(received_ns) < np.ptp(stamps_ns) / 2:
        return False  # the messages were received in a burst, perhaps by a converter
    delays_ns = received_ns - stamps_ns
    falls = np.flatnonzero(np.diff(stamps_ns) < 0) + 1
    shifts = [np.median(delays_ns[at:]) - np.median(delays_ns[:at]) for at in falls]
    return float(max(shifts)) > late_ns / 2


def _received(given: Stamps, order: Times, notes: list[str]) -> Timeline:
    """Return the timeline of a topic without usable stamps: by receive times, else at a regular rate."""
    times_ns = given.received_ns[order]
    note = Note(f"{given.name} has no usable time stamps: receive times are taken")
    if len(times_ns) > 1 and np.ptp(times_ns) == 0:
        times_ns = times_ns[0] + regular_times_ns(len(times_ns))
        note = Note(
            f"{given.name} has no usable times: taken as 30 a second; else give the rate", Setting.RATE
        )
    zeros = np.zeros(len(order), np.int64)
    stamps = given.stamps_ns[order], given.received_ns[order]
    return Timeline(order, times_ns, *stamps, zeros, (note, *notes), stamped=False)


def _once(given: Stamps, order: Times, times_ns: Times) -> tuple[Times, list[str]]:
    """Return the order without messages that repeat the previous one, and a note on such messages."""
    kept = [*map(int, order[:1])]
    for at in map(int, order[1:]):
        if times_ns[at] != times_ns[kept[-1]] or not given.same(kept[-1], at):
            kept.append(at)
    twice = len(order) - len(kept)
    notes = [f"{given.name}: {twice} messages are in the recording twice, read once"] if twice else []
    return np.array(kept, np.int64), notes


def _bridged(name: str, stamps_ns: Times, received_ns: Times) -> tuple[Times, Times, tuple[str, ...]]:
    """Return continuous times across backward steps, the number of steps before each message, and a note."""
    steps = np.diff(stamps_ns)
    back = steps < 0
    if not back.any():
        return stamps_ns, np.zeros(len(stamps_ns), np.int64), ()
    forward = steps[steps > 0]
    usual_ns = int(np.median(forward)) if len(forward) else FRAME_PERIOD_NS
    gaps = np.diff(received_ns)
    steps = np.where(back, np.where(gaps > 0, gaps, usual_ns), steps)
    times_ns = np.concatenate([stamps_ns[:1], stamps_ns[0] + np.cumsum(steps)])
    first = int(np.argmax(back))
    fell_s = (stamps_ns[first] - stamps_ns[first + 1]) / _S
    note = (
        f"{name}: its clock steps back {np.count_nonzero(back)} times, first by {fell_s:.3f} s at message "
        f"{first + 1}: the recorded order is kept"
    )
    return times_ns, np.concatenate([[0], np.cumsum(back)]).astype(np.int64), (note,)


def _apart(depth_ns: Times, color_ns: Times) -> str:
    """Return the time difference of colour and depth as text."""
    apart_s = float(np.median((color_ns - depth_ns).astype(np.float64))) / _S
    return f"{abs(apart_s):.3f} s {'later' if apart_s > 0 else 'earlier'}"
