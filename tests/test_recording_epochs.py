"""Clocks that begin anew: after a device came back, or its clock was set, each image keeps its partners."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.device.protocol import ColorImage as Color
from sensors.device.protocol import DepthImage, DeviceReading, Flag, ThermalImage
from sensors.recording.arrival_times import Arrivals, Arrived, Event
from sensors.rig.camera import Intrinsics
from sensors.rig.clock import BACK, fit_epochs
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.host_times import host_times
from sensors.session.index import PLACE
from sensors.session.messages import COLOR, DEPTH, color_message, image_message
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from tests.helpers.replugged_rigs import draw, judged

S, MS = 1_000_000_000, 1_000_000
START_NS = 1_700_000_000 * S
CAMERA = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)
RIG = RigCalibration(CAMERA, CAMERA, Pose.identity())
IMAGE = DepthImage(np.full((6, 8), 1000, np.uint16))


@pytest.mark.parametrize("late_ms", [6, 30, 100, 300])
def test_both_sides_of_a_gap_have_the_colour_of_their_frame(tmp_path, late_ms):
    """The depth camera is away from second 4 to 6; its first image afterwards is late."""
    clocks = {f"clock {DEPTH}": "kinect2:1", f"clock {COLOR}": "uvc:1"}
    made_ns = np.arange(0, 10 * S, S // 30)
    depth_ns = made_ns[(made_ns < 4 * S) | (made_ns >= 6 * S)]
    first_ns = depth_ns[depth_ns >= 6 * S][0]
    writer = SessionWriter(tmp_path / "a.mcap", RIG, "rig", metadata=clocks)
    with writer:
        for number, at_ns in enumerate(made_ns.tolist()):
            picture = b"\xff\xd8\xff" + number.to_bytes(4, "big")
            arrival_ns = START_NS + at_ns + 4 * MS + 5 * MS
            writer.add(COLOR, color_message(picture, arrival_ns), arrival_ns, arrival_ns)
        for at_ns in depth_ns.tolist():
            # The zero of each epoch is the arrival of its first image.
            zero_ns = START_NS + 5 * MS if at_ns < first_ns else START_NS + late_ms * MS
            arrival_ns = START_NS + at_ns + (late_ms * MS if at_ns == first_ns else 5 * MS)
            if at_ns == first_ns:
                writer.event(arrival_ns, "kinect2:1 was unplugged")
                writer.event(arrival_ns, BACK.format("kinect2:1"), arrival_ns)
            image = np.full((6, 8), 1 + round(at_ns * 30 / S), np.uint16)
            writer.add(DEPTH, image_message(image, "depth", zero_ns + at_ns), zero_ns + at_ns, arrival_ns)
    right = [
        frame.color_encoded is not None
        and int.from_bytes(frame.color_encoded[3:7], "big") == frame.depth_mm[0, 0] - 1
        for frame in Session(tmp_path / "a.mcap")
    ]
    assert np.mean(right) >= 0.99


def test_any_rig_that_is_replugged_at_random_pairs_right():
    """Clocks set back, drops, jitter, stalls, slow thermal cameras; short epochs may be unpaired."""
    total = {topic: np.zeros(3, int) for topic in (COLOR, "/thermal/image")}
    for seed in range(1000, 1030):
        for (topic, kind), counts in judged(draw(seed, 30.0)).items():
            total[topic] += counts
            if kind == "long":
                assert counts[0] >= 0.98 * sum(counts), (seed, topic, counts)
    for right, wrong, missing in total.values():
        assert right >= 0.99 * (right + wrong + missing) and wrong <= 0.002 * right


def places(stamps_ns: list[int], arrivals_ns: list[int]) -> np.ndarray:
    found = np.zeros(len(stamps_ns), PLACE)
    found["stamp_ns"], found["arrival_ns"] = stamps_ns, arrivals_ns
    return found


@pytest.mark.parametrize(("count", "paired"), [(1, False), (2, False), (3, True)])
def test_an_epoch_of_few_images_is_paired_only_if_they_agree_on_its_clock(count, paired):
    """The first is 200 ms late, which only two others that agree can show."""
    color = (START_NS + np.arange(0, 20 * S, S // 30)).tolist()
    made = [*color[:150], *color[300 : 300 + count], *color[450:]]
    late = [at + (200 * MS if at == color[300] else 0) for at in made]
    zero = {150: 0, 150 + count: 200 * MS, len(made): 0}
    stamps = [at + next(z for end, z in zero.items() if i < end) for i, at in enumerate(made)]
    back = BACK.format("kinect2:1")
    events = [(stamps[150], back), (stamps[150 + count], back)]
    clocks = {f"clock {DEPTH}": "kinect2:1", f"clock {COLOR}": "uvc:1"}
    host = host_times({DEPTH: places(stamps, late), COLOR: places(color, color)}, clocks, events)
    pairs = host.pairs(DEPTH, COLOR, 17 * MS)
    expected = np.searchsorted(color, made)
    few = slice(150, 150 + count)
    assert (np.delete(pairs, few) == np.delete(expected, few)).all()
    assert (pairs[few] == expected[few]).all() if paired else (pairs[few] == -1).all()
    # Within the device, nothing is unsure.
    same = clocks | {f"clock {COLOR}": "kinect2:1"}
    both = {DEPTH: places(stamps, late), COLOR: places(stamps, late)}
    assert (host_times(both, same, events).pairs(DEPTH, COLOR, 17 * MS) == np.arange(len(made))).all()


def arrivals_of(rows: list[tuple[int, int, bool]]) -> tuple[list[Arrived], list[Event]]:
    """Return what ``Arrivals`` makes of (stamp, arrival, whether the device was lost before)."""
    arrivals, made = Arrivals(START_NS), []
    for stamp_ns, arrival_ns, lost in rows:
        if lost:
            arrivals.away.add("kinect2:1")
        made += arrivals.add("kinect2:1", DeviceReading(stamp_ns, arrival_ns, IMAGE), 0)
    return [m for m in made if isinstance(m, Arrived)], [m for m in made if isinstance(m, Event)]


@given(
    st.lists(
        st.tuples(st.integers(0, 100 * S), st.integers(1, 40 * MS), st.booleans()), min_size=1, max_size=30
    )
)
@settings(deadline=None)
def test_stamps_only_rise_whatever_a_device_s_clock_does(steps):
    rows, arrival_ns = [], 0
    for stamp_ns, after_ns, lost in steps:
        arrival_ns += after_ns
        rows.append((stamp_ns, arrival_ns, lost))
    arrived, events = arrivals_of(rows)
    stamps = [one.stamp_ns for one in arrived]
    assert len(arrived) == len(rows) and stamps == sorted(stamps)
    begun = [one.stamp_ns for one in arrived if one.restarted]
    assert [event.stamp_ns for event in events] == begun
    # Between two beginnings the device's own distances are kept.
    for before, after, now in zip(arrived, arrived[1:], rows[1:], strict=False):
        if not after.restarted:
            assert after.stamp_ns - before.stamp_ns == now[0] - before.reading.stamp_ns


def test_a_clock_that_is_set_begins_an_epoch_and_one_that_is_late_does_not():
    rows = [(i * 33 * MS, i * 33 * MS + 5 * MS, False) for i in range(300)]
    late = [(s, a + (300 * MS if i == 0 else 0), lost) for i, (s, a, lost) in enumerate(rows)]
    skewed = [(s + s // 5000, a, lost) for s, a, lost in rows * 1]
    for steady in (rows, late, skewed):
        assert not arrivals_of(steady)[1]
    for by_s in (-3600, -1, 5, 3600):
        jumped = [
            (s + (by_s * S if i >= 200 else 0) + 4000 * S, a, lost) for i, (s, a, lost) in enumerate(rows)
        ]
        (event,) = arrivals_of(jumped)[1]
        assert event.text == "kinect2:1: its clock was set"


def test_one_epoch_is_fitted_as_ever_and_images_keep_their_order_over_the_next():
    """An epoch of one late image ends before the next one begins, however late it is."""
    stamps = np.array([0, S, 10 * S, 10 * S + 33 * MS, 10 * S + 66 * MS])
    arrivals = stamps + np.array([5, 5, 5, 5, 5]) * MS
    whole = fit_epochs(stamps, arrivals, np.zeros(0, np.int64))
    assert whole.sure(stamps).all() and not len(whole.begins_ns)
    arrivals[1] = 20 * S
    split = fit_epochs(stamps, arrivals, np.array([S // 2, 5 * S]))
    host = split.host_ns(stamps)
    assert (np.diff(host) > 0).all() and not split.sure(stamps)[1]


@given(
    st.lists(st.tuples(*[st.integers(0, (1 << 63) - 1)] * 2), min_size=1, max_size=20),
    st.lists(st.integers(0, (1 << 64) - 1), max_size=6),
)
@settings(deadline=None)
def test_whatever_a_damaged_file_states_its_times_are_in_order(rows, begins):
    stamps, arrivals = np.array(sorted(rows), np.int64).T
    events = [(at_ns, BACK.format("a")) for at_ns in begins]
    found = {DEPTH: places(stamps.tolist(), arrivals.tolist())}
    host = host_times(found, {f"clock {DEPTH}": "a"}, events)
    assert (np.diff(host.ns[DEPTH].astype(float)) >= 0).all() and len(host.sure[DEPTH]) == len(rows)


def test_readings_without_flag_or_of_other_streams_share_the_device_s_epoch():
    arrivals = Arrivals(START_NS)
    warm = ThermalImage(np.full((2, 2), 30, np.float32), Flag.OPEN)
    for number in range(5):
        for value in (IMAGE, Color(b""), warm):
            stamp_ns = number * 33 * MS + (0 if value is IMAGE else -20 * MS)
            (arrived,) = arrivals.add("a", DeviceReading(stamp_ns, number * 33 * MS, value), 0)
            assert not arrived.restarted
