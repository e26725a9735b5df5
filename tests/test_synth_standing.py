"""Standing: feet on the floor, weight over the feet, hands in their places, limbs clear of each other."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from synth.body.body import shipped_bodies
from synth.body.flesh import flesh_of
from synth.body.inverse import FootGoal, place_hand, plant
from synth.body.skeleton import JOINT_ID, Posture, forward
from synth.data_files import table
from synth.pose.standing import stand
from synth.pose.standing_parameters import draw_standing, stances
from tests.helpers.penetration import self_penetration_m

BODY = shipped_bodies()[4]


@cache
def people():
    """Ways of standing, and the bodies that stand so."""
    rng = np.random.default_rng(5)
    ways = [draw_standing(rng) for _ in range(60)]
    return [(how, stand(shipped_bodies()[i % 8], how)) for i, how in enumerate(ways)]


def test_everybody_stands_on_the_floor_with_the_pelvis_towards_the_front():
    for how, stood in people():
        assert abs(stood.vertices_m[:, 2].min()) < 0.006, how
        hips = stood.joints_m[JOINT_ID["left_hip"]] - stood.joints_m[JOINT_ID["right_hip"]]
        assert abs(np.degrees(np.arctan2(hips[1], hips[0]))) < 10, how


def test_both_feet_are_flat_where_nobody_lifts_a_heel():
    for how, stood in people():
        if how.stance in ("quiet", "astride", "on_one_leg"):
            ankles = [stood.joints_m[JOINT_ID[f"{side}_ankle"], 2] for side in ("left", "right")]
            assert abs(ankles[0] - ankles[1]) < 0.05, how


def test_ankles_of_quiet_people_are_as_far_apart_as_real_ones():
    rng = np.random.default_rng(0)
    apart = [how.legs["ankles"] for how in (draw_standing(rng) for _ in range(600)) if how.stance == "quiet"]
    assert 0.09 < np.median(apart) < 0.14 and min(apart) >= 0.03 and np.percentile(apart, 99) < 0.5


def test_limbs_keep_clear_of_each_other():
    bodies = [shipped_bodies()[i % 8] for i in range(20)]
    deep = [
        self_penetration_m(body, stood.vertices_m, stood.joints_m)
        for body, (_, stood) in zip(bodies, people()[:20], strict=True)
    ]
    assert np.median(deep) < 0.025 and max(deep) < 0.07


def test_heads_turn_by_themselves_and_both_legs_and_hands_take_turns():
    ways = [how for how, _ in people()]
    turns = np.abs([how.legs["turn"] for how in ways])
    assert turns.max() <= 60 and np.percentile(turns, 90) > 25
    assert 0.25 < np.mean([how.stands == "left" for how in ways]) < 0.75


def test_every_hand_and_stance_of_the_data_is_used():
    data = table("poses/standing")
    used = {hand for pairs in data["arms"].values() for pair in pairs for hand in pair.split("-")}
    assert used == set(data["hands"]) and {entry["arms"] for entry in stances().values()} == set(data["arms"])


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_foot_is_planted_and_a_hand_is_placed_where_they_are_wanted(side):
    flesh, sign = flesh_of(BODY), 1 if side == "left" else -1
    posture = Posture.zero()
    _, joints = forward(posture, flesh.rest_joints_m, flesh.aligned)
    hip, shoulder = joints[JOINT_ID[f"{side}_hip"]], joints[JOINT_ID[f"{side}_shoulder"]]
    foot = Rotation.from_euler("z", sign * 0.2).as_matrix()
    ankle = hip + np.array([sign * 0.05, -0.1, -0.7])
    posture, beyond = plant(posture, flesh, side, FootGoal(ankle, foot, 0.1))
    assert beyond == 0
    for hand in ((0.1, -0.3, 0.1), (0.02, -0.05, -0.5), (0.1, 0.15, -0.4), (0.2, -0.1, 0.4)):
        target = shoulder + np.array(hand) * (sign, 1, 1)
        posed = place_hand(posture, flesh, side, target, 0.3)
        frames, joints = forward(posed, flesh.rest_joints_m, flesh.aligned)
        assert np.linalg.norm(joints[JOINT_ID[f"{side}_wrist"]] - target) < 0.03
        assert np.linalg.norm(joints[JOINT_ID[f"{side}_ankle"]] - ankle) < 0.005
        np.testing.assert_allclose(frames[JOINT_ID[f"{side}_ankle"]], foot, atol=1e-3)
