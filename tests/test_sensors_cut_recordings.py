"""Recordings that were cut off, paused, or never closed are read as far as they go, and losses are named."""

import re

import numpy as np
import pytest

from sensors.errors import CloudError
from sensors.importers.bags.bag import Bag
from sensors.importers.bags.realsense import WRAPS_NS, RealSenseRecording, unwrapped
from sensors.importers.bags.ros1_file import Ros1File
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics
from tests.helpers import realsense_files
from tests.helpers.bags import SECOND, color_image, depth_image, realsense, write_old_bag
from tests.helpers.realsense_files import write_old_bag as write_realsense_bag
from tests.helpers.samples import azure_depth, azure_jpeg, azure_mkv

LENS = Intrinsics(64, 48, 50, 51, 31.5, 23.5)


def in_order(frames: int) -> list[tuple[str, object, int]]:
    """Messages of a RealSense's node, received in the order of time, calibration first."""
    messages = realsense(frames)
    messages = [m for m in messages if m[2] < 10] + [m for m in reversed(messages) if m[2] >= 10]
    return [(topic, message, SECOND + at) for at, (topic, message, _) in enumerate(messages)]


def chunks(data: bytes) -> list[tuple[int, int]]:
    """(begin, end) of the chunks of a ROS 1 bag, by the format's own text."""
    found, at = [], len(b"#ROSBAG V2.0\n")
    while at < len(data):
        header = int.from_bytes(data[at : at + 4], "little")
        size = int.from_bytes(data[at + 4 + header : at + 8 + header], "little")
        end = at + 8 + header + size
        if b"op=\5" in data[at : at + 4 + header]:
            found.append((at, end))
        at = end
    return found


def assert_frames(source: Bag, count: int) -> None:
    """Frames are right wherever they are, and as many as ``count``."""
    assert len(source) == count
    for frame in source:
        index = (frame.stamp_ns - SECOND) // 33_000_000
        np.testing.assert_array_equal(frame.depth_mm, depth_image(index))
        if frame.color_encoded is not None:
            np.testing.assert_array_equal(frame.decode_color(), color_image(index))


def frames_of(path, check) -> int:
    """Number of frames, checked; 0 for a recording that is refused in one line."""
    try:
        source = open_source(path)
        check(source)
        return len(source)
    except CloudError as error:
        assert "\n" not in str(error)
        return 0


# ROS 1


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_a_bag_without_an_index_is_read_as_one_with(tmp_path, compression):
    """As a recorder that was killed leaves it: chunks alone, and 0 where the index would begin."""
    path = write_old_bag(tmp_path / "x.bag", in_order(4), compression)
    whole = path.read_bytes()
    head = whole[: chunks(whole)[0][0]]
    at = head.index(b"index_pos=") + len(b"index_pos=")
    active = tmp_path / "x.bag.active"
    active.write_bytes(head[:at] + bytes(8) + head[at + 8 :] + b"".join(whole[a:b] for a, b in chunks(whole)))
    for file in (path, active):
        source = open_source(file)
        assert isinstance(source, Bag) and not any("cut off" in note for note in source.notes)
        assert_frames(source, 4)
    index = Ros1File(path)
    assert {"/tf_static", "/camera/depth/camera_info"} <= index.topics
    for entry in index.entries():
        assert index.read(entry.topic, entry.place) == entry.data


def test_the_last_chunk_of_a_killed_recorder_has_the_length_zero(tmp_path):
    path = write_old_bag(tmp_path / "x.bag", in_order(4))
    whole = path.read_bytes()
    begin, end = chunks(whole)[0]
    body = begin + 8 + int.from_bytes(whole[begin : begin + 4], "little")
    path.write_bytes(whole[: body - 4] + bytes(4) + whole[body:end])
    assert_frames(open_source(path), 4)


def test_a_bag_cut_anywhere_is_read_up_to_the_cut_or_named(tmp_path):
    """Every chunk that is there in full counts, and a note states where the rest is lost."""
    path = tmp_path / "x.bag"
    whole = write_old_bag(path, in_order(6)).read_bytes()

    def check(source) -> None:
        assert_frames(source, len(source))
        noted = any("x.bag is cut off or damaged at byte" in note for note in source.notes)
        assert noted or len(source) == 6

    counts = []
    for cut in np.linspace(0, len(whole) - 1, 60).astype(int):
        path.write_bytes(whole[:cut])
        counts.append(frames_of(path, check))
    assert max(counts) == 6 and counts == sorted(counts)


def test_a_damaged_chunk_costs_its_own_messages_alone(tmp_path):
    """A bit of each chunk flips in turn; the others are read, and a note names the place."""
    path = write_old_bag(tmp_path / "x.bag", in_order(4), "BZ2", chunk_bytes=1)
    whole = path.read_bytes()
    for begin, end in chunks(whole)[-3 * 4 :]:  # of depth, colour and infrared
        spoilt = bytearray(whole)
        spoilt[end - (end - begin) // 4] ^= 16
        path.write_bytes(spoilt)
        source = open_source(path)
        assert any(re.match(rf"x\.bag is damaged at byte {begin}\b", note) for note in source.notes)
        assert len(source) >= 3
        assert_frames(source, len(source))


# RealSense


def smooth(number: int) -> np.ndarray:
    v, u = np.mgrid[:48, :64]
    return (1000 + 10 * u + 5 * v + number).astype(np.uint16)


def take(folder, stamps_ms: list[float], numbers: list[int]) -> RealSenseRecording:
    grey, yuyv = np.zeros((48, 64), np.uint8), np.zeros((48, 64, 2), np.uint8)
    stamped = zip(numbers, stamps_ms, strict=True)
    frames = [(number, ms, smooth(i), grey, yuyv) for i, (number, ms) in enumerate(stamped)]
    lens = LENS, "Brown Conrady"
    source = open_source(write_realsense_bag(folder / "x.bag", frames, (lens, lens)))
    for i, frame in enumerate(source):
        np.testing.assert_array_equal(frame.depth_mm, smooth(i))
        assert frame.color_encoded is not None
    return source


def steps(start_ms: float, count: int = 6) -> list[float]:
    return [start_ms + 33 * i for i in range(count)]


@pytest.mark.parametrize("start_ms", [1.7e12, 5000.0])
@pytest.mark.parametrize("minutes", [1, 30, 40, 80, 300])
def test_pauses_keep_order_and_length(tmp_path, start_ms, minutes):
    stamps = [stamp + minutes * 60_000 * (i >= 3) for i, stamp in enumerate(steps(start_ms))]
    numbers = [10 + i + 1800 * minutes * (i >= 3) for i in range(6)]  # the camera goes on
    source = take(tmp_path, stamps, numbers)
    np.testing.assert_allclose(source.times_ns, 1e6 * np.array(stamps), atol=1000)
    assert any(f"1 pauses of {60 * minutes} s" in note for note in source.notes)
    assert not any("were lost" in note for note in source.notes)


def test_the_cameras_own_clock_wraps_around(tmp_path):
    """The camera's clock has 32 bits in microseconds, where the SDK gives it instead of the host's."""
    wrap = 2**32 / 1000
    source = take(tmp_path, [stamp % wrap for stamp in steps(wrap - 90)], list(range(6)))
    np.testing.assert_allclose(np.diff(source.times_ns), 33e6, atol=2000)
    host = np.array([5 * 10**18, 4 * 10**18], np.int64)
    np.testing.assert_array_equal(unwrapped(host, int(host[0])), host)
    early = np.array([WRAPS_NS - 5, 3, 9], np.int64)  # depth begins after the clock did
    np.testing.assert_array_equal(unwrapped(early, 2), [-5, 3, 9])


def test_a_counter_that_starts_again_loses_nothing(tmp_path):
    """With the clock of a camera that was reset, the recorded order stays."""
    source = take(tmp_path, steps(1.7e12), [100_000, 100_001, 100_003, 1, 2, 3])
    assert "1 depth images were lost while it was recorded" in source.notes
    assert any("counter of images starts again 1 times" in note for note in source.notes)
    (tmp_path / "x.bag").unlink()
    stamps = steps(400_000.0, 3) + steps(900.0, 3)
    source = take(tmp_path, stamps, [12_000, 12_001, 12_002, 1, 2, 3])
    assert (np.diff(source.times_ns) > 0).all()
    assert any("steps back 1 times" in note for note in source.notes)


def test_the_recorders_times_are_no_order(tmp_path, monkeypatch):
    """A pause before the first image, or the end of a recording, spoils them."""
    logged_ns = [4 * 10**18, 10**9, 2 * 10**9, 5 * 10**9, 6 * 10**9, 3 * 10**18]
    monkeypatch.setattr(realsense_files, "LOGGED_NS", logged_ns)
    source = take(tmp_path, steps(1.7e12), list(range(6)))
    np.testing.assert_allclose(source.times_ns, 1e6 * np.array(steps(1.7e12)), atol=1000)


# Azure Kinect


def test_an_azure_recording_cut_anywhere_gives_whole_images(tmp_path):
    """An image that the end cuts off is left out: depth with its frame, infrared and colour alone."""
    whole, path = azure_mkv(4), tmp_path / "a.mkv"
    size = 2 * azure_depth(0).size

    def check(source) -> None:
        for i, frame in enumerate(source):
            np.testing.assert_array_equal(frame.depth_mm, azure_depth(i))
            assert frame.color_encoded in (None, azure_jpeg(i))
            if frame.infrared is not None:
                np.testing.assert_array_equal(frame.infrared, azure_depth(i))
        assert "a.mkv is cut off: its end is lost" in source.notes

    near = (1, 2, 300, len(azure_jpeg(3)) + 30, size, size + 200, 2 * size, 2 * size + 60)
    cuts = {len(whole) - back for back in near} | set(np.linspace(0, len(whole) - 1, 60).astype(int))
    counts = []
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        counts.append(frames_of(path, check))
    assert set(counts) == {0, 1, 2, 3, 4} and counts == sorted(counts)


def test_the_real_azure_recording_cut_in_an_image_says_so(shared_data, tmp_path):
    file, path = shared_data / "azure_kinect" / "recording.mkv", tmp_path / "a.mkv"
    path.write_bytes(file.read_bytes()[:-400_000])
    source = open_source(path)
    frame = source.frame(0)
    assert len(source) == 1 and frame.infrared is None and "no infrared images" in source.notes
    np.testing.assert_array_equal(frame.depth_mm, open_source(file).frame(0).depth_mm)
    path.write_bytes(file.read_bytes()[:-1_000_000])
    with pytest.raises(CloudError, match=r"no readable depth image \(it is cut off\)"):
        open_source(path)
