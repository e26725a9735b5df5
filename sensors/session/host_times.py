"""Times of a session's messages on the host's clock, and pairing of images by these times."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.rig.clock import EpochClock, begins_of, fit_epochs
from sensors.rig.pairing import CLOCK, LATENCY, MAX_LATENCY_MS, pair_stamps
from sensors.session.index import Places


@dataclass(frozen=True)
class HostTimes:
    """Times int64 (n,) of the messages of every topic, nanoseconds on one common clock.

    sure: flags (n,). A time is unsure where its device was open for a few images only, which leave the offset
    unknown. clocks: names of the topics' clocks, "" where none is stated.
    """

    ns: dict[str, NDArray[np.int64]]
    sure: dict[str, NDArray[np.bool_]]
    clocks: dict[str, str]

    def pairs(self, master: str, other: str, window_ns: int) -> NDArray[np.intp]:
        """Return for each message of topic ``master`` the index of its message of ``other``, or -1.

        Pairs as ``pair_stamps``. Unsure times of different clocks are not compared.
        """
        at = pair_stamps(self.ns[master], self.ns[other], window_ns)
        if self.clocks[master] == self.clocks[other] or not len(self.ns[other]):
            return at
        return np.where(self.sure[master] & self.sure[other][at], at, -1)


def host_times(
    places: dict[str, Places], metadata: dict[str, str], events: Iterable[tuple[int, str]] = ()
) -> HostTimes:
    """Return the times at which messages were made.

    Metadata name the clock that stamped a topic (``clock /depth/image``). Each clock is fitted to the host's
    in each epoch, which the events (stamp in ns, text) begin. All topics without a stated clock share one.
    """
    clocks = {topic: metadata.get(f"{CLOCK}{topic}", "") for topic in places}
    fitted, events = dict[str, EpochClock](), tuple(events)
    for name in set(clocks.values()) - {""}:
        stamped = [found for topic, found in places.items() if clocks[topic] == name]
        if len(both := np.concatenate(stamped)):
            fitted[name] = fit_epochs(both["stamp_ns"], both["arrival_ns"], begins_of(name, events))
    ns, sure = dict[str, NDArray[np.int64]](), dict[str, NDArray[np.bool_]]()
    for topic, found in places.items():
        stamps = found["stamp_ns"]
        ns[topic], sure[topic] = stamps, np.ones(len(stamps), np.bool_)
        if (clock := fitted.get(clocks[topic])) is not None:
            late_ns = round(_latency_ms(metadata.get(f"{LATENCY}{topic}", "0")) * 1e6)
            # Images keep their order, even at a damaged file's clocks.
            ns[topic] = np.maximum.accumulate(clock.host_ns(stamps) - late_ns)
            sure[topic] = clock.sure(stamps)
    return HostTimes(ns, sure, clocks)


def _latency_ms(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if 0 <= value <= MAX_LATENCY_MS else 0.0
