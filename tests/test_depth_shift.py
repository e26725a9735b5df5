"""The depth shift of a calibration: measured, kept in every file, added once, where depth becomes points."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotate.cloud.coarse import CoarseFuser
from annotate.cloud.fuse import Fuser
from annotate.foxglove.topics import Shown, shown_messages
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.source_recording import Recorded
from sensors.calibration_files.calibration_yaml import open_calibration, read_yaml, write_yaml
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import CalibrationError
from sensors.recording.rig_templates import REFERENCE, TEMPLATES
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FARTHEST_MM
from sensors.rig.rig_calibration import (
    RigCalibration,
    calibration_from_json,
    calibration_to_json,
    load_calibration,
    save_calibration,
)
from sensors.session.messages import CALIBRATIONS, SHIFT
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from synth.rig.plate_views import DEPTH_SHIFT_MM, PlateViews

SMALL = Intrinsics(24, 20, 18.0, 18.0, 11.2, 9.7, k1=0.05)
shifts = st.floats(-500, 500, allow_nan=False)


@given(shifts, st.integers(0, 10**6))
def test_every_reading_is_moved_once_and_no_reading_stays_none(shift_mm, seed):
    rng = np.random.default_rng(seed)
    ends = rng.choice([0, 1, 30, 600, 1500, 65000, FARTHEST_MM], SMALL.shape)
    depth = np.where(rng.random(SMALL.shape) < 0.5, ends, rng.integers(0, 65535, SMALL.shape))
    depth = depth.astype(np.uint16)
    plain, moved = (
        Fuser(RigCalibration(SMALL, depth_shift_mm=mm)).fuse(depth).depth_mm for mm in (0.0, shift_mm)
    )
    true = plain.astype(int) + round(shift_mm)
    np.testing.assert_array_equal(moved, np.where((plain > 0) & (true > 0) & (true <= FARTHEST_MM), true, 0))
    coarse = CoarseFuser(RigCalibration(SMALL, depth_shift_mm=shift_mm)).fuse(depth)
    np.testing.assert_array_equal(coarse.depth_mm, moved)
    seen = coarse.cloud.depth_mm > 0
    np.testing.assert_array_equal(coarse.cloud.depth_mm[seen], moved.ravel()[coarse.pixel[seen]])


@given(shifts)
def test_it_survives_json_and_a_calibration_without_it_has_none(shift_mm):
    rig = RigCalibration(SMALL, depth_shift_mm=shift_mm)
    assert calibration_from_json(json.loads(json.dumps(calibration_to_json(rig)))) == rig
    assert calibration_from_json({"depth": calibration_to_json(rig)["depth"]}).depth_shift_mm == 0


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), 501, -1e9, "far", None, [1], {}])
def test_an_impossible_shift_is_refused(wrong):
    with pytest.raises(CalibrationError, match="shift"):
        calibration_from_json({**calibration_to_json(RigCalibration(SMALL)), "depth_shift_mm": wrong})


def test_it_survives_every_file_and_recorded_depth_stays_as_the_camera_gave_it(tmp_path):
    rig = RigCalibration(SMALL, depth_shift_mm=-23.6)
    write_yaml(tmp_path / "yaml", rig)
    save_calibration(tmp_path / "rig.json", rig)
    assert open_calibration(tmp_path / "yaml") == load_calibration(tmp_path / "rig.json") == rig
    # kinect2_bridge.cpp adds depthShift: depth.convertTo(depthShifted, CV_16U, 1, depthShift).
    storage = cv2.FileStorage(str(tmp_path / "yaml" / "calib_depth.yaml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("depthShift").real() == -23.6
    raw = np.full(SMALL.shape, 1524, np.uint16)
    for one, name in ((rig, "s"), (RigCalibration(SMALL), "none")):
        with SessionWriter(tmp_path / f"{name}.mcap", one, "rig") as writer:
            writer.write_depth(raw, 1)
        session = Session(tmp_path / f"{name}.mcap")
        assert session.calibration == one
        np.testing.assert_array_equal(session.frame(0).depth_mm, raw)
        assert ("depth readings are moved by -24 mm, as calibrated" in session.notes) == (one is rig)


def test_a_camera_that_reads_wrongly_is_right_after_calibration(annotate_cloud, tmp_path):
    """From the plate to points: a wall is where it is, within 2 mm, through command, session and labels.

    The plate's camera reads 8 mm too near by itself.
    """
    # The views have a colour camera, which the test leaves out: a small one is rendered sooner.
    full, too_far_mm = TEMPLATES[REFERENCE], 24
    template = replace(full, calibration=replace(full.calibration, color=SMALL))
    true = replace(full.calibration, color=None, color_from_depth=None)
    views = PlateViews(template, 10, 5, bad_share=0.0)
    with SessionWriter(tmp_path / "board.mcap", true, "board") as writer:
        for frame in views:
            more = too_far_mm - DEPTH_SHIFT_MM
            read = np.where(frame.depth_mm > 0, np.rint(frame.depth_mm + more), 0)
            writer.write(replace(frame, depth_mm=read.astype(np.uint16), color_encoded=None))
    arguments = ("calibrate", tmp_path / "board.mcap", "--out", tmp_path / "rig.json", "--json")
    done = annotate_cloud(*arguments, "--yaml", tmp_path / "yaml")
    assert done.result["depth_shift_mm"] == pytest.approx(-too_far_mm, abs=1.5)
    rig = load_calibration(tmp_path / "rig.json")
    assert read_yaml(tmp_path / "yaml").depth_shift_mm == rig.depth_shift_mm
    wall = np.full(KINECT2_DEPTH.shape, 2000 + too_far_mm, np.uint16)
    with SessionWriter(tmp_path / "wall.mcap", rig, "wall") as writer:
        writer.write_depth(wall, 1)
    session = Session(tmp_path / "wall.mcap")
    cloud = Fuser(session.calibration).fuse_frame(session.frame(0))
    assert np.nanmax(np.abs(cloud.points_m[..., 2] - 2.0)) < 0.002
    labels = label_source(session, SuitLabeller(None), tmp_path / "labels", lambda n: None).labels
    frame = labels.read("000000")
    np.testing.assert_array_equal(frame.depth_mm, cloud.depth_mm)
    beside = Recorded(labels, session.path).fused(frame)
    assert beside.remark == ""
    np.testing.assert_array_equal(beside.cloud.points_m, cloud.points_m)
    # A label set's own images are right already, and so are those for Foxglove.
    np.testing.assert_array_equal(Recorded(labels, None).fused(frame).cloud.points_m, cloud.points_m)
    shown = Shown(1, cloud, frame.parts, session.calibration)
    topics = {topic for topic, _, _ in shown_messages(shown)}
    assert CALIBRATIONS.keys() & topics and SHIFT not in topics
