"""A turned thermal camera is found out on an ordinary session, and by how much."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from annotate.person.alignment import measure_drift
from sensors.errors import CalibrationError
from sensors.rig.rig_calibration import Pose
from synth.rig.virtual_rig import RigOptions, VirtualRig

FRAMES = 8


@pytest.fixture(scope="module")
def session():
    rig = VirtualRig(FRAMES, 2, "clean", 3, RigOptions(draft=True))
    return rig.calibration, list(rig)


@pytest.mark.parametrize("turned_deg", [0.0, -2.0, 3.0])
def test_the_angle_is_found(session, turned_deg):
    calibration, frames = session
    turn = Pose(Rotation.from_euler("y", turned_deg, degrees=True).as_matrix(), np.zeros(3))
    turned = replace(calibration, thermal_from_depth=turn @ calibration.thermal_from_depth)
    drift = measure_drift(frames, turned)
    right, down = drift.shift_px
    expected_px = calibration.depth.fx * np.tan(np.radians(turned_deg))
    assert abs(abs(right) - abs(expected_px)) < 3.5
    assert abs(down) < 3.5
    assert drift.is_tolerable == (turned_deg == 0)
    assert drift.frames == FRAMES


def test_without_temperatures_nothing_can_be_said(session):
    calibration, frames = session
    blind = [replace(frame, thermal_c=None) for frame in frames]
    with pytest.raises(CalibrationError, match="0 frames"):
        measure_drift(blind, calibration)
