"""Calibrated posture: the same in any resolution, doubtful where legs are out of view, with a right fit."""

from dataclasses import replace

import numpy as np
import pytest

from annotate.posture import POSTURES
from eval.network.body_state import LEAST_SURE, BodyState
from eval.network.posture_model import FEATURES, PostureModel, posture_features, with_posture
from eval.scores.joints import JOINT, JOINT_NAMES, N_JOINTS
from sensors.rig.camera import Intrinsics
from tools.fit.posture import cut, fitted

STANDING_MM = {"head": -700, "neck": -500, "shoulder": -450, "elbow": -150, "wrist": 100}
LEGS_MM = {"pelvis": 0, "hip": 30, "knee": 450, "ankle": 850}


def standing(pixels: int) -> tuple[BodyState, tuple[np.ndarray, np.ndarray], Intrinsics]:
    """Return the state, depth and mask, and camera of a person who stands 2.5 m away. pixels: of a side."""
    middle = (pixels - 1) / 2
    camera = Intrinsics(pixels, pixels, pixels * 1.1, pixels * 1.1, middle, middle)
    heights = STANDING_MM | LEGS_MM
    at = [
        [120 * (name.startswith("left") - name.startswith("right")), heights[name.split("_")[-1]], 2500]
        for name in JOINT_NAMES
    ]
    posture = np.array([0.9, *[0.02] * 5], np.float32)
    state = BodyState(0.0, 0.9, posture, np.zeros((N_JOINTS, 3))).placed(np.array(at, float), camera)
    rows = (np.arange(pixels) - middle) / (1.1 * pixels) * 2500
    person = np.zeros((pixels, pixels), np.bool_)
    person[(rows > -800) & (rows < 900), round(0.4 * pixels) : round(0.6 * pixels)] = True
    return state, (np.where(person, 2440, 0).astype(np.uint16), person), camera


def seated(state: BodyState, camera: Intrinsics) -> BodyState:
    """The person with thighs towards the camera."""
    joints = state.joints_mm(camera)
    for side in ("left", "right"):
        hip = joints[JOINT[f"{side}_hip"]]
        joints[JOINT[f"{side}_knee"]] = hip + np.array([0, 40, -420])
        joints[JOINT[f"{side}_ankle"]] = hip + np.array([0, 460, -400])
    return state.placed(joints, camera)


def test_features_are_the_same_in_any_resolution():
    small, large = (posture_features(*standing(pixels)) for pixels in (120, 480))
    np.testing.assert_allclose(small, large, atol=1e-9)
    named = dict(zip(FEATURES, large, strict=True))
    assert named["trunk up"] == named["shank along thigh"] == pytest.approx(1)
    assert named["knees seen"] == named["ankles seen"] == 1


def test_bent_legs_decide_where_the_network_is_in_doubt():
    state, image, camera = standing(240)
    state = replace(state, posture=np.array([0.48, 0.48, *[0.01] * 4], np.float32))
    upright = with_posture(state, image, camera)
    bent = with_posture(seated(state, camera), image, camera)
    assert (upright.likeliest, bent.likeliest) == ("standing", "sitting")
    assert upright.posture.sum() == pytest.approx(1) == bent.posture.sum()


def test_a_posture_below_the_bar_has_no_name():
    state = standing(120)[0]
    for sure, name in ((LEAST_SURE + 0.01, "standing"), (LEAST_SURE - 0.01, "")):
        unsure = replace(state, posture=np.array([sure, 1 - sure, 0, 0, 0, 0], np.float32))
        assert (unsure.name, unsure.likeliest, unsure.note()["posture"]) == (name, "standing", name)


def test_the_fit_finds_the_probabilities_of_the_model_that_drew_the_postures():
    rng = np.random.default_rng(0)
    features = np.column_stack([np.ones(6000), rng.normal(size=(6000, 2))])
    truth = PostureModel(rng.normal(size=(len(POSTURES), 3))).probabilities(features)
    drawn = (rng.random((6000, 1)) > truth.cumsum(axis=1)).sum(axis=1)
    assert np.abs(fitted(features, drawn).probabilities(features) - truth).mean() < 0.02


@pytest.mark.parametrize("seed", range(8))
def test_a_cut_leaves_one_side_of_a_border(seed):
    person = standing(120)[1][1]
    kept = cut(person, np.random.default_rng(seed))
    rows, columns = np.nonzero(kept)
    box = person[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    assert 0 < kept.sum() < person.sum() and kept.sum() == box.sum()
