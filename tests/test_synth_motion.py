"""Motion without a studio: limits, contacts and smoothness of every family of poses."""

from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth.body.body import shipped_bodies
from synth.body.flesh import flesh_of
from synth.body.skeleton import JOINT_ID, LIMITS_RAD, Posture, alignment, forward, reach
from synth.markers.performance import perform
from synth.pose.attitude import mirrored
from synth.pose.contact import height_to_rest, lift_needed
from synth.pose.moment import Family, glide
from synth.pose.recumbent import FALLEN, IN_BED, RECUMBENT, lie, lying_posture
from synth.pose.sitting import SITTING, sit, sitting_posture
from synth.pose.upright import UPRIGHT, rise, upright_posture
from synth.surface.furniture import FLOOR, Bed, Chair, Ground, Sofa

BODIES = shipped_bodies()
# What a contact begun late may leave between skin and floor.
FLOOR_M = 0.03


def seated(body, rng, activity):
    return sitting_posture(body, Sofa.sample(rng), SITTING.draw(activity, rng))


def laid(body, rng, activity):
    support = Ground() if activity in FALLEN else Bed.sample(rng)
    return lying_posture(body, support, RECUMBENT.draw(activity, rng))


def risen(body, rng, activity):
    return upright_posture(body, None, UPRIGHT.draw(activity, rng))


POSTURES = [
    *((seated, name) for name in SITTING.activities),
    *((laid, name) for name in RECUMBENT.activities),
    *((risen, name) for name in UPRIGHT.activities),
]


@pytest.mark.parametrize(("place", "activity"), POSTURES, ids=[name for _, name in POSTURES])
def test_every_activity_keeps_inside_the_joint_limits(place, activity):
    for seed in range(6):
        posture = place(BODIES[seed], np.random.default_rng(seed), activity)
        assert np.isfinite(posture.angles_rad).all()
        assert (posture.angles_rad[1:] >= LIMITS_RAD[1:, :, 0] - 1e-9).all()
        assert (posture.angles_rad[1:] <= LIMITS_RAD[1:, :, 1] + 1e-9).all()


@pytest.mark.parametrize("family", [SITTING, RECUMBENT, UPRIGHT], ids=["sitting", "recumbent", "upright"])
def test_a_family_names_only_fields_of_its_moment(family: Family):
    known = set(family.base)
    assert all(set(spreads) <= known for spreads in family.activities.values())
    moment = family.draw(next(iter(family.activities)), np.random.default_rng(0))
    assert set(vars(moment)) == known


def test_glide_starts_and_ends_at_its_ends_and_at_rest():
    rng = np.random.default_rng(1)
    start, end = SITTING.draw("reading", rng), SITTING.draw("slumping", rng)
    assert glide(start, end, 0.0) == start
    assert np.allclose(list(vars(glide(start, end, 1.0)).values()), list(vars(end).values()))
    near = glide(start, end, 1e-4)
    assert np.allclose(list(vars(near).values()), list(vars(start).values()), atol=1e-5)


def test_mirroring_twice_changes_nothing():
    left, right = IN_BED["lateral_left"], IN_BED["lateral_right"]
    assert mirrored(mirrored(left)) == left
    assert mirrored(left) == right
    assert right["roll"][0] == -left["roll"][0]


@pytest.mark.parametrize("seat", [Sofa(), Chair()], ids=["sofa", "chair"])
def test_a_sitter_touches_seat_and_back_rest_by_its_give(seat):
    for i, activity in enumerate(("resting", "reading", "arms_up")):
        body = BODIES[i]
        vertices, _ = sit(body, seat, SITTING.draw(activity, np.random.default_rng(i)))
        trunk = vertices[flesh_of(body).trunk]
        assert trunk[:, 2].min() == pytest.approx(seat.seat_height - seat.give_m, abs=8e-3)
        assert (seat.back_y(trunk[:, 2]) - trunk[:, 1]).min() >= -seat.give_m - 1e-3
        assert vertices[:, 2].min() > -FLOOR_M


def test_hands_reach_what_they_hold_and_feet_the_floor():
    misses, soles = [], []
    for seed in range(16):
        rng, body = np.random.default_rng(seed), BODIES[seed % 8]
        moment = SITTING.draw("gadget", rng)
        vertices, joints = sit(body, Sofa(), moment)
        hips = (joints[JOINT_ID["left_hip"]] + joints[JOINT_ID["right_hip"]]) / 2
        for side in ("left", "right"):
            hand = np.array([getattr(moment, f"{side}_hand_{k}") for k in "xyz"])
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
        vertices, _ = lie(body, bed, RECUMBENT.draw(activity, rng))
        trunk, carriers = vertices[flesh_of(body).trunk], [FLOOR, bed.solids()[0]]
        rise_left = height_to_rest(trunk, carriers)
        assert rise_left > -0.09
        # Over the mattress' edge flesh hangs down beside it: there only what is through its top counts.
        assert (lift_needed(trunk, carriers) if activity == "half_off_left" else rise_left) < 4e-3


def test_the_side_a_body_lies_on_is_the_side_its_name_says():
    for activity, lower in (("lateral_left", "left"), ("lateral_right", "right")):
        upper = "right" if lower == "left" else "left"
        _, joints = lie(BODIES[4], Bed(), RECUMBENT.draw(activity, np.random.default_rng(2)))
        assert joints[JOINT_ID[f"{lower}_shoulder"], 2] < joints[JOINT_ID[f"{upper}_shoulder"], 2] - 0.1
    _, supine = lie(BODIES[4], Bed(), RECUMBENT.draw("supine", np.random.default_rng(2)))
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
        assert vertices[vertices[:, 2] < sofa.seat_height, 1].max() < 1e-3


FILMS = [
    (SITTING, tuple(SITTING.activities), lambda body, moment: sitting_posture(body, Sofa(), moment)),
    (RECUMBENT, tuple(IN_BED), lambda body, moment: lying_posture(body, Bed(), moment)),
    (UPRIGHT, tuple(UPRIGHT.activities), lambda body, moment: upright_posture(body, None, moment)),
]


@pytest.mark.parametrize(("family", "activities", "place"), FILMS, ids=["sitting", "in_bed", "upright"])
def test_motion_is_smooth_at_thirty_frames_a_second(family, activities, place):
    body = BODIES[4]
    moments = islice(family.moments(np.random.default_rng(3), 30.0, activities), 240)
    film = list(perform((place(body, m) for m in moments), 30.0))
    assert len(film) == 240
    aligned = alignment(body.joints_m)
    joints = np.array([forward(p, body.joints_m, aligned)[1] for p in film])
    acceleration = np.linalg.norm(np.diff(joints, 2, axis=0), axis=-1) * 30**2
    # A hurried hand reaches 50 m/s^2; a limb that jumps by 20 cm from frame to frame would have 180.
    assert acceleration.max() < 80
    assert np.percentile(acceleration, 99) < 20
    assert all((p.angles_rad[1:] <= LIMITS_RAD[1:, :, 1] + 1e-9).all() for p in film)


def test_performing_keeps_a_still_posture_and_softens_a_jump():
    still = Posture(np.full((20, 3), 0.05), np.array([1.0, 2.0, 3.0]))
    other = Posture(np.full((20, 3), 0.15), np.array([2.0, 2.0, 3.0]))
    for n in (1, 3, 40):
        film = list(perform([still] * n, 30.0))
        assert len(film) == n
        assert all(np.allclose(p.angles_rad, still.angles_rad) for p in film)
    film = list(perform([still] * 20 + [other] * 20, 30.0))
    x = np.array([p.pelvis_m[0] for p in film])
    assert len(x) == 40 and x[0] == pytest.approx(1) and x[-1] == pytest.approx(2)
    assert (np.diff(x) >= -1e-12).all() and np.diff(x).max() < 0.2
    assert list(perform([], 30.0)) == []


@given(seed=st.integers(0, 10**6), side=st.sampled_from(["left", "right"]))
@settings(max_examples=40, deadline=None)
def test_an_arm_reaches_a_target_inside_its_limits(seed, side):
    """A target that an arm inside its limits has reached is reached again, unless the swivel forbids."""
    rng, body = np.random.default_rng(seed), BODIES[seed % 8]
    aligned = alignment(body.joints_m)
    angles = np.zeros((20, 3))
    angles[JOINT_ID[f"{side}_shoulder"]] = np.radians([rng.uniform(20, 80), rng.uniform(5, 25), 0])
    angles[JOINT_ID[f"{side}_elbow"], 0] = np.radians(rng.uniform(20, 90))
    wrist = JOINT_ID[f"{side}_wrist"]
    target = forward(Posture(angles, np.zeros(3)), body.joints_m, aligned)[1][wrist]
    again = reach(Posture.zero(), body.joints_m, aligned, side, target, np.radians(10))
    assert np.linalg.norm(forward(again, body.joints_m, aligned)[1][wrist] - target) < 0.03
