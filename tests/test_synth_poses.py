"""Separate poses in a file of joints: every pose is kept, faults of the file take one line."""

import warnings

import numpy as np
import pytest

from sensors.errors import CloudError
from synth.body.skeleton import JOINT_ID
from synth.motion.library import motion_files, read_repertoire

TRUNK_M = {"pelvis": (0, 0.95, 0), "neck": (0, 1.45, 0), "head": (0, 1.55, 0.03)}
LEFT_M = {
    "hip": (0.09, 0.88, 0),
    "knee": (0.1, 0.48, 0.01),
    "ankle": (0.1, 0.08, -0.02),
    "shoulder": (0.18, 1.39, -0.01),
    "elbow": (0.2, 1.11, -0.02),
    "wrist": (0.22, 0.86, 0.02),
}
ARMS = {
    "down": ((0, -1, 0), (0, -1, 0.1)),
    "side": ((1, 0, 0), (1, 0, 0.1)),
    "ahead": ((0.1, 0, 1), (0, 0.1, 1)),
}
POSES = [
    ("down", "down"),
    ("side", "side"),
    ("ahead", "down"),
    ("down", "ahead"),
    ("ahead", "ahead"),
    ("side", "down"),
]


def pose_m(left, right):
    """Return places by name of a standing person: x to the left, y up, z ahead, metres."""
    found = {name: np.array(at, float) for name, at in TRUNK_M.items()}
    for side, sign, arm in (("left", 1, left), ("right", -1, right)):
        mirror = np.array([sign, 1, 1])
        found |= {f"{side}_{name}": np.array(at) * mirror for name, at in LEFT_M.items()}
        upper, fore = (np.array(d) / np.linalg.norm(d) * mirror for d in ARMS[arm])
        found[f"{side}_elbow"] = found[f"{side}_shoulder"] + 0.28 * upper
        found[f"{side}_wrist"] = found[f"{side}_elbow"] + 0.25 * fore
    return found


def saved(path, poses=POSES, without=(), **arrays):
    places = [pose_m(*pose) for pose in poses]
    names = [name for name in places[0] if name.partition("_")[2] not in without]
    taken = np.array([[place[name] for name in names] for place in places])
    np.savez(path, joint_names=np.array(names), **({"poses_m": taken} | arrays))
    return path


def test_separate_poses_without_a_rate_are_all_kept(tmp_path):
    repertoire = read_repertoire(saved(tmp_path / "six.npz"))
    (motion,) = repertoire.motions.values()
    assert len(motion) == len(POSES)
    ids = [JOINT_ID[f"{side}_shoulder"] for side in ("left", "right")]
    raised = motion.angles_rad[:, ids, 0] > np.pi / 4
    np.testing.assert_array_equal(raised, [[side == "ahead" for side in pose] for pose in POSES])
    assert "separate poses" in " ".join(repertoire.assumed)


def test_frames_left_out_are_counted(tmp_path):
    lines = read_repertoire(saved(tmp_path / "fast.npz", POSES * 2, fps=np.array(500))).assumed
    assert any("of 12 frames" in line and "left out" in line for line in lines), lines


def test_a_slow_motion_without_a_rate_stays_a_motion(tmp_path):
    held = [pose for pose in POSES for _ in range(5)]
    repertoire = read_repertoire(saved(tmp_path / "held.npz", held))
    assert next(iter(repertoire.motions.values())).frames_per_second == 30


def test_takes_of_the_same_name_in_several_files_are_all_kept(tmp_path):
    for folder in ("a", "b", "c"):
        (tmp_path / folder).mkdir()
        saved(tmp_path / folder / "walk.npz")
    assert len(read_repertoire(tmp_path).motions) == 3
    saved(tmp_path / "one.npz")
    assert "one/poses_m" in read_repertoire(tmp_path).motions


@pytest.mark.parametrize(
    ("arrays", "without", "words"),
    [
        ({"poses_m": np.full((2, 15, 3), np.nan)}, (), "legs have no length"),
        ({}, ("knee", "ankle"), "left_knee, left_ankle"),
        ({"poses_m": np.zeros((6, 14, 3))}, (), "15 joint_names"),
    ],
)
def test_a_faulty_file_takes_one_line_that_names_the_fault(tmp_path, arrays, without, words):
    path = saved(tmp_path / "faulty.npz", without=without, **arrays)
    with warnings.catch_warnings(), pytest.raises(CloudError, match=words) as caught:
        warnings.simplefilter("error")
        read_repertoire(path)
    assert "\n" not in str(caught.value)


def test_arrays_without_names_of_joints_are_refused_by_name(tmp_path):
    np.savez(tmp_path / "bare.npz", takes=np.zeros((6, 7, 3)))
    with pytest.raises(CloudError, match=r"holds takes.*joint_names"):
        motion_files(tmp_path / "bare.npz")
