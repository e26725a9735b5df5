"""Errors and visibility of a network's joints: closed forms, a naive twin, intervals and differences."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from eval.compare.compare import compare_sets
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import predict_frames
from eval.network.predict_source import predict_source
from eval.scores.joint_errors import joint_errors_mm, joint_visibility
from eval.scores.joint_scores import GROUPS, INSIDE, SCORES, JointErrors, joint_difference
from eval.scores.joint_visibility import HIDDEN, OUTSIDE, REACH_MM, VISIBILITIES, VISIBLE
from eval.scores.joints import BONES, IN_SKELETON, JOINT, JOINT_NAMES, N_JOINTS, TWIN
from eval.scores.traits import traits_of
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from sensors.session.reader import Session
from synth.body import skeleton
from synth.images.presets import PRESETS, sample
from tests.helpers import naive_joints
from tests.helpers.shards import write_dataset

CAMERA = Intrinsics(161, 141, 140.0, 130.0, 80.0, 70.0)
PARTS = np.zeros(CAMERA.shape, np.uint8)


def truth_of(joints_mm: np.ndarray, depth_mm: np.ndarray = PARTS) -> FrameLabels:
    everywhere = np.full((skeleton.N_JOINTS, 3), 1000.0)
    everywhere[IN_SKELETON] = joints_mm
    return FrameLabels("f", depth_mm.astype(np.uint16), PARTS, notes={"joints_mm": everywhere.tolist()})


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
    found = JointErrors(errors[None], np.full((1, N_JOINTS), HIDDEN, np.uint8), ("a",)).to_json()
    assert (found["frames"], found["joints"], found["mpjpe_mm"]) == (1, 15, pytest.approx(31.5))
    assert found["pck_50mm"] == pytest.approx(12 / 15) and found["by_joint"][JOINT_NAMES[14]]["pck_50mm"] == 0
    assert found["hidden"]["joints"] == 15 and found["visible"]["mpjpe_mm"] is None


@pytest.mark.parametrize(
    "note", [{}, {"bearing": 3}, {"bearing": {"joints_px": [[1, 2, 3]]}}, {"bearing": {"joints_px": "x"}}]
)
def test_joints_that_the_network_did_not_give_are_missed(joints, note):
    errors = joint_errors_mm(replace(predicted_of(joints), notes=note), truth_of(joints), CAMERA)
    assert np.isinf(errors).all()
    both = np.stack([np.full(N_JOINTS, 10.0), errors])
    found = JointErrors(both, np.full(both.shape, VISIBLE, np.uint8), ("a", "b")).to_json()
    assert (found["missed"], found["mpjpe_mm"], found["pck_100mm"]) == (15, 10.0, 0.5)
    assert found["frames_without_joints"] == 1


def test_without_true_joints_nothing_is_scored(joints):
    assert np.isnan(joint_errors_mm(predicted_of(joints), predicted_of(joints), CAMERA)).all()


@pytest.mark.parametrize("note", [[], "x", [[0, 0, np.inf]] * skeleton.N_JOINTS])
def test_malformed_true_joints_are_named(joints, note):
    truth = replace(truth_of(joints), notes={"joints_mm": note})
    with pytest.raises(FormatError, match=r"frame f: field notes\.joints_mm is malformed"):
        joint_errors_mm(predicted_of(joints), truth, CAMERA)


def test_a_joint_in_a_sphere_in_front_of_a_plane_is_visible_to_the_depth_of_its_body():
    """Closed form: rays meet the sphere where a quadratic equation has its nearer root."""
    radius, centre_mm, plane_mm = 200.0, 2000.0, 3000.0
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    a, b, c = x**2 + y**2 + 1, centre_mm, centre_mm**2 - radius**2
    hit = b**2 - a * c
    depth = np.rint(np.where(hit > 0, (b - np.sqrt(np.maximum(hit, 0))) / a, plane_mm))
    depth[0, 0] = 0
    name = "left_wrist"
    for behind_mm, seen in ((-61, HIDDEN), (-59, VISIBLE), (0, VISIBLE), (69, VISIBLE), (71, HIDDEN)):
        place = np.tile((0.0, 0.0, centre_mm - radius + behind_mm), (N_JOINTS, 1))
        assert joint_visibility(truth_of(place, depth), CAMERA)[JOINT[name]] == seen, behind_mm
    assert REACH_MM["wrist"] == 70
    places = np.tile((0.0, 0.0, centre_mm), (N_JOINTS, 1))
    places[JOINT["head"]] = (0, 0, plane_mm)  # behind the sphere
    places[JOINT["neck"]] = (1000, 0, plane_mm)  # beside the sphere, on the plane
    places[JOINT["left_wrist"]] = (
        -CAMERA.cx / CAMERA.fx * 2000,
        -CAMERA.cy / CAMERA.fy * 2000,
        2000,
    )  # no reading
    places[JOINT["left_knee"]] = (2000, 0, 2000)
    places[JOINT["left_ankle"]] = (0, 0, -2000)
    seen = joint_visibility(truth_of(places, depth), CAMERA)
    expected = {
        "head": HIDDEN,
        "neck": VISIBLE,
        "left_wrist": HIDDEN,
        "left_knee": OUTSIDE,
        "left_ankle": OUTSIDE,
    }
    expected |= {"left_hip": VISIBLE, "pelvis": VISIBLE, "right_shoulder": VISIBLE, "right_elbow": HIDDEN}
    assert {name: seen[JOINT[name]] for name in expected} == expected


def assert_same(found: JointErrors, twin: dict[str, dict[str, float]]) -> None:
    assert set(twin) >= {"inside", "visible", "hidden"}
    for group, scores in twin.items():
        row = found.estimates.to_json(group)
        assert (row["joints"], row["missed"]) == (scores["joints"], scores["missed"]), group
        np.testing.assert_allclose(row["mpjpe_mm"] or np.nan, scores["mpjpe_mm"], atol=0.1, err_msg=group)
        for mm in (50, 100, 150):
            assert row[f"pck_{mm}mm"] == pytest.approx(scores[f"pck_{mm}mm"]), group


def test_a_naive_twin_gives_the_same_scores_of_random_joints():
    rng = np.random.default_rng(1)
    errors, seen, twin = [], [], []
    for i in range(40):
        joints = rng.uniform((-1500, -1500, 1500), (1500, 1500, 2600), (N_JOINTS, 3)).round(1)
        truth = truth_of(joints, rng.integers(0, 2, CAMERA.shape) * rng.integers(1300, 2700, CAMERA.shape))
        predicted = predicted_of(joints + rng.normal(0, 60, joints.shape))
        if i % 10 == 0:
            predicted = replace(predicted, notes={})
        errors.append(joint_errors_mm(predicted, truth, CAMERA))
        seen.append(joint_visibility(truth, CAMERA))
        twin += naive_joints.joints_of(predicted, truth, CAMERA)
    found = JointErrors(np.array(errors), np.array(seen), tuple(map(str, range(40))))
    assert_same(found, naive_joints.scores_of(twin))


def test_a_naive_twin_gives_the_same_scores_of_a_network_on_images(tmp_path):
    frames = [sample(PRESETS["people"], 7, 24 * i + 5) for i in range(6)]
    truth = write_dataset(tmp_path / "truth", frames)
    predicted = predict_frames(truth, OnnxNetwork(), tmp_path / "p", lambda n: None).labels
    assert_twin(predicted, truth)
    traits = compare_sets(predicted, truth).traits
    for frame, own in zip(frames, traits, strict=True):
        assert (own.posture, own.sensor) == (frame.notes["posture"] or "", frame.notes["sensor"]["kind"])
    assert {own.facing for own in traits} <= {"from the front", "from the side", "from behind"}


@pytest.mark.parametrize(
    ("turned_deg", "facing"), [(0, "from the front"), (90, "from the side"), (200, "from behind")]
)
def test_a_facing_is_of_the_camera_about_the_chest(turned_deg, facing):
    joints = np.zeros((N_JOINTS, 3))
    for name, (across, up) in {"neck": (0, 500), "pelvis": (0, 0)}.items():
        joints[JOINT[name]] = (across, -up, 0)
    for side, sign in (("left", 1), ("right", -1)):
        joints[JOINT[f"{side}_shoulder"]] = (sign * 200, -500, 0)
        joints[JOINT[f"{side}_hip"]] = (sign * 100, 0, 0)
    c, s = np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))
    joints = joints @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) + (0, 0, 2000)
    frame = truth_of(joints)
    assert traits_of(frame, frame, CAMERA).facing == facing


def test_a_naive_twin_gives_the_same_scores_of_a_network_on_a_recording(tmp_path, rig_session):
    truth = LabelSet.open(rig_session.with_suffix(".truth"))
    predicted = predict_source(Session(rig_session), OnnxNetwork(), tmp_path / "p", lambda n: None).labels
    assert_twin(predicted, truth)


def assert_twin(predicted: LabelSet, truth: Iterable[FrameLabels]) -> None:
    found, twin = compare_sets(predicted, truth).joints, []
    own = {frame.frame_id: frame for frame in predicted}
    for frame in truth:
        camera = getattr(truth, "whole_image", None) if "crop" not in frame.notes else None
        arguments = (camera,) if camera else ()
        twin += naive_joints.joints_of(own[frame.frame_id], frame, *arguments)
    assert_same(found, naive_joints.scores_of(twin))


def errors_of(rng: np.random.Generator, people: int, frames: int, offset_mm: float = 0.0) -> JointErrors:
    """Errors of people whose means differ."""
    own = rng.uniform(30, 90, (people, 1, 1)) + offset_mm
    errors = rng.gamma(4.0, own / 4, (people, frames, N_JOINTS)).reshape(-1, N_JOINTS)
    seen = rng.integers(0, len(VISIBILITIES), errors.shape).astype(np.uint8)
    return JointErrors(errors, seen, tuple(f"s{i // frames}" for i in range(len(errors))))


def test_intervals_of_joints_hold_the_truth_and_are_of_people():
    held = dict.fromkeys(SCORES, 0)
    for seed in range(60):
        found = errors_of(np.random.default_rng(seed), 10, 8).estimates
        low, high = found.ci95["mpjpe_mm"][:, GROUPS.index(INSIDE)]
        held["mpjpe_mm"] += low <= 60.0 <= high
    assert held["mpjpe_mm"] >= 50
    one = errors_of(np.random.default_rng(0), 10, 8)
    twice = JointErrors(np.tile(one.errors_mm, (2, 1)), np.tile(one.visibility, (2, 1)), one.subjects * 2)
    np.testing.assert_allclose(twice.estimates.ci95["mpjpe_mm"], one.estimates.ci95["mpjpe_mm"], rtol=1e-6)


def test_a_paired_difference_sees_what_an_unpaired_one_does_not():
    rng = np.random.default_rng(3)
    a = errors_of(rng, 10, 8)
    b = replace(a, errors_mm=a.errors_mm + rng.normal(2.0, 1.0, a.errors_mm.shape))
    i = GROUPS.index(INSIDE)
    paired, apart = joint_difference(b, a, True), joint_difference(b, a, False)
    assert paired.scores["mpjpe_mm"][i] == pytest.approx(2.0, abs=0.2) == apart.scores["mpjpe_mm"][i]
    assert paired.ci95["mpjpe_mm"][0, i] > 0 > apart.ci95["mpjpe_mm"][0, i]
    same = joint_difference(a, a, True)
    assert (same.scores["pck_50mm"] == 0).all() and (same.ci95["mpjpe_mm"] == 0).all()


def test_a_paired_mean_is_of_the_joints_that_both_gave():
    a = errors_of(np.random.default_rng(4), 6, 4)
    lost = a.errors_mm.copy()
    lost[a.errors_mm > 60] = np.inf
    found = joint_difference(replace(a, errors_mm=lost), a, True)
    assert found.scores["mpjpe_mm"][0] == 0 and found.scores["pck_100mm"][0] < -0.2


def test_joints_have_twins_and_bones():
    assert all(TWIN[TWIN[i]] == i for i in range(N_JOINTS)) and TWIN[JOINT["left_hip"]] == JOINT["right_hip"]
    assert {end for bone in BONES for end in bone} == set(JOINT_NAMES)
