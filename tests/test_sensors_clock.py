"""Clocks: the fit lies below all delays, finds skew and offset through jitter and stalls, and pairs well."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.rig.clock import LIMIT_SKEW, fit_clock
from sensors.rig.pairing import COLOR_WINDOW_NS, THERMAL_WINDOW_NS, pair_stamps

S = 1_000_000_000
MS = 1_000_000


def arrivals(true_ns: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """5 ms of jitter, and a host that stalls for 200 ms now and then: what waits arrives together."""
    late = true_ns + np.abs(rng.normal(0, 5 * MS, len(true_ns))).astype(np.int64)
    for start in rng.uniform(true_ns[0], true_ns[-1], max(1, int((true_ns[-1] - true_ns[0]) / (5 * S)))):
        stalled = (late >= start) & (late < start + 200 * MS)
        late[stalled] = int(start) + 200 * MS
    return np.maximum.accumulate(late)


def clocked(
    rate_hz: float, seconds: float, skew: float, offset_ns: int, phase_ns: int
) -> tuple[np.ndarray, ...]:
    """True host times of a device's images, and what its own clock says."""
    true_ns = (phase_ns + np.arange(int(rate_hz * seconds)) * S / rate_hz).astype(np.int64)
    return true_ns, (true_ns * (1 - skew)).astype(np.int64) - offset_ns


@given(
    skew=st.floats(-60e-6, 60e-6),
    offset=st.integers(-(10**17), 10**17),
    rate=st.sampled_from([30.0, 128.0]),
    seed=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=30)
def test_the_fit_lies_below_and_finds_the_clock(skew, offset, rate, seed):
    true_ns, stamps = clocked(rate, 60, skew, offset, 7 * MS)
    late = arrivals(true_ns, np.random.default_rng(seed))
    clock = fit_clock(stamps, late)
    host = clock.host_ns(stamps)
    assert (host <= late + 2).all()
    assert np.abs(host - true_ns).max() < 1 * MS


@given(
    delays=st.lists(st.integers(0, 10**9), min_size=1, max_size=40),
    period=st.integers(1, 10**9),
)
@settings(deadline=None)
def test_any_delays_give_a_bounded_clock(delays, period):
    stamps = np.arange(len(delays), dtype=np.int64) * period
    clock = fit_clock(stamps, stamps + np.array(delays))
    assert abs(clock.skew) <= LIMIT_SKEW
    assert (clock.host_ns(stamps) <= stamps + np.array(delays) + 2).all()


@pytest.mark.parametrize("seed", range(5))
def test_pairs_are_within_their_windows(seed):
    rng = np.random.default_rng(seed)
    kinect, depth = clocked(30, 60, 50e-6, 5 * S, int(rng.integers(0, 33 * MS)))
    color = depth + 8 * MS
    optris, thermal = clocked(128, 60, -50e-6, -70 * S, int(rng.integers(0, 7 * MS)))
    both = fit_clock(np.r_[depth, color], np.r_[arrivals(kinect, rng), arrivals(kinect + 8 * MS, rng)])
    fir = fit_clock(thermal, arrivals(optris, rng))
    with_color = pair_stamps(both.host_ns(depth), both.host_ns(color), COLOR_WINDOW_NS)
    with_thermal = pair_stamps(both.host_ns(depth), fir.host_ns(thermal), THERMAL_WINDOW_NS)
    inside = (kinect > optris[0]) & (kinect < optris[-1])
    assert (with_color >= 0).mean() > 0.99
    assert (with_thermal >= 0)[inside].mean() > 0.99
    apart = np.abs(kinect - optris[with_thermal])[with_thermal >= 0]
    assert apart.max() <= THERMAL_WINDOW_NS + MS // 20


def naive_pairs(master, other, window):
    """The definition, pair by pair."""
    pairs = []
    for i, stamp in enumerate(master):
        j = min(range(len(other)), key=lambda j: (abs(other[j] - stamp), j), default=None)
        if j is None or abs(other[j] - stamp) > window:
            pairs.append(-1)
            continue
        back = min(range(len(master)), key=lambda i: (abs(master[i] - other[j]), i))
        pairs.append(j if back == i else -1)
    return pairs


stamps = st.lists(st.integers(0, 60), max_size=12).map(lambda v: np.array(sorted(v), np.int64))


@given(master=stamps, other=stamps, window=st.integers(0, 8))
@settings(deadline=None)
def test_pairing_is_its_definition_and_uses_nothing_twice(master, other, window):
    pairs = pair_stamps(master, other, window)
    assert pairs.tolist() == naive_pairs(master.tolist(), other.tolist(), window)
    used = pairs[pairs >= 0]
    assert len(set(used.tolist())) == len(used)
