"""Bags whose clocks step back, differ, repeat or are missing keep order, times and pairs."""

import numpy as np
import pytest

from sensors.importers.bags.timeline import Stamps, paired, timeline_of
from sensors.importers.open_source import open_source
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.frame import FRAME_PERIOD_NS
from tests.helpers.bag_scenes import (
    PERIOD,
    START,
    assert_depth,
    colour_of,
    colours,
    depths,
    noted,
    rig,
    scene,
)
from tests.helpers.bags import SECOND, STORAGES, write_bag


@pytest.fixture
def opened(tmp_path):
    """Frames from messages of a bag."""
    made = []

    def opened(messages, options=AS_STATED, storage=STORAGES[1]):
        made.append(write_bag(tmp_path / f"bag{len(made)}", storage, [*rig(), *messages]))
        return open_source(made[-1], options)

    return opened


def assert_recorded_order(source) -> None:
    assert_depth(source, 8)
    assert [colour_of(frame) for frame in source] == list(range(8))
    np.testing.assert_array_equal(np.diff(source.times_ns), PERIOD)


@pytest.mark.parametrize("back", [1.7e10, 36_000.0, 50.0, 2.0])
def test_a_clock_that_steps_back_leaves_the_recorded_order(opened, back):
    """back: periods by which both clocks step after the fourth of eight images."""
    stamps = [i - back * (i > 3) if back < 1e10 else (i if i < 4 else i - 1.69e10) for i in range(8)]
    source = opened([*depths(stamps=stamps), *colours(stamps=stamps)])
    assert_recorded_order(source)
    assert noted(source, "/camera/depth/image_raw", "steps back 1 times", "recorded order is kept")


@pytest.mark.parametrize("back", [36_000.0, 50.0])
def test_a_computer_whose_clock_is_set_back_leaves_the_recorded_order(opened, back):
    """Stamps and receive times step alike; the order in the file stays."""
    stamps = [i - back * (i > 3) for i in range(8)]
    messages = [
        (topic, message, START + int(stamp * PERIOD))
        for made in (depths(stamps=stamps), colours(stamps=stamps))
        for (topic, message, _), stamp in zip(made, stamps, strict=True)
    ]
    assert_recorded_order(opened(messages))


def test_messages_out_of_order_are_put_in_their_order(opened):
    """A few were received late, or the file has them in any order."""
    source = opened(depths(stamps=[0, 1, 3, 2, 4, 5, 6, 7]))
    assert [int(f.depth_mm[20, 50] - scene()[20, 50]) // 7 for f in source] == [0, 1, 3, 2, 4, 5, 6, 7]
    assert (np.diff(source.times_ns) == PERIOD).all()
    assert noted(source, "2 messages were received out of order")
    shuffled = np.random.default_rng(1).permutation(40)
    assert_depth(opened([depths(stamps=range(40))[i] for i in shuffled]), 40)


@pytest.mark.parametrize("off", [0.25, -0.25, 36_000.0, -1.69e10])
def test_colour_on_another_clock_is_paired_by_receive_times(opened, off):
    source = opened([*depths(), *colours(stamps=[i + off for i in range(4)])])
    assert [colour_of(frame) for frame in source] == [0, 1, 2, 3]
    assert noted(source, "by receive times", "later" if off > 0 else "earlier", f"{abs(off) / 10:.3f} s")


def test_colour_that_nothing_pairs_is_counted(opened):
    late = [(topic, m, at + 30 * SECOND) for topic, m, at in colours(stamps=[i + 300 for i in range(4)])]
    source = opened([*depths(), *late])
    assert noted(source, "0 of 4 depth images have a colour image within 17 ms", "s later than depth")
    some = opened([*depths(), *colours()[:3]])
    assert noted(some, "3 of 4 depth images have a colour image within 17 ms")


@pytest.mark.parametrize("stamp", [0, 5])
def test_stamps_that_are_all_alike_are_none(opened, stamp):
    source = opened(depths(stamps=[stamp - START / PERIOD * (stamp == 0)] * 4))
    np.testing.assert_array_equal(source.times_ns, START + np.arange(4) * PERIOD)
    assert noted(source, "/camera/depth/image_raw has no usable time stamps")


@pytest.mark.parametrize("storage", STORAGES)
def test_without_any_times_a_rate_counts(opened, storage):
    messages = [(t, m, 7) for t, m, _ in depths(stamps=[-START / PERIOD] * 4)]
    source = opened(messages, storage=storage)
    np.testing.assert_array_equal(np.diff(source.times_ns), FRAME_PERIOD_NS)
    assert noted(source, "no usable times", "give the rate")
    source = opened(messages, ImportOptions(rate_hz=10), storage)
    np.testing.assert_array_equal(np.diff(source.times_ns), PERIOD)
    assert_depth(source)


def test_a_message_that_is_there_twice_is_read_once(opened):
    once = [*depths(), *colours()]
    source = opened([*once, *once])
    assert_depth(source)
    assert noted(source, "/camera/depth/image_raw: 4 messages are in the recording twice")
    equal = opened(depths(stamps=[*range(10), 9, *range(11, 30)]))
    assert len(equal) == 30 and noted(equal, "1 messages have the stamp of the message before")


def test_times_never_decrease_and_every_message_is_there():
    """For all stamps and receive times: a law of the timeline, over random ones."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        count = int(rng.integers(1, 30))
        stamps = np.cumsum(rng.integers(-3, 5, count)) * int(rng.choice([10**6, 10**8, 10**11])) + 10**13
        received = np.sort(rng.integers(0, 10**12, count)) if rng.random() < 0.7 else np.full(count, 5)
        line = timeline_of(Stamps("x", stamps, received, lambda a, b: False))
        assert sorted(line.recorded) == list(range(count))
        assert (np.diff(line.times_ns) >= 0).all()
        pairs, _ = paired(line, line)
        used = pairs[pairs >= 0]
        assert len(set(used)) == len(used)
