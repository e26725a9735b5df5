"""Every source of frames reads frame i alone: in any order the same frames, at the times it states."""

import numpy as np
import pytest

from sensors.importers.open_source import open_source
from sensors.recording.rig_templates import template_named
from sensors.rig.frame import FrameSource, RigFrame
from synth.rig.plate_views import PlateViews
from synth.rig.virtual_rig import VirtualRig
from tests.test_sensors_session import RIG, assert_same
from tools.fuzz.samples import READERS

SOURCES = [
    *("session", "session-bare", "bag-sqlite", "bag-mcap", "bag-ros1", "realsense", "orbbec", "mkv"),
    *("npy", "npz", "pcd", "ply", "flir", "las", "images"),
]


def alike(one: RigFrame, other: RigFrame) -> None:
    assert one.color_encoded == other.color_encoded
    for image, copy in ((one.thermal_c, other.thermal_c), (one.infrared, other.infrared)):
        assert (image is None) == (copy is None)
    assert_same(one, other)


def assert_random_access(source: FrameSource) -> None:
    assert isinstance(source, FrameSource)
    frames = list(source)
    assert len(source) == len(frames) == len(source.times_ns) > 0
    assert source.times_ns.dtype == np.int64 and (np.diff(source.times_ns) >= 0).all()
    for index in np.random.default_rng(0).permutation(len(frames)).tolist():
        frame = source.frame(index)
        assert (frame.index, frame.stamp_ns) == (index, source.times_ns[index])
        alike(frame, frames[index])
    for index in (-1, len(frames)):
        with pytest.raises(IndexError):
            source.frame(index)
    assert isinstance(source.subject, str) and isinstance(source.events, tuple)
    assert all(isinstance(note, str) for note in source.notes)


@pytest.mark.parametrize("name", SOURCES)
def test_a_frame_is_the_same_in_any_order(tmp_path, name):
    pytest.importorskip("rosbags")
    source = open_source(READERS[name].make(tmp_path))
    assert source.path is not None and source.path.exists()
    assert_random_access(source)


@pytest.mark.usefixtures("shot_before")
def test_frames_of_simulated_rigs_too():
    assert_random_access(VirtualRig(3, 2, "clean", 5))
    assert_random_access(PlateViews(template_named("kinect2-optris"), 2, 0, bad_share=0.4))


def test_a_frame_that_cannot_be_read_leaves_the_next_ones():
    class Holed(FrameSource):
        name, times_ns = "holed", np.arange(3)

        def _frame(self, index: int) -> RigFrame:
            if index == 1:
                raise ValueError("damaged")
            return RigFrame(index, index, np.ones((24, 32), np.uint16))

    source = Holed()
    source.calibration = RIG
    frames = iter(source)
    assert next(frames).index == 0
    with pytest.raises(ValueError, match="damaged"):
        next(frames)
    assert next(frames).index == 2 and next(frames, None) is None
