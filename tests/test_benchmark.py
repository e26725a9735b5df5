"""Joints on the benchmarks of others: ITOP's files, the field's measure, any recording with true joints."""

import json

import h5py
import numpy as np
import pytest
from conftest import assert_refused
from scipy.io import loadmat

from annotate.labelset.label_set import LabelSet
from eval.benchmark.benchmark_set import as_named
from eval.benchmark.itop import CAMERA, JOINTS, read_itop
from eval.benchmark.joint_truth import read_joint_truth
from eval.benchmark.mean_precision import joint_hits, mean_precision
from eval.benchmark.published import KINDS, PUBLISHED
from eval.scores.joint_errors import true_joints_mm
from eval.scores.joints import JOINT, JOINT_NAMES
from sensors.errors import CloudError, FormatError
from sensors.session.reader import Session

SIDE = "ITOP_side_test"


def write_itop(folder, depth_m, joints_m, view="side", **others):
    """Write ITOP's two files of a view as published; others: datasets of the labels that differ."""
    n = len(depth_m)
    ids = np.array([f"{i % 2:02d}_{i:05d}" for i in range(n)], "S8")
    with h5py.File(folder / f"ITOP_{view}_test_depth_map.h5", "w") as file:
        file["id"], file["data"] = ids, np.asarray(depth_m, np.float16)
    labels = {
        "id": ids,
        "is_valid": np.ones(n, np.uint8),
        "visible_joints": np.ones((n, 15), np.int16),
        "image_coordinates": np.zeros((n, 15, 2), np.int16),
        "real_world_coordinates": np.asarray(joints_m, np.float16),
        "segmentation": np.full((n, 240, 320), -1, np.int8),
    }
    with h5py.File(folder / f"ITOP_{view}_test_labels.h5", "w") as file:
        for name, values in (labels | others).items():
            file[name] = values


@pytest.fixture(scope="module")
def truth(rig_session) -> LabelSet:
    return LabelSet.open(rig_session.with_suffix(".truth"))


@pytest.fixture
def itop_folder(tmp_path, truth):
    """The virtual rig's people as ITOP would publish them: ITOP's camera, y up, a frame that is not valid."""
    v, u = np.indices(CAMERA.shape)
    own = truth.intrinsics
    columns = np.rint((u - CAMERA.cx) / CAMERA.fx * own.fx + own.cx).astype(int)
    rows = np.rint((v - CAMERA.cy) / CAMERA.fy * own.fy + own.cy).astype(int)
    inside = (columns >= 0) & (columns < own.width) & (rows >= 0) & (rows < own.height)
    depth_m, joints_m = [], []
    for frame in truth:
        seen = frame.depth_mm[np.clip(rows, 0, own.height - 1), np.clip(columns, 0, own.width - 1)]
        depth_m.append(np.where(inside, seen, 0) / 1000)
        joints_m.append(as_named(true_joints_mm(frame) / 1000, JOINTS) * (1, -1, 1))
    valid = np.arange(len(depth_m)) > 0
    write_itop(tmp_path, depth_m, joints_m, is_valid=valid.astype(np.uint8))
    return tmp_path


def test_the_measure_counts_all_joints_of_all_frames_and_averages_joints():
    true = np.zeros((4, 2, 3))
    predicted = np.array([[[0.099, 0, 0], [0, 0.1, 0]], [[0, 0, 0], [0.05, 0.05, 0.05]]] * 2)
    predicted[3] = np.nan
    hits = joint_hits(predicted, true)
    assert hits.tolist() == [[True, False], [True, True], [True, False], [False, False]]
    counted = np.array([[True, True]] * 3 + [[True, False]])
    found = mean_precision(hits, counted, ["a", "a", "b", "b"])
    np.testing.assert_allclose(found.by_joint, [3 / 4, 1 / 3])
    assert found.mean == pytest.approx((3 / 4 + 1 / 3) / 2) and (found.frames, found.people) == (4, 2)
    assert 0 <= found.ci95[0] <= found.mean <= found.ci95[1] <= 1
    nobody = mean_precision(hits, np.array([[True, False]] * 4), ["a"] * 4)
    assert nobody.to_json(["head", "neck"])["joints"] == {"head": 0.75, "neck": None}
    with pytest.raises(CloudError, match="no frame has a visible true joint"):
        mean_precision(hits, np.zeros((4, 2), bool), ["a"] * 4)


def test_published_predictions_of_a2j_have_their_published_precision(shared_data):
    folder = shared_data / "itop_a2j"
    if not folder.is_dir():
        pytest.skip("no predictions of A2J: ../shared/data/itop_a2j is absent")
    true = loadmat(folder / "itop_side_keypoints3D_test.mat")["keypoints3D"].astype(np.float64)
    u, v, z = np.moveaxis(loadmat(folder / "itop_side_88.mat")["resultUVD"], -1, 0)
    predicted = np.stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z], -1)
    hits = joint_hits(predicted, true * (1, -1, 1))
    found = mean_precision(hits, np.ones(hits.shape, bool), ["unknown"] * len(hits))
    assert (found.frames, round(100 * found.mean, 2)) == (4863, 88.02)
    by_kind = [found.by_joint[[name.endswith(kind) for name in JOINTS]].mean() for kind in KINDS]
    a2j = next(one for one in PUBLISHED if one.method == "A2J")
    np.testing.assert_allclose(100 * np.array(by_kind), a2j.joints, atol=0.05)
    # ITOP's torso is the middle of neck and hips, and its sides are the person's own.
    middle = (true[:, 1] + (true[:, 9] + true[:, 10]) / 2) / 2
    assert np.quantile(np.linalg.norm(true[:, 8] - middle, axis=1), 0.99) < 0.003


def test_itop_is_read_predicted_and_measured(itop_folder, annotate_cloud):
    given = read_itop(itop_folder, "side")
    assert len(given.source) == 2 and given.subjects == ("person 01", "person 00")
    run = annotate_cloud("benchmark", "itop", itop_folder, "--out", itop_folder / "out", "--json")
    assert run.code == 0, run.err
    side = run.result["views"]["side"]
    assert (side["frames"], side["people"], side["frames_without_person"]) == (2, 2, 0)
    assert list(side["joints"]) == list(JOINTS) and side["map"] > 0.9, side
    again = annotate_cloud("benchmark", "itop", itop_folder, "--out", itop_folder / "out")
    assert again.code == 0 and "A2J" in again.out and "arXiv:1711.07399" in again.out


def test_any_recording_with_joints_is_measured(rig_session, truth, tmp_path, annotate_cloud):
    path, labels = tmp_path / "true.jsonl", tmp_path / "labels"
    rows = [
        {"frame": id_, "person": 1, "joints_mm": dict(zip(JOINT_NAMES, joints, strict=True))}
        for id_, joints in ((frame.frame_id, true_joints_mm(frame).tolist()) for frame in truth)
    ]
    path.write_text("".join(json.dumps(row) + "\n" for row in [*rows, {"frame": 0, "person": 2}]))
    run = annotate_cloud("benchmark", "joints", rig_session, "--truth", path, "--out", labels, "--json")
    assert run.code == 0 and run.result["frames"] == 3 and run.result["map"] > 0.9, run
    rows[1] |= {"hidden": ["neck"], "subject": "Ada", "joints_mm": {"neck": [0, 0, 2000]}}
    path.write_text("\n".join(map(json.dumps, rows[1:])))
    given = read_joint_truth(Session(rig_session), path)
    assert np.isnan(given.true_m[0]).all() and given.subjects[1] == "Ada"
    assert (
        given.true_m[1, given.joints.index("neck"), 2] == 2 and given.visible.sum() == given.visible.size - 1
    )
    for broken in (
        "{",
        "[]",
        '{"frame": 9, "joints_mm": {}}',
        '{"frame": 0, "joints_mm": {"nose": [1, 2, 3]}}',
    ):
        path.write_text(broken)
        refused = annotate_cloud("benchmark", "joints", rig_session, "--truth", path, "--out", labels)
        assert_refused(refused, "line 1 is malformed")
    assert_refused(annotate_cloud("benchmark", "joints", rig_session, "--out", labels), "give --truth FILE")


def test_names_and_sides_of_itop_are_those_of_the_network():
    found = np.arange(45.0).reshape(15, 3)
    named = dict(zip(JOINTS, as_named(found, JOINTS), strict=True))
    np.testing.assert_array_equal(named["right_hand"], found[JOINT["right_wrist"]])
    np.testing.assert_array_equal(named["left_foot"], found[JOINT["left_ankle"]])


def spoilt(file, name, make):
    del file[name]
    make(file, name)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda file, name: None, "is missing"),
        (
            lambda f, name: f.__setitem__(name, h5py.ExternalLink("other.h5", "/x")),
            "is not an array of this file",
        ),
        (
            lambda f, name: f.create_dataset(name, (3,), "u1", external=[("/etc/passwd", 0, 3)]),
            "not an array",
        ),
        (lambda f, name: f.create_dataset(name, (10**12,), "u1", chunks=(10,)), "give"),
        (
            lambda f, name: f.create_dataset(name, (3,), "u1", maxshape=(None,), chunks=(1 << 30,)),
            "blocks of",
        ),
        (lambda f, name: f.create_dataset(name, data=np.zeros(3, np.uint8)), "no valid frame;"),
    ],
)
def test_labels_of_another_layout_are_refused(tmp_path, make, message):
    write_itop(tmp_path, np.ones((3, 240, 320)), np.ones((3, 15, 3)))
    with h5py.File(tmp_path / f"{SIDE}_labels.h5", "a") as file:
        spoilt(file, "is_valid", make)
    with pytest.raises(FormatError, match=message):
        read_itop(tmp_path, "side")


def test_files_that_are_missing_packed_cut_or_of_other_frames_are_refused(tmp_path, annotate_cloud):
    command = ("benchmark", "itop", tmp_path, "--out", tmp_path / "out")
    assert_refused(annotate_cloud(*command), "holds no")
    write_itop(tmp_path, np.ones((3, 240, 320)), np.ones((3, 15, 3)), id=np.array([b"00_00001"] * 3))
    assert_refused(annotate_cloud(*command), "other ids")
    assert_refused(annotate_cloud(*command, "--view", "top"), "ITOP_top_test_labels.h5 is missing")
    labels = tmp_path / f"{SIDE}_labels.h5"
    labels.write_bytes(labels.read_bytes()[:3000])
    assert_refused(annotate_cloud(*command), "cannot be read")
    labels.rename(tmp_path / f"{SIDE}_labels.h5.gz")
    assert_refused(annotate_cloud(*command), "unpack its .gz")
    write_itop(tmp_path, np.ones((1, 240, 320)), np.ones((1, 15, 3)), id=np.array([b"0" * 65]))
    with pytest.raises(FormatError, match="give at most"):
        read_itop(tmp_path, "side")
