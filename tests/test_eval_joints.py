"""Joints from parts: right on figures whose joints are known, the same in a mirror, silent where none is."""

import json

import numpy as np
import pytest

from annotate.crop import network_crop
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import N_CLASSES, PART_ID, PARTS, swap_left_right
from eval.scores.joint_errors import OBSERVED, joint_errors_mm, observe, summary
from eval.scores.joints import (
    HINGE,
    HINGES,
    IN_SKELETON,
    JOINT,
    JOINT_NAMES,
    JUMP_MM,
    N_JOINTS,
    STEPS,
    Evidence,
    _median,
    crossings,
    joint_evidence,
)
from eval.scores.skeleton_fit import BONES, fit_skeletons
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics, rays
from synth.body import skeleton

SMALL = Intrinsics(161, 141, 140.0, 140.0, 80.0, 70.0)
"""Principal point in the middle: its mirror image is its own."""

STANDING = {
    "head": (0, -640, 0), "neck": (0, -530, 0), "pelvis": (0, -10, 0),
    "left_shoulder": (170, -450, 0), "left_elbow": (330, -250, 0), "left_wrist": (480, -80, 0),
    "left_hip": (103, 0, 0), "left_knee": (120, 380, 0), "left_ankle": (130, 800, 0),
}  # fmt: skip
"""A person who faces the camera, millimetres about the pelvis; the right side mirrors the left."""

CAPSULES = (
    ("torso", "neck", "pelvis", 105), ("hip", "left_hip", "right_hip", 95), ("head", "neck", "head", 75),
    *((f"{side}_{part}", f"{side}_{a}", f"{side}_{b}", radius)
      for side in ("left", "right")
      for part, a, b, radius in (
          ("upper_arm", "shoulder", "elbow", 45), ("forearm", "elbow", "wrist", 38),
          ("upper_leg", "hip", "knee", 70), ("lower_leg", "knee", "ankle", 50))),
)  # fmt: skip


def figure(middle_mm=(0, 0, 2500), turn_deg=0.0) -> np.ndarray:
    """True joints (15, 3) of the standing figure, turned about the vertical."""
    places = dict(STANDING)
    for name, (x, y, z) in STANDING.items():
        if name.startswith("left"):
            places[name.replace("left", "right")] = (-x, y, z)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return np.array([places[name] for name in JOINT_NAMES], float) @ turn.T + middle_mm


def seen(joints: np.ndarray, camera=SMALL, without=()) -> tuple[np.ndarray, np.ndarray]:
    """Parts and depth of the figure's capsules, each a row of spheres met by every pixel's ray."""
    directions = rays(camera)
    square = np.square(directions).sum(-1)
    depth, parts = np.full(camera.shape, np.inf), np.zeros(camera.shape, np.uint8)
    for part, a, b, radius in CAPSULES:
        if part in without:
            continue
        for share in np.linspace(0, 1, 25):
            centre = (1 - share) * joints[JOINT[a]] + share * joints[JOINT[b]]
            along = directions @ centre
            inside = along**2 - square * (centre @ centre - radius**2)
            z = (along - np.sqrt(np.maximum(inside, 0))) / square
            nearer = (inside > 0) & (z < depth)
            depth[nearer], parts[nearer] = z[nearer], PART_ID[part]
    return parts, np.where(parts > 0, np.rint(np.where(parts > 0, depth, 0)), 0).astype(np.uint16)


def frame(joints: np.ndarray, **kwargs) -> FrameLabels:
    parts, depth = seen(joints, **kwargs)
    everywhere = np.zeros((skeleton.N_JOINTS, 3))
    everywhere[IN_SKELETON] = joints
    return FrameLabels("f", depth, parts, subject="s", notes={"joints_mm": everywhere.tolist()})


def found(*frames: FrameLabels, persons=None) -> np.ndarray:
    evidence = [joint_evidence(f.parts, f.depth_mm, SMALL) for f in frames]
    return fit_skeletons(together(*evidence), persons or ["s"] * len(frames))


def together(*evidence: Evidence) -> Evidence:
    return np.array(evidence)


@pytest.mark.parametrize("turn_deg", [-40, 0, 25])
def test_the_joints_of_a_figure_of_capsules_are_found(turn_deg):
    joints = figure(turn_deg=turn_deg)
    off = np.linalg.norm(found(frame(joints))[0] - joints, axis=1)
    assert off.mean() < 40, dict(zip(JOINT_NAMES, off.round(), strict=True))
    assert off.max() < 90, dict(zip(JOINT_NAMES, off.round(), strict=True))


def test_crossings_agree_with_a_slow_reference():
    """Midpoints of neighbours of a hinge's two parts that touch, in the order of steps, then of pixels."""
    rng = np.random.default_rng(4)
    labels = rng.integers(0, N_CLASSES, (9, 8)).astype(np.uint8)
    depth = rng.integers(1000, 1100, (9, 8)).astype(np.uint16)
    x_z, y_z = rng.uniform(-1, 1, 8), rng.uniform(-1, 1, 9)
    points = np.stack([x_z * depth, y_z[:, None] * depth, depth], axis=-1)
    expected = {i: [] for i in range(len(HINGES))}
    for dv, du in STEPS:
        for v, u in np.ndindex(labels.shape):
            if not (v + dv < 9 and 0 <= u + du < 8):
                continue
            if abs(points[v, u, 2] - points[v + dv, u + du, 2]) >= JUMP_MM:
                continue
            names = {PARTS[labels[v, u]].name, PARTS[labels[v + dv, u + du]].name}
            for i, hinge in enumerate(HINGES):
                if names == set(hinge.parts):
                    expected[i].append((points[v, u] + points[v + dv, u + du]) / 2)
    which, middles = crossings(labels, depth, x_z, y_z, HINGE, np.array(STEPS))
    assert len(which) == sum(map(len, expected.values())) > 30
    for i, points_of in expected.items():
        np.testing.assert_array_equal(middles[which == i], np.reshape(points_of, (-1, 3)))


def test_a_border_on_a_wall_is_found_where_it_is():
    """Head above torso on a plane square to the view: the border's middle in closed form."""
    parts = np.zeros(SMALL.shape, np.uint8)
    parts[40:60, 50:91], parts[60:90, 50:91] = PART_ID["head"], PART_ID["torso"]
    borders = joint_evidence(parts, np.full(SMALL.shape, 2000, np.uint16), SMALL)["borders"]
    neck = [hinge.joint for hinge in HINGES].index("neck")
    np.testing.assert_allclose(
        borders[neck], [(70 - 80) / 140 * 2000, (59.5 - 70) / 140 * 2000, 2000], atol=3
    )
    assert np.isnan(np.delete(borders, neck, axis=0)).all()


def test_a_mirror_exchanges_left_and_right_and_nothing_else():
    there = frame(figure(turn_deg=20))
    mirrored = FrameLabels("m", there.depth_mm[:, ::-1].copy(), swap_left_right(there.parts[:, ::-1].copy()))
    twin = [JOINT[n.replace("left", "L").replace("right", "left").replace("L", "right")] for n in JOINT_NAMES]
    expected = found(there)[0][twin] * (-1, 1, 1)
    np.testing.assert_allclose(found(mirrored)[0], expected, atol=1e-6)


def test_what_parts_do_not_show_is_not_made_up():
    joints = figure()
    whole, without = found(frame(joints)), found(frame(joints, without=("left_forearm", "right_lower_leg")))
    assert np.isfinite(whole).all()
    missing = {name for name in JOINT_NAMES if np.isnan(without[0, JOINT[name]]).any()}
    assert missing == {"left_wrist", "right_ankle"}
    np.testing.assert_allclose(without[0, JOINT["right_wrist"]], whole[0, JOINT["right_wrist"]], atol=25)


def test_a_limb_cut_by_an_occluder_keeps_its_joint():
    """Knees hidden behind a bar: the parts' ends stand in for the borders."""
    joints = figure()
    there = frame(joints)
    depth = there.depth_mm.copy()
    row = round(70 + 380 / 2500 * 140)
    depth[row - 4 : row + 5] = 0
    hidden = FrameLabels("f", depth, there.parts)
    evidence = joint_evidence(hidden.parts, hidden.depth_mm, SMALL)
    knees = [i for i, hinge in enumerate(HINGES) if hinge.joint.endswith("knee")]
    assert not evidence["direct"][knees].any()
    off = np.linalg.norm(fit_skeletons(together(evidence), ["s"])[0] - joints, axis=1)
    assert off[[JOINT["left_knee"], JOINT["right_knee"]]].max() < 60


def test_many_frames_are_fitted_as_few_are(monkeypatch):
    """Block by block, to the bit."""
    frames = [frame(figure((30 * i, 20, 2500 + 40 * i))) for i in range(5)]
    persons = ["a", "b", "a", "a", "b"]
    whole = found(*frames, persons=persons)
    monkeypatch.setattr("eval.scores.counts.BLOCK", 2)
    np.testing.assert_array_equal(found(*frames, persons=persons), whole)


def test_nobody_has_no_joints():
    nothing = FrameLabels("f", np.full(SMALL.shape, 2000, np.uint16), np.zeros(SMALL.shape, np.uint8))
    undefined = FrameLabels("g", nothing.depth_mm, np.full(SMALL.shape, 255, np.uint8))
    assert np.isnan(found(nothing, undefined)).all()
    none = np.zeros(0, OBSERVED)["evidence"]
    assert fit_skeletons(none, []).shape == (0, N_JOINTS, 3)


def test_frames_of_a_person_share_their_bones():
    """Lengths vary less when the frames are known to show one person, and left and right agree."""
    frames = [frame(figure((0, 0, 2300), turn)) for turn in (-50, -20, 15, 45)]

    a, b = np.array([(JOINT[a], JOINT[b]) for a, b, _ in BONES]).T

    def lengths(joints):
        return np.linalg.norm(joints[:, a] - joints[:, b], axis=-1)

    one = lengths(found(*frames)).std(axis=0).mean()
    each = lengths(found(*frames, persons=list("abcd"))).std(axis=0).mean()
    assert one < each


def test_a_part_in_a_wrong_place_hardly_moves_the_others():
    joints = figure()
    there = frame(joints)
    parts = there.parts.copy()
    # Half of the left lower leg is called right forearm.
    leg = np.argwhere(parts == PART_ID["left_lower_leg"])
    parts[tuple(leg[len(leg) // 2 :].T)] = PART_ID["right_forearm"]
    spoilt = FrameLabels("f", there.depth_mm, parts)
    off = np.linalg.norm(found(spoilt)[0] - joints, axis=1)
    assert np.delete(off, [JOINT[n] for n in ("left_ankle", "right_wrist", "right_elbow")]).max() < 90


def test_a_crop_gives_the_joints_of_the_whole_image():
    whole = frame(figure((60, 40, 2600)))
    crop = network_crop(whole.parts > 0)
    small = FrameLabels(
        "f", crop.cut(whole.depth_mm, 0), crop.cut(whole.parts, 0),
        notes=whole.notes | {"crop": [crop.top, crop.left, crop.side]},
    )  # fmt: skip
    both = np.array([observe(f, f, SMALL) for f in (whole, small)])
    np.testing.assert_array_equal(*both["inside"])
    joints = fit_skeletons(both["evidence"], ["a", "b"])
    assert np.linalg.norm(joints[0] - joints[1], axis=1).max() < 12


def test_errors_are_distances_and_what_is_not_scored_is_told_from_what_is_missed():
    joints = figure()
    there = frame(joints)
    exact = found(there)[0]
    moved = exact + np.array([30.0, 0, 40])
    moved[JOINT["head"]] = (0, -5000, 2000)  # above the image
    truth = frame(moved)
    truth = FrameLabels("f", there.depth_mm, there.parts, notes=truth.notes)
    nobody = FrameLabels("f", there.depth_mm, np.zeros_like(there.parts))
    without = FrameLabels("f", there.depth_mm, there.parts)
    observations = [
        observe(there, truth, SMALL),
        observe(nobody, truth, SMALL),
        observe(there, without, SMALL),
    ]
    errors = joint_errors_mm(np.array(observations), ["s"] * 3)
    head = np.arange(N_JOINTS) == JOINT["head"]
    assert errors.shape == (3, N_JOINTS)
    assert np.isnan(errors[:, head]).all()
    np.testing.assert_allclose(errors[0, ~head], 50, atol=1e-6)
    assert np.isposinf(errors[1, ~head]).all()
    assert np.isnan(errors[2]).all()


def test_the_summary_counts_what_was_missed():
    errors = np.full((2, N_JOINTS), np.nan)
    errors[0, :4] = 40, 90, 140, np.inf
    result = summary(errors)
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert (result["frames"], result["scored"], result["found"], result["mpjpe_mm"]) == (1, 4, 3, 90)
    assert [result[f"pck_{d}mm"] for d in (50, 100, 150)] == [0.25, 0.5, 0.75]
    assert result["by_joint"]["head"]["mpjpe_mm"] == 40
    assert result["by_joint"]["left_ankle"]["pck_100mm"] is None
    assert summary(np.empty((0, N_JOINTS)))["mpjpe_mm"] is None


@pytest.mark.parametrize(
    "notes",
    [
        {"joints_mm": "many"},
        {"joints_mm": [[1, 2, 3]]},
        {"joints_mm": [[0, 0, float("nan")]] * skeleton.N_JOINTS},
        {"joints_mm": [[0, 0, 1e9]] * skeleton.N_JOINTS},
        {"joints_mm": [[0, 0, 2000]] * skeleton.N_JOINTS, "crop": [1, 2]},
        {"joints_mm": [[0, 0, 2000]] * skeleton.N_JOINTS, "crop": [0, 0, 0]},
    ],
)
def test_malformed_notes_are_refused(notes):
    there = frame(figure())
    with pytest.raises(FormatError, match="malformed"):
        observe(there, FrameLabels("f", there.depth_mm, there.parts, notes=notes), SMALL)


def test_on_the_rig_true_parts_give_the_true_joints(rig_session):
    truth = LabelSet.open(rig_session.with_suffix(".truth"))
    observed = np.array([observe(f, f, truth.intrinsics) for f in truth])
    errors = joint_errors_mm(observed, [f.subject for f in truth])
    assert summary(errors)["pck_100mm"] > 0.85
    assert summary(errors)["mpjpe_mm"] < 60


@pytest.mark.parametrize("count", [1, 2, 3, 8, 101])
def test_the_median_is_numpys(count):
    points = np.random.default_rng(count).normal(0, 1000, (count, 3))
    np.testing.assert_array_equal(_median(points), np.median(points, axis=0))
