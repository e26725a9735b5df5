"""Labels by a witness: skeleton, limbs, fusion, outline, and whole recordings."""

import json
import shutil
from dataclasses import replace
from importlib.resources import files
from itertools import product as pairs

import numpy as np
import pytest
from conftest import assert_refused, tree

from annotate.labelset.label_set import LabelSet
from annotate.parts import PAPER
from annotate.scheme.regions import N_REGIONS, Region
from annotate.scheme.scheme_file import load_scheme
from annotate.witness.fusion import KIND, fused, head_by_depth, in_scheme, shipped_spreads
from annotate.witness.limbs import ALONG, SEGMENTS, distances
from annotate.witness.outline import outline
from annotate.witness.skeleton import HALF_THICK, JOINT, JOINTS, Skeleton, Surface, skeleton_of
from eval.network.body_state import BodyState
from eval.network.colour.colour_labeller import ColourLabeller, label_by_colour
from eval.network.colour.suit_and_colour import product
from eval.network.onnx_network import OnnxNetwork
from eval.scores.confusion import confusion_matrix, mean_recall, person_iou
from eval.scores.joints import IN_SKELETON
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, project
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.reader import Session
from synth.body.skeleton import JOINT_ID
from tools.fit.witness_errors import NAMES, WitnessErrors
from tools.measure.by_colour import simulated

CAMERA = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0)
RNG = np.random.default_rng(7)


def standing() -> Skeleton:
    """A person of 0.5 m trunk who faces the camera at 2 m, arms hanging."""
    at = {"head": (0, -0.75), "neck": (0, -0.5), "pelvis": (0, 0)}
    for name, x, y in (
        *(("shoulder", 0.2, -0.5), ("elbow", 0.22, -0.2), ("wrist", 0.22, 0.05), ("hand", 0.22, 0.15)),
        *(("hip", 0.1, 0.0), ("knee", 0.1, 0.4), ("ankle", 0.1, 0.8), ("toes", 0.1, 0.85)),
    ):
        at |= {f"left_{name}": (x, y), f"right_{name}": (-x, y)}
    joints_m = np.array([[*at[name], 2.0] for name in JOINTS])
    return Skeleton(joints_m, np.zeros(len(JOINTS)), 0.5)


def test_landmarks_and_the_surface_before_them_give_the_joints_back():
    skeleton, names = standing(), [name for name in JOINTS if name not in ("neck", "pelvis")]
    joints_m = skeleton.joints_m[[JOINT[name] for name in names]]
    kinds = [name.split("_")[-1] for name in names]
    thick_m = skeleton.trunk_m * np.array([HALF_THICK[kind] for kind in kinds])
    front = joints_m * (1 - thick_m / 2.0)[:, None]
    points = (front[:, None] + 1e-4 * RNG.normal(size=(len(front), 20, 3))).reshape(-1, 3)
    pose = Pose(np.eye(3), np.array([0.05, 0.0, 0.0]))
    surface = Surface(project(CAMERA, points) + 0.5, points[:, 2], CAMERA, pose)
    landmarks = np.column_stack([project(CAMERA, joints_m) + 0.5, np.ones(len(names))])
    renamed = [f"{n[:-5]}_foot_index" if n.endswith("toes") else "nose" if n == "head" else n for n in names]
    held = [*renamed, "left_index", "left_pinky", "right_index", "right_pinky"]
    hands = landmarks[[names.index(f"{side}_hand") for side in ("left", "left", "right", "right")]]
    found = skeleton_of(np.vstack([landmarks, hands]), held, surface)
    assert found.trunk_m == pytest.approx(0.5, rel=0.1)
    np.testing.assert_allclose(found.joints_m, skeleton.joints_m + np.array([0.05, 0, 0]), atol=0.03)


def test_an_unseen_joint_comes_from_the_depth_network_at_a_possible_length():
    skeleton = standing()
    known = skeleton.joints_m.copy()
    skeleton.joints_m[JOINT["left_wrist"]] = np.nan
    far = known.copy()[:15]
    far[JOINT["left_wrist"], 1] += 3
    completed = skeleton.completed(far)
    bone = completed.joints_m[JOINT["left_wrist"]] - known[JOINT["left_elbow"]]
    assert 0.25 < np.linalg.norm(bone) < 0.35
    assert completed.sd[JOINT["left_wrist"]] > 0 == completed.sd[JOINT["right_wrist"]]


@pytest.mark.parametrize("number", range(8))
def test_neck_and_pelvis_are_given_where_the_bodies_have_them(number):
    rest = np.load(files("synth") / "data" / f"body_{number}.npz")["joints_m"]
    middles = {
        middle: rest[[JOINT_ID[f"{side}_{kind}"] for side in ("left", "right")]].mean(axis=0)
        for middle, kind in (("neck", "shoulder"), ("pelvis", "hip"))
    }
    trunk_m = np.linalg.norm(middles["neck"] - middles["pelvis"])
    joints_m = np.full((len(JOINTS), 3), np.nan)
    joints_m[[JOINT[name] for name in middles]] = list(middles.values())
    by_colour = Skeleton(joints_m, np.zeros(len(JOINTS)), trunk_m)
    for name in middles:
        off = by_colour.body_joints_m()[JOINT[name]] - rest[JOINT_ID[name]]
        assert np.linalg.norm(off) < 0.05 * trunk_m
    assert np.isnan(by_colour.body_joints_m()[JOINT["head"]]).all()
    network = replace(by_colour, joints_m=np.full_like(joints_m, np.nan)).completed(rest[IN_SKELETON])
    np.testing.assert_array_equal(network.body_joints_m(), rest[IN_SKELETON])
    joints_m[JOINT["pelvis"]] = np.nan
    assert np.isnan(by_colour.body_joints_m()[JOINT["neck"]]).all()


def test_distances_are_those_of_a_naive_search_along_each_segment():
    skeleton, points = standing(), RNG.normal(size=(5, 3)) * 0.3 + (0, 0, 2)
    far, sd = distances(points.astype(np.float32), skeleton)
    assert far.shape == (5, N_REGIONS)
    assert not sd.any()
    for k, segment in enumerate(SEGMENTS):
        ends = [
            (1 - end[2]) * skeleton.joints_m[JOINT[end[0]]] + end[2] * skeleton.joints_m[JOINT[end[1]]]
            for end in (segment.a, segment.b)
        ]
        line = np.linspace(segment.start, segment.end, 3001)[:, None]
        places = ends[0] + line * (ends[1] - ends[0])
        for i, point in enumerate(points):
            off = point - places[np.linalg.norm(point - places, axis=1).argmin()]
            ray = point / np.linalg.norm(point)
            beside = off - (off @ ray) * ray
            expected = np.hypot(np.linalg.norm(beside), ALONG * (off @ ray)) / 0.5
            assert far[i, k] == pytest.approx(expected, abs=2e-3)


def test_fusion_follows_depth_without_limbs_and_limbs_without_depth():
    skeleton, spreads = standing(), shipped_spreads()
    at = [Region.LEFT_FOREARM, Region.RIGHT_LOWER_LEG, Region.BELLY]
    points = np.array([[0.22, -0.07, 1.95], [-0.1, 0.6, 1.93], [0, -0.25, 1.9]], np.float32)
    flat = np.full((12, 3), 1 / 12, np.float32)
    regions = fused(flat, PAPER, points, skeleton, spreads)
    np.testing.assert_allclose(regions.sum(axis=0), 1, atol=1e-5)
    parts = in_scheme(regions, PAPER)
    np.testing.assert_allclose(parts.sum(axis=0), 1, atol=1e-5)
    assert PAPER.class_ids[parts.argmax(axis=0)].tolist() == [int(PAPER.table[one]) for one in at]
    unknown = replace(skeleton, joints_m=np.full_like(skeleton.joints_m, np.nan))
    sure = np.eye(12, dtype=np.float32)[:, [1, 5, 9]]
    parts = in_scheme(fused(sure, PAPER, points, unknown, spreads), PAPER)
    assert parts.argmax(axis=0).tolist() == [1, 5, 9]
    swapped = replace(skeleton, joints_m=skeleton.joints_m * (-1, 1, 1))
    mirrored = in_scheme(fused(flat, PAPER, points, swapped, spreads), PAPER)
    assert PAPER.class_ids[mirrored.argmax(axis=0)].tolist()[:2] == [6, 10]
    atlas = load_scheme("atlas")
    np.testing.assert_allclose(in_scheme(regions, atlas)[1:], regions)
    assert len(KIND) == N_REGIONS


def test_a_head_on_the_chest_moves_to_the_head_by_depth():
    skeleton = standing()
    true = skeleton.joints_m[JOINT["head"]].copy()
    points = np.vstack([true + 0.01 * RNG.normal(size=(50, 3)), [[0, -0.2, 1.9]] * 50]).astype(np.float32)
    chance = np.repeat([0.9, 0.0], 50).astype(np.float32)
    assert head_by_depth(skeleton, points, chance) is skeleton
    skeleton.joints_m[JOINT["head"]] = (0, -0.2, 1.95)
    found = head_by_depth(skeleton, points, chance).joints_m[JOINT["head"]]
    assert np.linalg.norm(found - true) < 0.15


def test_depth_decides_within_the_border_and_the_witness_beyond():
    depth = np.full((60, 60), 3000, np.uint16)
    body = np.zeros((60, 60), bool)
    body[10:50, 20:40] = True
    depth[body] = 2000
    depth[30, 30] = 0
    mask = np.zeros((60, 60), np.float32)
    mask[12:52, 22:42] = 1
    found = np.zeros_like(body)
    found[10:50, 2:40] = True
    own = outline(depth, mask, found, np.zeros_like(body), 4)
    expected = body & (depth > 0)
    assert (own != expected).mean() < 0.01
    assert not own[:, :14].any()
    head = np.zeros_like(body)
    head[2:10, 25:35] = True
    assert outline(depth, mask, found | head, head, 4)[4:10, 27:33].all()
    hidden = np.where(body, np.nan, 0).astype(np.float32)
    assert (outline(depth, hidden, body, np.zeros_like(body), 4) != expected).mean() < 0.01


def test_two_labels_combine_as_their_distributions():
    for (a, p), (b, q) in pairs([(1, 0.6), (2, 0.9)], [(1, 0.5), (2, 0.7), (3, 0.8)]):
        each = [np.full(11, (1 - one) / 10) for one in (p, q)]
        each[0][a - 1], each[1][b - 1] = p, q
        both = each[0] * each[1] / (each[0] @ each[1])
        parts = ((np.array([one], np.uint8), np.array([sure], np.float32)) for one, sure in ((a, p), (b, q)))
        part, sure = product(*parts, 11)
        assert part[0] == both.argmax() + 1
        assert sure[0] == pytest.approx(both.max(), abs=1e-5)


def median_off_mm(known: LabelSet, labels: LabelSet, name: str) -> float:
    """Return the median distance of a joint from its true place, millimetres."""
    off = []
    for frame_id in labels.frame_ids:
        state = BodyState.from_note(labels.read(frame_id).notes["bearing"])
        true = np.array(known.read(frame_id).notes["joints_mm"])[IN_SKELETON]
        off.append(state.joints_mm(labels.intrinsics) - true)
    return float(np.median(np.linalg.norm(np.array(off)[:, JOINT[name]], axis=1)))


def test_a_recording_is_labelled_by_a_witness_and_resumes_to_the_bit(rig_session, tmp_path):
    session = Session(rig_session)
    nothing = WitnessErrors(0, 0, 0, 0, 0)
    witness = simulated(rig_session, nothing, 1, 0)
    assert witness.names == NAMES
    labeller = ColourLabeller(witness, OnnxNetwork(), PAPER)
    run = label_by_colour(session, labeller, tmp_path / "l", lambda n: None)
    assert not run.failed
    known = LabelSet.open(rig_session.with_suffix(".truth"))
    matrix = sum(
        confusion_matrix(known.read(i).parts, run.labels.read(i).parts, PAPER) for i in run.labels.frame_ids
    )
    assert mean_recall(matrix) > 0.9
    assert person_iou(matrix, PAPER) > 0.95
    assert median_off_mm(known, run.labels, "neck") < 40
    kept = tree(tmp_path / "l")
    shutil.copytree(tmp_path / "l", tmp_path / "again")
    last = run.labels.frame_ids[-1]
    for path in (tmp_path / "again" / "frames").glob(f"{last}*"):
        path.unlink()
    label_by_colour(session, labeller, tmp_path / "again", lambda n: None)
    assert tree(tmp_path / "again") == kept
    nobody = ColourLabeller(replace(witness, people={}), OnnxNetwork(), PAPER)
    empty = label_by_colour(session, nobody, tmp_path / "n", lambda n: None)
    assert not PAPER.on_body(empty.labels.read(last).parts).any()
    assert any("shows no person" in note for note in empty.remarks())
    with pytest.raises(CalibrationError, match="register colour to depth"):
        labeller.fuser(RigCalibration(session.calibration.depth))


def test_missing_models_and_wrong_options_are_refused(annotate_cloud, rig_session, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    out = tmp_path / "l"
    refused = annotate_cloud("label", rig_session, "--out", out, "--by", "colour")
    assert_refused(refused, "run annotate-cloud models colour")
    refused = annotate_cloud("label", rig_session, "--out", out, "--by", tmp_path / "pose.onnx")
    assert_refused(refused, "pose.onnx", "check the path")
    (tmp_path / "pose.onnx").write_bytes(json.dumps([]).encode())
    refused = annotate_cloud("label", rig_session, "--out", out, "--by", tmp_path / "pose.onnx")
    assert_refused(refused, "not a pose network")
    assert annotate_cloud("label", rig_session, "--out", out, "--everybody").code == 2
    assert not out.exists()
