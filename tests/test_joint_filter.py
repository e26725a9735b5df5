"""Joints filtered over a recording: still where the person rests, late by the stated lag, new after a gap."""

from dataclasses import replace

import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from annotate.posture import POSTURES
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import BodyState
from eval.network.joints.joint_filter import HZ_PER_M_S, LONGEST_S, REST_HZ, USUAL_S, filter_joints
from eval.scores.joints import N_JOINTS
from sensors.rig.camera import Intrinsics

CAMERA = Intrinsics(64, 48, 600.0, 600.0, 31.5, 23.5)
START = np.random.default_rng(0).uniform(-300, 300, (N_JOINTS, 3)) + np.array([0, 0, 2000])


def labelled(joints_mm, at=10) -> Segmentation:
    """A person with these joints, whose pixels begin at a column."""
    parts = np.zeros((48, 64), np.uint8)
    parts[10:30, at : at + 20] = 2
    posture = np.eye(len(POSTURES), dtype=np.float32)[0]
    state = BodyState(0.0, 0.5, posture, np.zeros((N_JOINTS, 3))).placed(joints_mm, CAMERA)
    return Segmentation(parts, np.ones(parts.shape, np.float32), bearing=state.note() | {"sided": 1.5})


def filtered(film, seconds=USUAL_S, **place):
    """Joints (F, 15, 3) of successive measurements, as `predict` stores them."""
    before, given = None, []
    for number, joints_mm in enumerate(film):
        found = filter_joints(labelled(joints_mm, **place), before, CAMERA, round(number * seconds * 1e9))
        before = FrameLabels("", np.zeros((48, 64), np.uint16), found.parts, notes={"bearing": found.bearing})
        given.append(BodyState.from_note(found.bearing).joints_mm(CAMERA))
        assert found.bearing["sided"] == 1.5
    return np.array(given), before


def test_joints_at_rest_tremble_a_fifth_and_keep_their_place():
    film = START + np.random.default_rng(1).normal(0, 6, (90, N_JOINTS, 3))
    given, _ = filtered(film)
    jumps = [np.median(np.linalg.norm(np.diff(joints, 2, axis=0)[10:], axis=-1)) for joints in (film, given)]
    assert jumps[1] < jumps[0] / 5
    assert np.abs(given[30:].mean(0) - START).max() < 5
    np.testing.assert_allclose(filtered([START] * 5)[0][-1], START, atol=1)  # rounding of the notes


@pytest.mark.parametrize("seconds", [1 / 30, 1 / 15])
@pytest.mark.parametrize("m_s", [0.5, 1.0])
def test_a_joint_in_steady_motion_lags_by_the_cutoff_of_its_speed(m_s, seconds):
    """The speed is measured from the last filtered joint, so it is the true one over the weight."""
    film = START + np.arange(60)[:, None, None] * [1000 * m_s * seconds, 0, 0]
    behind_mm = (film - filtered(film, seconds)[0])[-1, :, 0]
    lag_s = 0.0
    for _ in range(50):
        lag_s = 1 / (2 * np.pi * (REST_HZ + HZ_PER_M_S * m_s * (1 + lag_s / seconds)))
    np.testing.assert_allclose(behind_mm / (1000 * m_s), lag_s, atol=0.002)


def test_a_gap_another_place_and_a_lost_track_start_anew():
    given, before = filtered([START] * 3)
    moved = START + np.array([100, 0, 0])
    unseen = replace(before, notes={})
    now_ns = round(3e9 * USUAL_S)
    for found, last, stamp_ns in (
        (labelled(moved), before, now_ns + round(LONGEST_S * 1e9)),
        (labelled(moved), before, 0),
        (labelled(moved, at=40), before, now_ns),
        (labelled(moved), unseen, now_ns),
        (labelled(moved), None, None),
    ):
        state = BodyState.from_note(filter_joints(found, last, CAMERA, stamp_ns).bearing)
        np.testing.assert_allclose(state.joints_mm(CAMERA), moved, atol=1)
    state = BodyState.from_note(filter_joints(labelled(moved), before, CAMERA, now_ns).bearing)
    assert (np.abs(state.joints_mm(CAMERA) - given[-1]) < 60).all()
    broken = replace(before, notes={"bearing": before.notes["bearing"] | {"filter": {"mm_per_s": "x"}}})
    assert filter_joints(labelled(moved), broken, CAMERA, now_ns).bearing["filter"]["stamp_ns"] == now_ns
