"""Motion without a studio: limits, contacts and smoothness of every family of poses."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth.body.body import shipped_bodies
from synth.body.flesh import flesh_of
from synth.body.inverse import reach
from synth.body.skeleton import JOINT_ID, LIMITS_RAD, Posture, forward
from synth.pose import postures
from synth.pose.pose_parameters import Behaviour, glide, mirrored
from synth.pose.postures import (
    FALLEN,
    IN_BED,
    SITTING,
    UPRIGHT,
    height_to_rest,
    in_bed,
    lie,
    lift_needed,
    on_legs,
    on_seat,
    rise,
    sit,
)
from synth.pose.settle import settle
from synth.surface.furniture import FLOOR, Bed, Chair, Ground, Sofa

BODIES = shipped_bodies()
# What a contact begun late may leave between skin and floor.
FLOOR_M = 0.03


def seated(rng, *activities):
    return on_seat(Sofa.sample(rng), *activities)


def bedded(rng, *activities):
    return replace(in_bed(Bed.sample(rng)), **({"activities": activities} if activities else {}))


def laid(rng, *activities):
    return Behaviour(FALLEN, activities, lambda body, moment: lie(body, Ground(), moment))


def risen(rng, *activities):
    return on_legs(None, *activities)


BEHAVIOURS = [
    (made, name)
    for made, family in ((seated, SITTING), (bedded, IN_BED), (laid, FALLEN), (risen, UPRIGHT))
    for name in family.activities
]


@pytest.mark.parametrize(("made", "activity"), BEHAVIOURS, ids=[name for _, name in BEHAVIOURS])
def test_every_activity_settles_inside_the_joint_limits(monkeypatch, made, activity):
    settled = []
    monkeypatch.setattr(postures, "settle", lambda *args: settled.append(settle(*args)) or settled[-1])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        behaviour = made(rng, activity)
        behaviour.pose(BODIES[seed], behaviour.draw(rng))
    angles = np.array([posture.angles_rad for posture in settled])
    assert len(angles) == 6 and np.isfinite(angles).all()
    assert (angles[:, 1:] >= LIMITS_RAD[1:, :, 0] - 1e-9).all()
    assert (angles[:, 1:] <= LIMITS_RAD[1:, :, 1] + 1e-9).all()


@pytest.mark.parametrize("seat", [Sofa(), Chair()], ids=["sofa", "chair"])
def test_a_sitter_touches_seat_and_back_rest_by_its_give(seat):
    for i, activity in enumerate(("resting", "reading", "arms_up")):
        body = BODIES[i]
        vertices, _ = sit(body, seat, SITTING.draw(activity, np.random.default_rng(i)))
        trunk = vertices[flesh_of(body).trunk]
        assert trunk[:, 2].min() == pytest.approx(seat.height - seat.give_m, abs=8e-3)
        assert (seat.back_y(trunk[:, 2]) - trunk[:, 1]).min() >= -seat.give_m - 1e-3
        assert vertices[:, 2].min() > -FLOOR_M


def test_families_name_numbers_of_their_base_and_glides_start_and_end_at_rest():
    for family in (SITTING, IN_BED, FALLEN, UPRIGHT):
        assert all(set(spreads) <= set(family.base) for spreads in family.activities.values())
    left, right = (IN_BED.activities[f"lateral_{side}"] for side in ("left", "right"))
    assert mirrored(left) == right and mirrored(right) == left and right["roll"][0] == -left["roll"][0]
    start, end = (SITTING.draw(name, np.random.default_rng(1)) for name in ("reading", "slumping"))
    for share, moment in ((0.0, start), (1e-4, start), (1.0, end)):
        assert np.allclose(list(glide(start, end, share).values()), list(moment.values()), atol=1e-5)


def test_hands_reach_what_they_hold_and_feet_the_floor():
    misses, soles = [], []
    for seed in range(16):
        rng, body = np.random.default_rng(seed), BODIES[seed % 8]
        moment = SITTING.draw("gadget", rng)
        vertices, joints = sit(body, Sofa(), moment)
        hips = (joints[JOINT_ID["left_hip"]] + joints[JOINT_ID["right_hip"]]) / 2
        for side in ("left", "right"):
            hand = np.array([moment[f"{side}_hand_{k}"] for k in "xyz"])
            wrist = joints[JOINT_ID[f"{side}_wrist"]] - hips
            misses.append(np.linalg.norm(wrist - hand * body.height_cm / 170))
        soles.append(vertices[:, 2].min())
    assert np.median(misses) < 0.03
    assert np.percentile(misses, 90) < 0.12
    assert np.median(np.abs(soles)) < 0.015


@pytest.mark.parametrize("activity", ["supine", "prone", "lateral_left", "foetal_right", "half_off_left"])
def test_a_trunk_lies_on_the_mattress_and_never_through_it(activity):
    for seed in range(4):
        rng, body = np.random.default_rng(seed), BODIES[seed]
        bed = Bed.sample(rng)
        vertices, _ = lie(body, bed, IN_BED.draw(activity, rng))
        trunk, carriers = vertices[flesh_of(body).trunk], [FLOOR, bed.solids()[0]]
        rise_left = height_to_rest(trunk, carriers)
        assert rise_left > -0.09
        # Over the mattress' edge flesh hangs down beside it: there only flesh through its top counts.
        assert (lift_needed(trunk, carriers) if activity == "half_off_left" else rise_left) < 4e-3


def test_the_side_a_body_lies_on_is_the_side_its_name_says():
    for activity, lower in (("lateral_left", "left"), ("lateral_right", "right")):
        upper = "right" if lower == "left" else "left"
        _, joints = lie(BODIES[4], Bed(), IN_BED.draw(activity, np.random.default_rng(2)))
        assert joints[JOINT_ID[f"{lower}_shoulder"], 2] < joints[JOINT_ID[f"{upper}_shoulder"], 2] - 0.1
    _, supine = lie(BODIES[4], Bed(), IN_BED.draw("supine", np.random.default_rng(2)))
    head, pelvis = supine[JOINT_ID["head"]], supine[JOINT_ID["pelvis"]]
    assert head[1] > pelvis[1] + 0.4
    assert supine[JOINT_ID["left_ankle"], 1] < pelvis[1] - 0.4


@given(seed=st.integers(0, 10**6), body=st.integers(0, 7), activity=st.sampled_from(list(UPRIGHT.activities)))
@settings(max_examples=25, deadline=None)
def test_the_upright_stand_on_the_floor(seed, body, activity):
    vertices, _ = rise(BODIES[body], None, UPRIGHT.draw(activity, np.random.default_rng(seed)))
    np.testing.assert_allclose(vertices[:, 2].min(), -FLOOR.give_m, atol=1e-4)


def test_getting_up_keeps_the_legs_before_the_seat():
    sofa = Sofa()
    for seed in range(5):
        moment = UPRIGHT.draw("getting_up", np.random.default_rng(seed))
        vertices, _ = rise(BODIES[seed], sofa, moment)
        assert vertices[vertices[:, 2] < sofa.height, 1].max() < 1e-3


@pytest.mark.parametrize("made", [seated, bedded, risen])
def test_motion_is_smooth_at_thirty_frames_a_second(made):
    behaviour = made(np.random.default_rng(5))
    moments = islice(behaviour.stream(np.random.default_rng(3), 30.0), 240)
    joints = np.array([behaviour.pose(BODIES[4], moment)[1] for moment in moments])
    acceleration = np.linalg.norm(np.diff(joints, 2, axis=0), axis=-1) * 30**2
    # Where a contact begins or ends a limb may jump; a glide that jumped would do so in every frame.
    assert np.median(acceleration) < 2
    assert np.percentile(acceleration, 90) < 40


@given(seed=st.integers(0, 10**6), side=st.sampled_from(["left", "right"]))
@settings(max_examples=40, deadline=None)
def test_an_arm_reaches_a_target_inside_its_limits(seed, side):
    """A target that an arm inside its limits has reached is reached again, unless the swivel forbids."""
    rng, body = np.random.default_rng(seed), BODIES[seed % 8]
    flesh = flesh_of(body)
    angles = np.zeros((20, 3))
    angles[JOINT_ID[f"{side}_shoulder"]] = np.radians([rng.uniform(20, 80), rng.uniform(5, 25), 0])
    angles[JOINT_ID[f"{side}_elbow"], 0] = np.radians(rng.uniform(20, 90))
    wrist = JOINT_ID[f"{side}_wrist"]
    target = forward(Posture(angles, np.zeros(3)), flesh.rest_joints_m, flesh.aligned)[1][wrist]
    again = reach(Posture.zero(), flesh, side, target, np.radians(10))
    assert np.linalg.norm(forward(again, flesh.rest_joints_m, flesh.aligned)[1][wrist] - target) < 0.03
