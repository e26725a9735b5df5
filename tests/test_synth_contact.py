"""Contact: the measure of penetration on shapes known in closed form, and the correction against it."""

import numpy as np
import pytest

from annotate.parts import PART_ID
from synth.body.body import blend, pose, shipped_bodies
from synth.body.crowd import suit_wearers
from synth.body.flesh import CHAINS, N_STATIONS, flesh_of
from synth.body.skeleton import JOINT_ID, LIMITS_RAD, Posture, clamp, forward, kinematics
from synth.data_files import CASTS
from synth.pose.halfspaces import ROW_CAPACITY, add_flesh, no_rows, pairs_of
from synth.pose.postures import height_to_rest, lie, lift_needed, poses_of, rise, sit
from synth.pose.settle import RULES, Pull, settle, sink, stations_m
from synth.surface.furniture import FLOOR, Ground, Solid, Surface
from synth.surface.judge_furniture import draw_bed, draw_chair, draw_sofa
from tests.helpers.penetration import furniture_penetration_m, penetrations_m, self_penetration_m

BODY = shipped_bodies()[4]


def posture(**degrees) -> Posture:
    angles = np.zeros((20, 3))
    for joint, triple in degrees.items():
        angles[JOINT_ID[joint]] = np.radians(triple)
    return Posture(clamp(angles), np.array([0.0, 0.0, 0.9]))


HAND_IN_BELLY = posture(right_shoulder=(0, 45, 0), left_shoulder=(18, -20, -60), left_elbow=(80, 0, 0))


def test_the_measure_sees_a_hand_in_the_belly_and_names_the_parts():
    standing = pose(BODY, posture(left_shoulder=(0, 20, 0), right_shoulder=(0, 20, 0)))
    assert self_penetration_m(BODY, *standing) < 1e-3
    found = penetrations_m(BODY, *pose(BODY, HAND_IN_BELLY))
    trunk = {PART_ID["torso"], PART_ID["hip"]}
    deepest = max(found, key=lambda pair: found[pair])
    assert found[deepest] > 0.03 and PART_ID["left_forearm"] in deepest and trunk & set(deepest)


def test_depth_is_the_distance_to_the_skin():
    """A forearm moved as a whole into the belly is about as deep as it was moved."""
    vertices, joints = pose(BODY, posture(left_shoulder=(0, 20, 0), right_shoulder=(0, 45, 0)))
    hand = np.unique(BODY.faces[BODY.face_parts == PART_ID["right_forearm"]])
    torso = np.unique(BODY.faces[BODY.face_parts == PART_ID["torso"]])
    tip = vertices[hand[vertices[hand, 2].argmin()]]
    front = vertices[torso][np.abs(vertices[torso, 0] - 0.0) < 0.03]
    belly = front[np.argmin(np.abs(front[:, 2] - 1.12) + 10 * (front[:, 1] > 0))]
    moved = vertices.copy()
    for depth in (0.01, 0.02, 0.03):
        moved[hand] = vertices[hand] + (belly - tip) + np.float32([0, depth, 0.0])
        found = penetrations_m(BODY, moved, joints)
        deep = found.get((PART_ID["right_forearm"], PART_ID["torso"]), 0.0)
        assert 0.5 * depth < deep < depth + 0.08


@pytest.mark.parametrize("index", range(8))
def test_flesh_follows_the_skin(index):
    """Stations lie inside the body and their spheres reach the skin about them."""
    body = shipped_bodies()[index]
    flesh = flesh_of(body)
    assert flesh.centres_m.shape == (N_STATIONS, 3)
    distance = np.linalg.norm(body.vertices_m[None] - flesh.centres_m[:, None], axis=-1).min(axis=1)
    limbs = [
        s
        for name, c in CHAINS.items()
        if name.endswith(("arm", "thigh", "shank"))
        for s in range(c.start, c.stop)
    ]
    assert (flesh.radii_m > 0.01).all() and (flesh.radii_m < 0.2).all()
    assert (np.abs(distance - flesh.radii_m)[limbs] < 0.04).all()
    left, right = CHAINS["left_thigh"], CHAINS["right_thigh"]
    mirrored = flesh.centres_m[right] * (-1, 1, 1)
    assert np.allclose(flesh.centres_m[left], mirrored, atol=5e-3)


def deepest_overlap(asked: Posture) -> float:
    flesh = flesh_of(BODY)
    _, frames, joints = kinematics(asked.angles_rad, asked.pelvis_m, flesh.rest_joints_m, flesh.aligned)
    rows = no_rows()
    n = add_flesh(rows, 0, pairs_of(RULES.pairs, flesh), flesh, stations_m(flesh, frames, joints))
    assert n < ROW_CAPACITY
    return float(rows.depths_m[:n].max(initial=0.0))


def test_settling_clears_what_overlaps_and_moves_nothing_else():
    assert deepest_overlap(HAND_IN_BELLY) > 0.03
    settled = settle(flesh_of(BODY), HAND_IN_BELLY, [], [])
    assert deepest_overlap(settled) < 0.004
    changed = np.abs(settled.angles_rad - HAND_IN_BELLY.angles_rad).max(axis=1) > 1e-6
    arm = {JOINT_ID[f"left_{k}"] for k in ("clavicle", "shoulder", "elbow", "wrist")}
    assert set(np.flatnonzero(changed)) <= arm
    again = settle(flesh_of(BODY), settled, [], [])
    assert np.allclose(again.angles_rad, settled.angles_rad, atol=0.02)
    nudged = Posture(HAND_IN_BELLY.angles_rad + 1e-4, HAND_IN_BELLY.pelvis_m)
    assert np.abs(settle(flesh_of(BODY), nudged, [], []).angles_rad - settled.angles_rad).max() < 5e-3
    clear = posture(left_shoulder=(40, 42, 0), right_shoulder=(10, 40, 0), left_hip=(20, 10, 0))
    assert np.array_equal(settle(flesh_of(BODY), clear, [], []).angles_rad, clear.angles_rad)


def test_a_pulled_hand_arrives_and_a_sinking_one_is_carried():
    flesh, standing = flesh_of(BODY), posture(left_shoulder=(40, 30, 0), left_elbow=(40, 0, 0))
    wrist = JOINT_ID["left_wrist"]
    joints = forward(standing, flesh.rest_joints_m, flesh.aligned)[1]
    target = joints[wrist] + (0.05, -0.04, 0.08)
    pulled = settle(flesh, standing, [], [Pull("left_wrist", target, np.full(3, 0.5))])
    assert np.linalg.norm(forward(pulled, flesh.rest_joints_m, flesh.aligned)[1][wrist] - target) < 0.03
    x, y, z = joints[wrist]
    table = Solid((x - 0.3, y - 0.3, 0.0), (x + 0.3, y + 0.3, z - 0.08), 0.0, Surface.TABLE, carries_m=0.5)
    carried = settle(flesh, standing, [table], [sink("left_wrist", 0.6)])
    height = forward(carried, flesh.rest_joints_m, flesh.aligned)[1][wrist, 2] - table.high[2]
    assert 0.01 < height < 0.06


def test_settled_angles_keep_inside_their_limits_whatever_is_asked():
    rng = np.random.default_rng(0)
    for _ in range(10):
        wild = Posture(rng.normal(0, 2, (20, 3)), np.array([0, 0, 0.4]))
        settled = settle(flesh_of(BODY), wild, [FLOOR], [sink("left_ankle", 1.0)], heave=0.1)
        assert (settled.angles_rad[1:] >= LIMITS_RAD[1:, :, 0] - 1e-9).all()
        assert (settled.angles_rad[1:] <= LIMITS_RAD[1:, :, 1] + 1e-9).all()


def test_rest_and_lift_on_a_table_in_closed_form():
    table = Solid((-1, -1, 0), (1, 1, 0.5), 0.04, Surface.TABLE)
    points = np.float32([[0, 0, 2.0], [0.5, 0, 2.3], [5, 5, 1.0]])
    assert height_to_rest(points, [FLOOR, table]) == pytest.approx(-0.005 - 1.0)
    assert height_to_rest(points[:2], [FLOOR, table]) == pytest.approx(0.46 - 2.0)
    sunk = np.float32([[0, 0, 0.43], [0.995, 0, 0.2]])
    assert lift_needed(sunk, [table]) == pytest.approx(0.03, abs=1e-6)
    assert furniture_penetration_m(sunk, [table]) == pytest.approx(0.03, abs=1e-6)
    assert furniture_penetration_m(np.float32([[0, 0, 0.47]]), [table]) == 0.0


def sampled(cast, name, body, rng):
    """Solids, vertices and joints of a pose of a cast's family on its furniture."""
    family = getattr(poses_of(cast), name)
    moment = family.draw(str(rng.choice(list(family.activities))), rng)
    if name == "sitting":
        seat = (draw_sofa if rng.random() < 0.8 else draw_chair)(cast, rng)
        return seat.solids(), *sit(body, seat, moment)
    if name == "upright":
        seat = draw_sofa(cast, rng) if rng.random() < 0.3 else None
        return seat.solids() if seat else [], *rise(body, seat, moment)
    support = draw_bed(cast, rng) if name == "in_bed" else Ground()
    return support.solids(), *lie(body, support, moment)


@pytest.mark.parametrize("cast", CASTS)
@pytest.mark.parametrize("family", ["sitting", "in_bed", "fallen", "upright"])
def test_penetration_of_sampled_poses(cast, family):
    own, furniture, bodies = [], [], suit_wearers(cast)
    for i in range(14):
        rng = np.random.default_rng((17, i))
        one, other = rng.choice(len(bodies), 2, replace=False)
        body = blend(bodies[one], bodies[other], float(rng.random()) / 2)
        solids, vertices, joints = sampled(cast, family, body, rng)
        own.append(self_penetration_m(body, vertices, joints))
        furniture.append(furniture_penetration_m(vertices, [FLOOR, *solids]))
    assert np.median(own) < 0.005 and max(own) < 0.045
    assert np.median(furniture) < 0.0075 and max(furniture) < 0.045
