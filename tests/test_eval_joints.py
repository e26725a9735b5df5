"""Errors of a network's joints: by hand, only inside the image, absent without joints on either side."""

from dataclasses import replace

import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from eval.scores.joint_errors import joint_errors_mm, summary
from eval.scores.joints import BONES, IN_SKELETON, JOINT, JOINT_NAMES, N_JOINTS, TWIN
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from synth.body import skeleton

CAMERA = Intrinsics(161, 141, 140.0, 130.0, 80.0, 70.0)
PARTS = np.zeros(CAMERA.shape, np.uint8)


def truth_of(joints_mm: np.ndarray) -> FrameLabels:
    everywhere = np.full((skeleton.N_JOINTS, 3), 1000.0)
    everywhere[IN_SKELETON] = joints_mm
    return FrameLabels("f", PARTS.astype(np.uint16), PARTS, notes={"joints_mm": everywhere.tolist()})


def predicted_of(joints_mm: np.ndarray) -> FrameLabels:
    """Labels with the joints in pixels, as a network notes them."""
    pixels = [(CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy, z) for x, y, z in joints_mm]
    return FrameLabels("f", PARTS.astype(np.uint16), PARTS, notes={"bearing": {"joints_px": pixels}})


@pytest.fixture
def joints() -> np.ndarray:
    return np.random.default_rng(0).uniform((-300, -300, 2000), (300, 300, 2400), (N_JOINTS, 3))


def test_errors_are_distances_in_millimetres(joints):
    moved = joints + np.arange(N_JOINTS)[:, None] * np.array([2.7, 0.0, 3.6])
    errors = joint_errors_mm(predicted_of(moved), truth_of(joints), CAMERA)
    np.testing.assert_allclose(errors, 4.5 * np.arange(N_JOINTS), atol=1e-9)
    found = summary(errors[None])
    assert (found["frames"], found["scored"], found["mpjpe_mm"]) == (1, 15, pytest.approx(31.5))
    assert found["pck_50mm"] == pytest.approx(12 / 15) and found["by_joint"][JOINT_NAMES[14]]["pck_50mm"] == 0


def test_only_joints_inside_the_image_are_scored(joints):
    joints[JOINT["left_wrist"]] = (2000, 0, 2000)
    errors = joint_errors_mm(predicted_of(joints), truth_of(joints), CAMERA)
    assert np.flatnonzero(np.isnan(errors)).tolist() == [JOINT["left_wrist"]]


@pytest.mark.parametrize(
    "note", [{}, {"bearing": 3}, {"bearing": {"joints_px": [[1, 2, 3]]}}, {"bearing": {"joints_px": "x"}}]
)
def test_without_joints_nothing_is_scored(joints, note):
    assert np.isnan(
        joint_errors_mm(replace(predicted_of(joints), notes=note), truth_of(joints), CAMERA)
    ).all()
    assert np.isnan(joint_errors_mm(predicted_of(joints), predicted_of(joints), CAMERA)).all()


@pytest.mark.parametrize("note", [[], "x", [[0, 0, np.inf]] * skeleton.N_JOINTS])
def test_malformed_true_joints_are_named(joints, note):
    truth = replace(truth_of(joints), notes={"joints_mm": note})
    with pytest.raises(FormatError, match=r"frame f: field notes\.joints_mm is malformed"):
        joint_errors_mm(predicted_of(joints), truth, CAMERA)


def test_joints_have_twins_and_bones():
    assert all(TWIN[TWIN[i]] == i for i in range(N_JOINTS)) and TWIN[JOINT["left_hip"]] == JOINT["right_hip"]
    assert {end for bone in BONES for end in bone} == set(JOINT_NAMES)
