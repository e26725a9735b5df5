"""The live pipeline: the latest frame, its labels and its warnings."""

import json
import math
import queue
import re
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from annotate.live.live_frame import Labelling
from annotate.live.pipeline import WORKERS, LivePipeline
from annotate.live.rig_warnings import rig_warnings
from annotate.live.warning import HOLD_S, ActiveWarnings, LiveWarning
from annotate.person.extract import PersonMask
from annotate.segmentation.segmented_person import unlabelled
from cli.live_view import show_lines
from sensors.device.protocol import ColorImage, DepthImage, DeviceReading, Flag, ThermalImage
from sensors.errors import CloudError
from sensors.interrupt import Ending
from sensors.recording.arrival_times import Arrived
from sensors.recording.frame_assembly import WAIT_NS, FrameAssembly, SyncedFrame
from sensors.recording.latest_value import LatestValue
from sensors.recording.running_clock import BIN_NS, RunningClock
from sensors.recording.stream_health import Health, StreamHealth, Watch
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from tests.helpers.labellers import no_person

RATES_HZ = {"depth": 30.0, "color": 30.0, "thermal": 128.0}
DEVICE = {"depth": "kinect", "color": "kinect", "thermal": "optris"}
DEVICES = [
    SimpleNamespace(address=name, rates_hz={s: hz for s, hz in RATES_HZ.items() if DEVICE[s] == name})
    for name in ("kinect", "optris")
]
EPOCH_NS = 1_700_000_000_000_000_000
DEPTH = np.full((2, 2), 1000, np.uint16)


def reading(stream: str, number: int, at_s: float, flag: Flag = Flag.OPEN, skew: float = 0.0):
    """Reading ``number`` of a stream, made at ``at_s``, here at once. Its value says its number."""
    value = {
        "depth": DepthImage(DEPTH + np.uint16(number)),
        "color": ColorImage(str(number).encode()),
        "thermal": ThermalImage(np.full((2, 2), number, np.float32), flag),
    }[stream]
    stamp, arrival = (EPOCH_NS + round(at_s * f * 1e9) for f in (1 + skew, 1.0))
    usable = flag is Flag.OPEN
    return Arrived(DEVICE[stream], DeviceReading(stamp, arrival, value), stamp, arrival, 0, usable)


def running(seconds: float, skew=0.0, without: str = "", closed_from_s: float = math.inf, drop=0.0):
    """Readings of a rig for so long, in the order of their arrival."""
    rng, made = np.random.default_rng(0), []
    for stream, hz in RATES_HZ.items():
        lost = 0
        for number in range(int(seconds * hz)):
            at_s = (number + 1) / hz + (0.004 if stream == "color" else 0.0)
            if stream == without and at_s > seconds / 2:
                continue
            if drop and rng.random() < drop:
                lost += 1
                continue
            flag = Flag.CLOSED if stream == "thermal" and at_s > closed_from_s else Flag.OPEN
            made.append((at_s, replace(reading(stream, number, at_s, flag, skew), lost=lost)))
            lost = 0
    return [item for _, item in sorted(made, key=lambda pair: pair[0])]


def untaken():
    """A running rig with full queues."""
    return [replace(item, overrun=item.lost) for item in running(8, drop=0.1)]


def every_other_color():
    """A running rig in the dark: the colour camera exposes for two periods."""
    return [
        item
        for item in running(8)
        if not isinstance(item.reading.value, ColorImage) or int(item.reading.value.encoded) % 2
    ]


def watched(items, **changes) -> Health:
    """The health of a rig after these readings."""
    watch = Watch(DEVICES, {})
    for item in items:
        watch.add(item)
    now_ns = EPOCH_NS + round(changes.pop("at_s") * 1e9)
    closed_s, skew_ppm = watch.flag_closed_s(now_ns), watch.skew_ppm()
    away = changes.pop("away", ())
    health = Health(watch.streams(now_ns, frozenset(away)), away, closed_s, skew_ppm)
    return replace(health, **changes)


def kinds(health: Health) -> set[str]:
    return {warning.kind for warning in rig_warnings(health)}


def test_the_latest_values_are_kept_and_read_once():
    queue = LatestValue[str](keep=2)
    assert queue.since(0, 0.0) == [] and queue.after(0, 0.0) is None
    for value in "abc":
        queue.put(value)
    assert queue.since(0, 0.0) == [(2, "b"), (3, "c")]
    assert queue.since(2, 0.0) == [(3, "c")] == [queue.after(2, 0.0)]
    queue.end()
    assert queue.since(3, 60.0) == [] and queue.ended


def test_every_depth_image_meets_the_images_taken_nearest_to_it():
    pairing, watch, frames = FrameAssembly(RATES_HZ), Watch(DEVICES, {}), []
    for item in running(2.0):
        pairing.add(item, watch.add(item))
        frames.append(pairing.latest(item.arrival_ns))
    frames = [synced.frame for synced in frames if synced is not None]
    assert len(frames) > 55
    for frame in frames:
        number = int(frame.depth_mm[0, 0]) - 1000
        assert frame.color_encoded == str(number).encode()
        at_s = (number + 1) / RATES_HZ["depth"]
        assert abs((frame.thermal_c[0, 0] + 1) / RATES_HZ["thermal"] - at_s) <= 0.5 / 128 + 1e-9


def test_a_depth_image_waits_for_its_partners_only_so_long():
    pairing = FrameAssembly(RATES_HZ)
    item = reading("depth", 3, 1.0)
    pairing.add(item, item.arrival_ns)
    assert pairing.latest(item.arrival_ns + WAIT_NS - 1) is None
    synced = pairing.latest(item.arrival_ns + WAIT_NS)
    assert synced is not None and synced.frame.color_encoded is None and synced.frame.thermal_c is None


def test_nothing_is_said_of_a_good_rig_for_a_minute():
    items, watch, said = running(60.0), Watch(DEVICES, {}), set()
    for number, item in enumerate(items):
        watch.add(item)
        if number % 50 == 0:
            at_ns = item.arrival_ns
            health = Health(watch.streams(at_ns), (), watch.flag_closed_s(at_ns), watch.skew_ppm())
            said |= kinds(health)
    assert not said


@pytest.mark.parametrize(
    ("kind", "says", "health"),
    [
        ("drops", "a USB port of its own", lambda: watched(running(8, drop=0.1), at_s=8)),
        ("drops", "computer is too slow", lambda: watched(untaken(), at_s=8)),
        ("drops", "disk is too slow", lambda: watched(untaken(), at_s=8, recording=Path("a.mcap"))),
        ("drops", "colour: 15 of 30", lambda: watched(every_other_color(), at_s=8)),
        ("silent", "colour", lambda: watched(running(8, without="color"), at_s=8)),
        ("clock", "kinect gains", lambda: watched(running(40, skew=5e-4), at_s=40)),
        ("flag", "flag", lambda: watched(running(8, closed_from_s=5), at_s=8)),
        ("disk", "4.0 minutes", lambda: watched(running(8), at_s=8, disk_minutes=4.0)),
        ("away", "kinect is gone", lambda: watched(running(8), at_s=8, away=("kinect",))),
        ("trouble", "No space", lambda: watched(running(8), at_s=8, trouble="No space left")),
    ],
)
def test_what_is_wrong_with_a_rig_is_said_and_nothing_else(kind, says, health):
    made = list(rig_warnings(health()))
    assert {warning.kind for warning in made} == {kind}
    assert any(says in warning.text for warning in made)


def test_the_silence_of_a_stream_grows():
    watch = Watch(DEVICES, {})
    for item in running(2.0):
        watch.add(item)
    for at_s in (4, 8, 60):
        assert watch.streams(EPOCH_NS + at_s * 10**9)["depth"].silent_s == pytest.approx(at_s - 2, abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_a_machine_that_is_too_busy_is_no_clock_that_drifts(seed):
    clock, steady = RunningClock(), RunningClock()
    for second, late_ns in enumerate(np.random.default_rng(seed).exponential(30e6, 60)):
        stamp = second * BIN_NS
        clock.host_ns(stamp, stamp + int(late_ns))
        steady.host_ns(stamp, stamp - second * 300_000)
    assert clock.skew_ppm == 0
    assert steady.skew_ppm == pytest.approx(300, rel=1e-3)


def test_a_complaint_stands_while_it_is_made_and_a_second_after():
    active, dark = ActiveWarnings(), LiveWarning("dark", "too dark")
    assert active.update([dark], 0.0) == ()
    assert active.update([dark], HOLD_S) == (dark,)
    assert active.update([], HOLD_S * 1.5) == (dark,)
    assert active.update([], HOLD_S * 2.1) == ()
    assert active.update([dark], HOLD_S * 3) == ()


def test_it_is_said_why_frames_have_no_labels(monkeypatch):
    monkeypatch.setattr("annotate.live.warning.HOLD_S", 0.0)

    def fails(*_):
        raise CloudError("no person in the mask")

    rig = SimpleNamespace(
        frames=LatestValue(), calibration=RigCalibration(Intrinsics(2, 2, 2.0, 2.0, 0.5, 0.5))
    )
    rig.health = Health
    pipeline = LivePipeline(rig, Labelling(fails, lambda *_: None))
    pipeline.start()
    rig.frames.put(SyncedFrame(RigFrame(0, 1, DEPTH), 1, 1))
    rig.frames.end()
    end_s = time.monotonic() + 60
    while not pipeline.frames.ended and time.monotonic() < end_s:
        time.sleep(0.01)
    pipeline.close()
    assert pipeline.error is None and pipeline.warned == {"frame": "no person in the mask"}


def test_complaints_are_said_of_a_rig_that_gives_no_images(capsys):
    silent = SimpleNamespace(
        frames=LatestValue(), warnings=(LiveWarning("silent", "depth: nothing for 3 s"),)
    )
    show_lines(silent, time.monotonic() + 0.1, None, Ending())
    assert "depth: nothing for 3 s" in capsys.readouterr().err


def test_every_frame_that_was_labelled_has_its_line(annotate_cloud, rig_session, monkeypatch):
    """The one that was being labelled when the time was over, too."""

    def slow(cloud, before):
        time.sleep(0.5)
        return no_person(cloud)

    monkeypatch.setattr("cli.live_view.labelling_by", lambda suit, weights: Labelling(slow, lambda *_: None))
    done = annotate_cloud("live", rig_session, "--no-window", "--seconds", 0.3)
    lines = [json.loads(line) for line in done.out.splitlines()]
    frames, labelled, skipped = map(int, re.findall(r"(\d+) (?:frames|labelled|skipped)", done.err))
    assert done.code == 0 and len(lines) == labelled > 0
    assert frames == labelled + skipped > labelled


def test_all_streams_that_lose_images_are_named_and_all_devices_that_are_gone():
    """One warning stands for each kind, so the warning must name all of them."""
    active, health = ActiveWarnings(), watched(running(8, drop=0.2), at_s=8, away=())
    for at_s in (0.0, HOLD_S):
        stand = active.update(rig_warnings(health), at_s)
    (drops,) = stand
    assert all(f"{name}: " in drops.text for name in ("depth", "colour", "thermal"))
    (away,) = rig_warnings(watched(running(8), at_s=8, away=("kinect", "optris")))
    assert "kinect is gone" in away.text and "optris is gone" in away.text


def test_what_was_missed_while_a_device_was_away_is_no_fault_of_its_rate():
    items = [
        item
        for item in running(12)
        if item.address == "optris" or not 4 < item.arrival_ns / 1e9 % 100 - EPOCH_NS / 1e9 % 100 < 7
    ]
    back = next(
        i for i, item in enumerate(items) if item.address == "kinect" and item.arrival_ns > EPOCH_NS + 7e9
    )
    items[back] = replace(items[back], restarted=True)
    assert not kinds(watched(items[: back + 60], at_s=8))


@pytest.mark.parametrize("verb", [["live"], ["record", "a.mcap"]])
def test_one_source_is_to_be_given(annotate_cloud, verb):
    done = annotate_cloud(*verb, "--rig", "ward.toml", "--device", "virtual:kinect2")
    assert done.code == 1 and "--rig and --device are given; give only one" in done.err
    done = annotate_cloud(*verb)
    assert done.code == 1 and "no source is given" in done.err


class ByHand:
    """A rig whose moments are put by hand; the depth in millimetres is the moment's number."""

    calibration = RigCalibration(Intrinsics(8, 6, 8.0, 8.0, 3.5, 2.5))

    def __init__(self):
        self.frames = LatestValue[SyncedFrame]()

    def put(self, number):
        frame = RigFrame(number, number, np.full((6, 8), number, np.uint16))
        self.frames.put(SyncedFrame(frame, number, number))

    def health(self):
        return Health({})


@pytest.mark.parametrize("seed", range(3))
def test_a_free_thread_labels_the_latest_frame_and_the_latest_is_shown_last(seed):
    rig, begun, rng = ByHand(), queue.Queue(), np.random.default_rng(seed)
    may_end, nobody = [threading.Event() for _ in range(40)], np.zeros((6, 8), bool)

    def label(cloud, before):
        number = int(cloud.depth_mm.max())
        begun.put(number)
        assert may_end[number].wait(60)
        return unlabelled(nobody), PersonMask(nobody, "depth", nobody.astype(np.uint8))

    pipeline = LivePipeline(rig, Labelling(label, lambda *_: None))
    pipeline.start()
    busy, latest = [], 0
    while len(busy) < WORKERS:
        latest += 1
        rig.put(latest)
        busy.append(begun.get(timeout=60))
    assert busy == list(range(1, WORKERS + 1))
    for _ in range(5):
        for _ in range(rng.integers(1, 5)):
            latest += 1
            rig.put(latest)
        may_end[busy.pop(rng.integers(len(busy)))].set()
        busy.append(begun.get(timeout=60))
        assert busy[-1] == latest
    shown = pipeline.frames.count
    may_end[latest].set()
    assert pipeline.frames.after(shown, 60)[1].synced.frame.index == latest
    for number in busy:
        may_end[number].set()
    rig.frames.end()
    pipeline.close()
    assert pipeline.error is None and pipeline.frames.after(0, 0)[1].synced.frame.index == latest


def test_a_session_is_played_back_as_lines_of_joints(annotate_cloud, rig_session):
    done = annotate_cloud("live", rig_session, "--no-window")
    rows = [json.loads(line) for line in done.out.splitlines()]
    assert done.code == 0 and rows and "labelled" in done.err
    assert len(rows[-1]["joints_mm"]) == 15 and "posture" in rows[-1]


def rig_of(streams: dict[str, StreamHealth], skew_ppm: float = 0.0) -> Health:
    return Health(streams, skew_ppm={"kinect": skew_ppm})


def test_a_computer_that_is_too_slow_is_named_and_neither_clocks_nor_cables():
    """While images are lost a clock looks slow; a fault of all cameras at once is not a cable's."""
    good = StreamHealth(30.0, rate_hz=30.0, recent=150, silent_s=0.0, count=300, running_s=10.0)
    losing = replace(good, recent=100, lost=50, overrun=50, dropped=50)
    assert {c.kind for c in rig_warnings(rig_of({"depth": good}, 20_000.0))} == {"clock"}
    assert {c.kind for c in rig_warnings(rig_of({"depth": good, "color": losing}, 20_000.0))} == {"drops"}
    silent = replace(good, silent_s=3.0)
    (all_of_them,) = rig_warnings(rig_of({"depth": silent, "color": silent}))
    assert "too slow" in all_of_them.text and "cable" not in all_of_them.text
    (one,) = rig_warnings(rig_of({"depth": good, "color": silent}))
    assert "cable" in one.text
