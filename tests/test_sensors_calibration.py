"""Poses are a group; calibrations survive JSON to the bit, and hostile JSON is refused in one line."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sensors.errors import CalibrationError, CloudError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import (
    Pose,
    RigCalibration,
    calibration_from_json,
    calibration_to_json,
    load_calibration,
    quaternion_of,
    rotation_of,
    save_calibration,
)

DEPTH = Intrinsics(512, 424, 365.150208, 365.150208, 253.9832, 211.093994, k1=0.0922871977, k2=-0.266797304)
seeds = st.integers(0, 2**32 - 1)


def pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(Rotation.random(random_state=seed).as_matrix(), rng.normal(0, 2, 3))


def rig(seed: int) -> RigCalibration:
    color = Intrinsics(1920, 1080, 1081.37207, 1081.37207, 959.5, 539.5)
    return RigCalibration(DEPTH, color, pose(seed), Intrinsics(160, 120, 390, 391, 80, 60), pose(seed + 1))


def assert_same(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-12)
    np.testing.assert_allclose(a.translation_m, b.translation_m, atol=1e-12)


@settings(deadline=None, max_examples=50)
@given(a=seeds, b=seeds, c=seeds)
def test_poses_are_a_group(a, b, c):
    p, q, r = pose(a), pose(b), pose(c)
    assert_same((p @ q) @ r, p @ (q @ r))
    assert_same(p @ Pose.identity(), p)
    assert_same(Pose.identity() @ p, p)
    assert_same(p @ p.inverse(), Pose.identity())
    assert_same(p.inverse() @ p, Pose.identity())
    assert_same(p.inverse().inverse(), p)


@settings(deadline=None, max_examples=50)
@given(a=seeds, b=seeds, shape=st.sampled_from([(3,), (5, 3), (2, 4, 3)]))
def test_composition_is_application_in_turn_and_keeps_distances(a, b, shape):
    p, q = pose(a), pose(b)
    points = np.random.default_rng(a).normal(0, 2, shape)
    moved = (p @ q).apply(points)
    assert moved.shape == shape
    np.testing.assert_allclose(moved, p.apply(q.apply(points)), atol=1e-12)
    np.testing.assert_allclose(p.inverse().apply(p.apply(points)), points, atol=1e-12)
    rows, images = points.reshape(-1, 3), moved.reshape(-1, 3)
    np.testing.assert_allclose(
        np.linalg.norm(images - images[0], axis=1), np.linalg.norm(rows - rows[0], axis=1), atol=1e-12
    )


UNIT = st.floats(-1, 1, allow_subnormal=False)


@given(st.tuples(UNIT, UNIT, UNIT, UNIT).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_quaternions_are_scipys_there_and_back(numbers):
    rotation = rotation_of(np.array(numbers))
    np.testing.assert_allclose(rotation, Rotation.from_quat(numbers).as_matrix(), atol=1e-12)
    quaternion = quaternion_of(rotation)
    assert np.linalg.norm(quaternion) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(rotation_of(quaternion), rotation, atol=1e-12)
    half = np.diag(np.where(np.arange(3) == len(str(numbers)) % 3, 1.0, -1.0))
    np.testing.assert_allclose(rotation_of(quaternion_of(half)), half, atol=1e-12)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_a_quaternion_without_a_length_is_refused(bad):
    with pytest.raises(ValueError, match="length"):
        rotation_of(np.array(bad))


@pytest.mark.parametrize(
    ("rotation", "translation"),
    [
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3)),  # a reflection
        (2 * np.eye(3), np.zeros(3)),
        (np.eye(3), np.array([0, np.nan, 0])),
        (np.full((3, 3), np.nan), np.zeros(3)),
        (np.eye(2), np.zeros(3)),
    ],
)
def test_what_is_no_rigid_transform_is_refused(rotation, translation):
    with pytest.raises(CalibrationError, match="give"):
        Pose(rotation, translation)


def test_a_camera_without_its_pose_is_refused():
    with pytest.raises(CalibrationError, match="color_from_depth"):
        RigCalibration(DEPTH, color=DEPTH)


ONE, ALL = calibration_to_json(RigCalibration(DEPTH))["depth"], calibration_to_json(rig(0))
HOSTILE = [
    *(None, [], {}, {"color": {}}, {"depth": []}, {"depth": {"width": 1}}),
    {"depth": {**ONE, "rolling_shutter": 1}},
    {"depth": {**ONE, "width": 10**9}},
    {"depth": {**ONE, "width": float("inf")}},
    {"depth": {**ONE, "fx": "wide"}},
    {"depth": {**ONE, "fx": float("nan")}},
    {**ALL, "color_from_depth": {"rotation": [[1]], "translation_m": [0, 0, 0]}},
    {**ALL, "color_from_depth": {"rotation": [1, [2]], "translation_m": [0]}},
    {**ALL, "color_from_depth": {"rotation": None}},
    {**ALL, "__class__": "os.system"},
]


@pytest.mark.parametrize("fields", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_json_is_refused(fields):
    with pytest.raises(CalibrationError) as error:
        calibration_from_json(fields)
    assert "\n" not in str(error.value)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


@settings(deadline=None, max_examples=50)
@given(
    name=st.sampled_from(["depth", "color", "color_from_depth"]),
    key=st.sampled_from(["width", "fx", "k1", "rotation", "translation_m"]),
    value=json_values,
)
def test_any_entry_may_be_anything(name, key, value):
    fields = calibration_to_json(rig(0))
    fields[name][key] = value
    try:
        calibration_from_json(fields)
    except CloudError as error:
        assert str(error)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b" " * 1_000_001])
def test_broken_files_are_refused(tmp_path, content):
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    with pytest.raises(CalibrationError, match=r"rig\.json"):
        load_calibration(path)


def test_calibration_survives_a_file_to_the_bit_and_a_missing_one_is_named(tmp_path):
    original = rig(7)
    save_calibration(tmp_path / "rig.json", original)
    copy = load_calibration(tmp_path / "rig.json")
    assert (copy.depth, copy.color, copy.thermal) == (original.depth, original.color, original.thermal)
    for name in ("color_from_depth", "thermal_from_depth"):
        for part in ("rotation", "translation_m"):
            ours, theirs = (getattr(getattr(each, name), part) for each in (copy, original))
            np.testing.assert_array_equal(ours, theirs)
    with pytest.raises(CalibrationError, match=f"none{os.extsep}json"):
        load_calibration(tmp_path / "none.json")
