"""Bad frames of issue 4: labels say which stream, which frame and what to do, and guess nothing."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from annotate.label_recording import SuitLabeller, label_source
from annotate.parts import UNDEFINED
from annotate.suit.palette import DEFAULT_SUIT
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.reader import Session


class Changed(FrameSource):
    """A recording of which one frame, the second, is changed; or the calibration of all."""

    def __init__(self, session: Session, change=lambda frame: frame, calibration=None):
        self._session, self._change = session, change
        self.name, self.calibration = session.name, calibration or session.calibration
        self.times_ns = session.times_ns

    def _frame(self, index: int) -> RigFrame:
        frame = self._session.frame(index)
        return self._change(frame) if index == 1 else frame


def exposed(gain: float) -> Callable[[RigFrame], RigFrame]:
    def change(frame: RigFrame) -> RigFrame:
        rgb = cv2.imdecode(np.frombuffer(frame.color_encoded, np.uint8), cv2.IMREAD_COLOR)
        bent = np.clip(rgb.astype(np.float32) * gain, 0, 255).astype(np.uint8)
        return replace(frame, color_encoded=bytes(cv2.imencode(".jpg", bent)[1]))

    return change


def cold(frame: RigFrame) -> RigFrame:
    return replace(frame, thermal_c=np.full_like(frame.thermal_c, 20.0))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (cold, ("no person", "thermal", "step into the view")),
        (exposed(40.0), ("colour is over-exposed", "lower the colour camera's exposure")),
        (exposed(0.04), ("colour is too dark", "light the room")),
    ],
)
def test_a_bad_frame_is_named_and_its_parts_stay_undefined(tmp_path, rig_session, change, said):
    done = label_source(
        Changed(Session(rig_session), change), SuitLabeller(DEFAULT_SUIT), tmp_path / "l", lambda n: None
    )
    notes = [note for note, frames in done.remarks().items() if frames == ["000001"]]
    assert any(all(word in note for word in said) for note in notes), done.remarks()
    parts = {frame.frame_id: np.unique(frame.parts) for frame in done.labels}
    assert set(parts["000001"]) <= {0, UNDEFINED}
    assert len(parts["000002"]) >= 10


def turned(calibration: RigCalibration, degrees: float, axis: int) -> RigCalibration:
    """The thermal camera's extrinsics, off by a turn about its x axis (0) or its y axis (1)."""
    turn = cv2.Rodrigues(np.radians(degrees) * np.eye(3)[axis])[0]
    pose = calibration.thermal_from_depth
    return replace(
        calibration, thermal_from_depth=Pose(turn @ pose.rotation, turn @ np.asarray(pose.translation_m))
    )


@pytest.mark.parametrize("axis", [0, 1])
def test_a_thermal_camera_3_degrees_off_in_its_extrinsics_is_found_out(tmp_path, rig_session, axis):
    session = Session(rig_session)
    source = Changed(session, calibration=turned(session.calibration, 3.0, axis))
    done = label_source(source, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", lambda n: None)
    (frames,) = ({i for n, ids in done.remarks().items() if "calibrate the thermal" in n for i in ids},)
    assert len(frames) >= 2
    for frame in done.labels:
        assert frame.frame_id not in frames or set(np.unique(frame.parts)) <= {0, UNDEFINED}
