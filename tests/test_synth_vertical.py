"""The vertical axis: found by how a person stands and moves, and a person who lies stays lying."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from cli.main import app
from sensors.errors import CloudError
from synth.body.skeleton import JOINT_ID, N_JOINTS, rotations
from synth.markers.motion_file import load_motion
from synth.markers.solve import solve
from synth.motion_files.bvh import read_bvh
from synth.motion_files.marker_files import Markers, read_markers
from synth.motion_files.marker_set import known_markers
from synth.motion_files.vertical_axis import AXES, UNSTATED, Upward, direction
from tests.helpers.c3d_bytes import C3d
from tests.helpers.marker_truth import plug_in_gait, worn
from tests.helpers.walker import JOINTS, bvh_of, places_cm

ALONG_X = Rotation.from_matrix(np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]))
"""Turns y to x: the zero pose of Xsens and of Ubisoft's LAFAN1."""
Y_TO_Z = Rotation.from_matrix(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
UPSIDE = Rotation.from_euler("x", 180, degrees=True)
NONE = Rotation.identity()


@pytest.mark.parametrize("doing", ["walks", "lies", "stands"])
@pytest.mark.parametrize("zero_pose", [NONE, ALONG_X, Y_TO_Z], ids=["y", "x", "z"])
@pytest.mark.parametrize("world", [NONE, Y_TO_Z, UPSIDE], ids=["y up", "z up", "y down"])
def test_the_height_of_every_joint_of_a_bvh_is_its_own(tmp_path, doing, zero_pose, world):
    (tmp_path / "a.bvh").write_text(bvh_of(doing, zero_pose=zero_pose, world=world))
    markers, places = read_bvh(tmp_path / "a.bvh")
    known = known_markers(markers, places)
    truth = places_cm(doing)[:, :, 1] / 100
    heights = known.positions_m[:, places.names.index("head")][:, 2] - known.positions_m[:, 0, 2]
    true = truth[:, JOINTS.index("Head")] - truth[:, 0]
    agree = zero_pose.apply([0, 1, 0]) @ world.apply([0, 1, 0]) > 0.5 or (
        zero_pose is ALONG_X and world is NONE
    )
    if doing != "lies" or agree:
        np.testing.assert_allclose(heights, true, atol=2e-3)
    else:
        assert any(" is up" in line for line in known.assumed), (
            "lies by a wrong zero pose, and nothing is said"
        )
    said = [line for line in known.assumed if "vertical" in line or "zero pose" in line]
    assert bool(said) == (not agree or zero_pose is ALONG_X or doing == "lies")


def stands(bent: float, moves: bool = True, feet: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Angles (40, J, 3) and pelvis (40, 3) of an upright person. bent: degrees of the knees at most; moves:
    whether the arms move; feet: degrees that the feet hang by."""
    angles, pelvis = np.zeros((40, N_JOINTS, 3)), np.tile([0.4, -0.9, 0.95], (40, 1))
    wave = np.sin(np.pi * np.arange(40) / 39) ** 2
    for side in ("left", "right"):
        angles[:, JOINT_ID[f"{side}_shoulder"], 0] = 0.8 * wave if moves else 0
        angles[:, JOINT_ID[f"{side}_hip"], 0] = np.radians(bent / 2) * wave
        angles[:, JOINT_ID[f"{side}_knee"], 0] = -np.radians(bent) * wave
        angles[:, JOINT_ID[f"{side}_ankle"], 0] = np.radians(bent / 2) * wave - np.radians(feet)
    pelvis[:, 2] -= 0.82 * (1 - np.cos(np.radians(bent / 2) * wave))
    return angles, pelvis


def recorded(angles, pelvis, turn=NONE, move=(0.0, 0.0, 0.0)):
    """Markers (F, M, 3) in metres, z up before a turn and a move."""
    at = worn(plug_in_gait(), angles, pelvis, body=4)
    return turn.apply(at.reshape(-1, 3)).reshape(at.shape) + move


PRONE = Rotation.from_matrix(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]))
"""Turns z to x and the back (y) to z: who stood lies along x on the belly."""


def up_of(positions, stated=UNSTATED, labels=None, standing=False):
    known = known_markers(
        Markers(labels or plug_in_gait().names, positions, 100, "m", stated), plug_in_gait(), standing
    )
    return known.up, "; ".join(known.assumed)


SCREEN = [Upward(axis, "Y_SCREEN", "z") for axis in AXES]


@pytest.mark.parametrize("stated", [Upward("", "", "z"), Upward(), *SCREEN], ids=lambda s: s.axis or s.usual)
def test_who_squats_or_stands_on_flat_soles_stands_whatever_is_stated(stated):
    for bent, moves in ((70, True), (0, True), (0, False)):
        up, said = up_of(recorded(*stands(bent, moves), move=(1.0, 2.0, 0.0)), stated)
        assert up == "z"
        assert bool(said) == (stated.axis != "z") and " is up" not in said


@pytest.mark.parametrize("up", ["z", "y", "-z"])
def test_who_lies_stays_lying_where_the_file_states_the_vertical(up):
    to = {"z": NONE, "y": Rotation.from_euler("x", -90, degrees=True), "-z": UPSIDE}[up]
    on_floor = recorded(*stands(0, feet=35), PRONE, move=(0.3, 0.5, 1.0))
    for knees in (0, 50):
        lies = recorded(*stands(0, feet=35), PRONE, move=(0.3, 0.5, 1.0))
        if knees:
            angles, pelvis = stands(knees, feet=20)
            pelvis[:] = pelvis[0]
            lies = recorded(angles, pelvis, PRONE, move=(0.3, 0.5, 1.0))
        lies[..., 2] -= on_floor[..., 2].min() - 0.03
        found, said = up_of(to.apply(lies.reshape(-1, 3)).reshape(lies.shape), Upward(up, "Y_SCREEN", "z"))
        assert found == up and "the person lies" in said and " is up" in said


def test_places_about_the_pelvis_say_nothing_of_a_floor(tmp_path):
    (tmp_path / "a.bvh").write_text(bvh_of("stands"))
    markers, places = read_bvh(tmp_path / "a.bvh")
    at = markers.positions - markers.positions[:, [places.names.index("pelvis")]]
    at[:, [any(part in name for part in ("elbow", "wrist", "hand")) for name in places.names]] = np.nan
    assert np.nanmin(at[..., 2]) > -0.08, "no joint is far behind the pelvis: by z, all would be on a floor"
    known = known_markers(Markers(markers.labels, at, 30, "m", Upward("", "", "z")), places)
    assert known.up == "y" and any("the person stands along y" in line for line in known.assumed)


def on_the_floor(doing):
    """Markers (40, M, 3), z up, the floor at 0, of who rolls over sideways, walks on the hands, or rocks on
    hands and knees: the pelvis moves along the trunk above ankles that stay."""
    share = np.arange(40) / 39
    angles, way, turned = np.zeros((40, N_JOINTS, 3)), np.zeros((40, 3)), np.zeros((40, 2))
    if doing == "rocks":
        bent = np.radians(90 + 45 * np.sin(np.pi * share) ** 2)
        for side in ("left", "right"):
            angles[:, JOINT_ID[f"{side}_hip"], 0] = bent
            angles[:, JOINT_ID[f"{side}_knee"], 0] = -bent
            angles[:, JOINT_ID[f"{side}_shoulder"], 0] = bent
            angles[:, JOINT_ID[f"{side}_ankle"], 0] = np.radians(-40)
        turned[:, 0] = 85
    elif doing == "rolls":
        way[:, 0] = 1.6 * share
        turned = np.stack([np.full(40, 90), 360 * share], axis=1)
    else:
        way[:, 1] = -1.5 * share
        turned[:, 0] = 180
    places = plug_in_gait()
    at = recorded(angles, np.zeros((40, 3)))
    turns = Rotation.from_euler("XZ", turned, degrees=True)
    at = np.stack([turn.apply(frame) for turn, frame in zip(turns, at, strict=True)])
    stays = places.joint == (JOINT_ID["left_ankle"] if doing == "rocks" else JOINT_ID["pelvis"])
    at -= at[:, stays].mean(axis=1, keepdims=True) - way[:, None]
    at[..., 2] -= at[..., 2].min(axis=1, keepdims=True) - 0.03
    return at + np.array([1.5, -2.2, 0])


@pytest.mark.parametrize("doing", ["rolls", "rocks", "walks on the hands"])
def test_who_exercises_on_the_floor_stays_on_it_and_the_doubt_is_named(doing):
    at = on_the_floor(doing)
    for up, order in (("z", [0, 1, 2]), ("y", [1, 2, 0])):
        found, said = up_of(at[..., order], Upward(up, "Y_SCREEN", "z"))
        assert found == up and "the person lies" in said and " is up" in said
        assert " is up" in up_of(at[..., order], Upward("", "", up))[1]
    feet_at_0 = at - [0, at[..., 1].max(), 0]
    assert " is up" in up_of(feet_at_0, Upward("", "", "z"))[1]


def test_who_lies_in_a_file_without_a_vertical_lies_on_its_floor_and_the_doubt_is_named():
    lies = recorded(*stands(0, feet=35), PRONE, move=(0.3, 1.4, 0.0))
    lies[..., 2] -= lies[..., 2].min() - 0.03
    up, said = up_of(lies, Upward("", "", "z"))
    assert up == "z" and " is up" in said
    y_up = lies[..., [1, 2, 0]]
    up, said = up_of(y_up)
    assert up == "y" and " is up" in said


def test_who_stands_on_the_toes_at_the_origin_of_a_file_without_a_vertical_stands():
    angles, pelvis = stands(0, moves=False, feet=35)
    positions = recorded(angles, pelvis)
    lowest = positions.min(axis=(0, 1))
    for axes in ([0, 1, 2], [2, 0, 1], [0, 2, 1]):
        up, said = up_of((positions - lowest - 0.02)[..., axes], Upward("", "", "z"))
        assert up == "xyz"[axes.index(2)] and " is up" in said


def test_who_stands_still_in_the_static_gives_its_axis_to_the_trial():
    angles, pelvis = stands(0, False, feet=35)
    still = Markers(
        plug_in_gait().names, recorded(angles, pelvis, move=(0, 0, 3.0)), 100, "m", Upward("y", "Y_SCREEN")
    )
    lies = Markers(
        plug_in_gait().names, recorded(*stands(0, feet=35), PRONE), 100, "m", Upward("y", "Y_SCREEN")
    )
    motion = solve(lies, still)
    assert np.ptp(motion.pelvis_m[:, 2]) < 0.05 and any("Y_SCREEN" in line for line in motion.report.assumed)
    turned = rotations(motion.angles_rad[0])[0]
    assert abs(turned[2, 2]) < 0.1 and turned[2, 1] > 0.9, "the person does not lie on the belly"


LOWER = [n for n in plug_in_gait().names if n[1:] in ("ASI", "PSI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")]


@pytest.mark.parametrize("screen", [None, "+Z", "Z", "+Y", "-Z", "+X"])
def test_legs_alone_decide_the_vertical_of_a_c3d(tmp_path, screen):
    angles, pelvis = stands(20)
    pelvis[:, 1] += np.linspace(0, 1.2, 40)
    at = recorded(angles, pelvis)[:, [plug_in_gait().names.index(n) for n in LOWER]]
    parameters = [("POINT", "Y_SCREEN", [screen])] if screen else []
    markers = read_markers(C3d(1000 * at, LOWER, parameters=parameters).write(tmp_path / "a.c3d"))
    assert markers.up.axis == ("" if screen is None else screen.lower().lstrip("+"))
    known = known_markers(markers, plug_in_gait())
    np.testing.assert_allclose(
        known.positions_m[:, plug_in_gait().names.index("LASI"), 2], at[:, LOWER.index("LASI"), 2], atol=1e-4
    )
    assert known.up == "z" and bool(known.assumed) == (screen not in ("+Z", "Z"))


def test_the_axis_given_is_obeyed(tmp_path):
    lies = recorded(*stands(0, feet=35), PRONE, move=(0.3, 1.4, 0.0))
    C3d(1000 * lies, list(plug_in_gait().names)).write(tmp_path / "a.c3d")
    for up in ("x", "z"):
        args = ["solve", str(tmp_path / "a.c3d"), "--out", str(tmp_path / f"{up}.npz"), "--up", up]
        result = CliRunner().invoke(app, args)
        assert result.exit_code == 0, result.output
        assert "vertical" not in result.output
    trunks = [rotations(load_motion(tmp_path / f"{up}.npz").angles_rad[0])[0][2, 2] for up in ("x", "z")]
    assert trunks[0] > 0.98 and abs(trunks[1]) < 0.1
    wrong = CliRunner().invoke(app, [*args[:-1], "up", "--overwrite"])
    assert isinstance(wrong.exception, CloudError) and "'up'" in str(wrong.exception)
    np.testing.assert_array_equal(direction("-y"), [0, -1, 0])
