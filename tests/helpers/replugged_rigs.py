"""Random rigs whose devices are unplugged and plugged in, and the pairs of their frames.

Images come late, with jitter, stalls, drops and skew, and clocks are set while they run. Readings pass
through ``Arrivals`` as in a recording, and are paired by ``host_times`` as in ``Session``.
"""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import ColorImage, DepthImage, DeviceReading, Flag, ThermalImage, Value
from sensors.recording.arrival_times import Arrivals, Event
from sensors.rig.clock import begins_of
from sensors.rig.pairing import CLOCK, COLOR_WINDOW_NS, pair_stamps, thermal_window_ns
from sensors.session.host_times import host_times
from sensors.session.index import PLACE
from sensors.session.messages import COLOR, DEPTH, IMAGES, THERMAL

Int = NDArray[np.int64]
UNIX_NS = 1_700_000_000_000_000_000
LATE_S, AWAY_S = 0.3, 1.0  # s; largest delay of a first image, least absence of a device
SLACK_NS = 2_000_000  # ns at the edge of a window with two right results: jitter of the arrivals
FEW = 3  # images of a short epoch
PIXEL = np.zeros((1, 1))
VALUES: dict[str, Value] = {
    DEPTH: DepthImage(PIXEL.astype(np.uint16)),
    COLOR: ColorImage(b""),
    THERMAL: ThermalImage(PIXEL.astype(np.float32), Flag.OPEN),
}


@dataclass
class Case:
    """A recording. rows: by topic, [stamp, arrival, when it was made] of each image, nanoseconds."""

    rows: dict[str, list[tuple[int, int, int]]] = field(default_factory=lambda: defaultdict(list))
    metadata: dict[str, str] = field(default_factory=dict)
    events: list[tuple[int, str]] = field(default_factory=list)


def epochs(rng: np.random.Generator, span_s: float) -> list[tuple[float, float, bool]]:
    """Draw a device's epochs: [from, to) in seconds, and whether it was opened or only its clock was set."""
    runs, at_s, opened = [], 0.0, True
    while at_s < span_s:
        short = rng.random() < 0.15
        end_s = at_s + (rng.uniform(0.0, 0.1) if short else rng.exponential(span_s / 3))
        # At least one image, wherever in its period.
        end_s = max(end_s, at_s + 0.04)
        runs.append((at_s, min(end_s, span_s), opened))
        opened = rng.random() < 0.8
        at_s = end_s + (AWAY_S + rng.exponential(3.0) if opened else 0.0)
    return runs


def arrivals_s(made_s: NDArray[np.float64], rng: np.random.Generator, late: bool) -> NDArray[np.float64]:
    """Draw an epoch's arrivals: 5 ms after the images were made, with jitter, stalls, a late first image."""
    delay_s = 0.005 + rng.exponential(rng.choice([0.0005, 0.001, 0.003]), len(made_s))
    arrive_s = made_s + delay_s
    for start_s in rng.uniform(made_s[0], made_s[-1] + 1e-9, int((made_s[-1] - made_s[0]) / 10)):
        stalled = (arrive_s >= start_s) & (arrive_s < start_s + 0.2)
        arrive_s[stalled] = start_s + 0.2
    if late:
        arrive_s[0] += rng.uniform(0.0, LATE_S)
    # Later images wait for a late one, except where a driver reads each stream by itself.
    return np.maximum.accumulate(arrive_s) if rng.random() < 0.5 else arrive_s


def add_device(case: Case, address: str, streams: dict[str, float], span_s: float, seed: int) -> None:
    """Record a device with its images a second by topic."""
    rng = np.random.default_rng(seed)
    arrivals, skew = Arrivals(UNIX_NS), rng.uniform(-60e-6, 60e-6)
    drop, zero_s = rng.choice([0.0, 0.02, 0.2]), 0.0
    case.metadata |= {f"{CLOCK}{topic}": address for topic in streams}
    for number, (from_s, to_s, opened) in enumerate(epochs(rng, span_s)):
        if number and opened:
            arrivals.away.add(address)
        zero_s = rng.uniform(-1000, 1000) if opened or rng.random() < 0.5 else zero_s - rng.uniform(0.2, 5)
        phase_s = rng.uniform(0, 0.033)
        made = []
        for topic, hz in streams.items():
            later_s = phase_s + (0.004 if topic == COLOR and len(streams) > 1 else 0.0)
            count = max(1, int((to_s - from_s - later_s) * hz) + 1)
            made += [(from_s + later_s + i / hz, topic) for i in range(count)]
        made = sorted(one for one in made if rng.random() >= drop) or made[:1]
        made_s = np.array([at_s for at_s, _ in made])
        for (at_s, topic), arrive_s in zip(made, arrivals_s(made_s, rng, opened), strict=True):
            stamp_ns = round((at_s * (1 + skew) + zero_s) * 1e9)
            arrival_ns, value = round(arrive_s * 1e9), VALUES[topic]
            for item in arrivals.add(address, DeviceReading(stamp_ns, arrival_ns, value), 0):
                if isinstance(item, Event):
                    case.events.append((item.stamp_ns, item.text))
                else:
                    case.rows[topic].append((item.stamp_ns, item.arrival_ns, UNIX_NS + round(at_s * 1e9)))


def draw(seed: int, span_s: float) -> Case:
    """Draw a random recording."""
    rng, case = np.random.default_rng(seed), Case()
    first, second, third = (int(one) for one in rng.integers(1 << 40, size=3))
    if rng.random() < 0.5:
        add_device(case, "kinect2:1", {DEPTH: 30.0, COLOR: 30.0}, span_s, first)
    else:
        add_device(case, "kinect2:1", {DEPTH: 30.0}, span_s, first)
        add_device(case, "uvc:1", {COLOR: 30.0}, span_s, second)
    add_device(case, "optris:1", {THERMAL: float(rng.choice([9.0, 27.0, 128.0]))}, span_s, third)
    return case


def judged(case: Case) -> dict[tuple[str, str], tuple[int, int, int]]:
    """Count frames with a right, a wrong and no image, by topic and kind of epoch."""
    places, made = {}, {}
    for topic in IMAGES:
        rows = np.array(sorted(case.rows.get(topic, [])), np.int64).reshape(-1, 3)
        places[topic], made[topic] = np.zeros(len(rows), PLACE), rows[:, 2]
        places[topic]["stamp_ns"], places[topic]["arrival_ns"] = rows[:, 0], rows[:, 1]
    host = host_times(places, case.metadata, case.events)
    counted = {}
    for topic in (COLOR, THERMAL):
        window_ns = COLOR_WINDOW_NS if topic == COLOR else thermal_window_ns(host.ns[topic])
        at = host.pairs(DEPTH, topic, window_ns)
        ideal = pair_stamps(made[DEPTH], made[topic], window_ns)
        apart = np.abs(made[topic][at] - made[DEPTH]) if len(made[topic]) else np.zeros(len(at))
        best = np.abs(made[topic][ideal] - made[DEPTH]) if len(made[topic]) else np.zeros(len(at))
        wrong = (at >= 0) & (apart > window_ns + SLACK_NS)
        missing = (at < 0) & (ideal >= 0) & (best < window_ns - SLACK_NS)
        short = in_short(case, DEPTH, places[DEPTH]["stamp_ns"])
        partner = in_short(case, topic, places[topic]["stamp_ns"])
        if len(partner):
            short |= (ideal >= 0) & partner[ideal] | (at >= 0) & partner[at]
        for kind, chosen in (("short", short), ("long", ~short)):
            parts = (chosen & ~wrong & ~missing, chosen & wrong, chosen & missing)
            counted[topic, kind] = tuple(int(part.sum()) for part in parts)
    return counted


def in_short(case: Case, topic: str, stamps_ns: Int) -> NDArray[np.bool_]:
    """Return flags (n,) of the images in epochs of at most ``FEW`` images."""
    epoch = np.searchsorted(begins_of(case.metadata[f"{CLOCK}{topic}"], case.events), stamps_ns, "right")
    return np.asarray(np.bincount(epoch)[epoch] <= FEW, np.bool_) if len(epoch) else np.zeros(0, np.bool_)
