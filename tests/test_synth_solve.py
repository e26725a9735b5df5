"""The solver against known angles, against damage, and against real recordings."""

import json
from dataclasses import replace

import numpy as np
import pytest
import typer
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import cli.verbs.motion
from sensors.errors import CloudError, ExistsError
from synth.body.body import shipped_bodies
from synth.body.skeleton import (
    JOINT_ID,
    JOINTS,
    LIMITS_RAD,
    N_JOINTS,
    Posture,
    alignment,
    clamp,
    forward,
    rotations,
)
from synth.markers.kinematics import TREE, State, axes_of, joint_frames, markers_at
from synth.markers.motion_file import BRIDGED, GHOST, MISSING, SWAPPED, Motion, load_motion
from synth.markers.person_fit import Template, posture_prior, zero_bones
from synth.markers.posture_fit import Observed, fit_posture
from synth.markers.solve import bridge, solve
from synth.motion_files.bvh import read_bvh
from synth.motion_files.marker_files import read_markers
from synth.motion_files.vertical_axis import GIVEN, Upward
from tests.helpers.lab_angles import LEG, PlugInGait, columns, errors_deg
from tests.helpers.marker_truth import joint_errors_deg, plug_in_gait, synthesise

UP = Upward("z", GIVEN)


def random_posture(seed: int) -> Posture:
    rng = np.random.default_rng(seed)
    share = rng.uniform(0.1, 0.9, (N_JOINTS, 3))
    return Posture(LIMITS_RAD[..., 0] + share * np.ptp(LIMITS_RAD, axis=2), rng.normal(0, 1, 3))


@pytest.mark.parametrize("seed", range(5))
def test_kinematics_agree_with_the_skeleton(seed):
    posture, rest = random_posture(seed), shipped_bodies()[seed].joints_m
    aligned = alignment(rest)
    frames, joints = forward(posture, rest, aligned)
    found_frames, found_joints = joint_frames(
        TREE, State.of(posture.angles_rad, posture.pelvis_m), zero_bones(rest)
    )
    np.testing.assert_allclose(found_joints, joints, atol=1e-9)
    np.testing.assert_allclose(found_frames @ aligned, frames, atol=1e-9)


def test_axes_are_the_derivative_of_the_frames():
    posture, step = random_posture(9), 1e-6
    bones = zero_bones(shipped_bodies()[0].joints_m)
    state = State.of(posture.angles_rad, posture.pelvis_m)
    frames, _ = joint_frames(TREE, state, bones)
    axes = axes_of(TREE, frames, state.signed_rad)
    for j in np.flatnonzero(~TREE.ball):
        for k in range(3):
            signed = state.signed_rad.copy()
            signed[j, k] += step
            local = state.local.copy()
            local[j] = Rotation.from_euler("XYZ", signed[j]).as_matrix()
            moved, _ = joint_frames(TREE, State(state.pelvis_m, signed, local), bones)
            turn = Rotation.from_matrix(moved[j] @ frames[j].T).as_rotvec() / step
            np.testing.assert_allclose(turn, axes[j, k], atol=1e-5)


@pytest.fixture(scope="module")
def truth():
    return synthesise(0, 200)


@pytest.fixture(scope="module")
def solved(truth):
    return solve(truth.moving, truth.static)


def damaged(truth, change) -> Motion:
    """Return the motion solved from markers that ``change`` damages in place."""
    positions = truth.moving.positions.copy()
    change(positions)
    return solve(replace(truth.moving, positions=positions), truth.static)


def angle_errors_deg(truth, motion: Motion) -> np.ndarray:
    return np.degrees(np.abs(truth.angles_rad - motion.angles_rad))


def test_known_angles_are_found(truth, solved):
    assert np.median(angle_errors_deg(truth, solved)) <= 2
    assert np.median(joint_errors_deg(truth.angles_rad, solved.angles_rad)) <= 5
    assert np.median(np.linalg.norm(solved.pelvis_m - truth.pelvis_m, axis=1)) < 0.02
    assert solved.report.median_mm < 4
    inside = np.array([clamp(a) for a in solved.angles_rad])
    np.testing.assert_allclose(inside[:, 1:], solved.angles_rad[:, 1:], atol=1e-9)


def test_missing_markers_are_bridged_held_and_reported(truth):
    def change(positions):
        positions[np.random.default_rng(1).random(positions.shape[:2]) < 0.3] = np.nan
        positions[:10] = positions[80:110] = np.nan

    motion = damaged(truth, change)
    seen = np.r_[10:80, 110:200]
    assert np.median(angle_errors_deg(truth, motion)[seen]) <= 3
    gone = np.isin(motion.report.status[seen], (BRIDGED, MISSING)).mean(axis=0)
    np.testing.assert_allclose(gone, 0.3, atol=0.12)
    assert (motion.report.longest_gap() >= 30).all() and len(motion) == 200
    np.testing.assert_array_equal(motion.angles_rad[0], motion.angles_rad[9])
    assert np.isnan(motion.report.error_m[80:110]).all()


def test_recordings_without_markers_or_of_another_person_are_refused(truth):
    for markers, static, message in (
        (replace(truth.moving, positions=np.full_like(truth.moving.positions, np.nan)), None, "no frame"),
        (truth.moving, synthesise(5, 20, body=0).static, "another person"),
    ):
        with pytest.raises(CloudError, match=message):
            solve(markers, static)


def test_swapped_and_ghost_markers_are_detected(truth, solved):
    left, right, ghost = (plug_in_gait().names.index(n) for n in ("LKNE", "RKNE", "LWRA"))

    def change(positions):
        positions[60:90, [left, right]] = positions[60:90, [right, left]]
        positions[100:120, ghost] += [0, 0, 400]

    motion = damaged(truth, change)
    swapped, ghosts = motion.report.status == SWAPPED, motion.report.status == GHOST
    assert swapped[60:90, [left, right]].all() and swapped.sum() == 60
    assert ghosts[100:120, ghost].all() and ghosts.sum() == 20
    worse = joint_errors_deg(solved.angles_rad, motion.angles_rad)
    assert np.median(worse) < 1 and np.quantile(worse, 0.99) < 15


def bvh_of(angles_rad, pelvis_m, bones):
    """Our joints as a BVH in centimetres, y up; every joint keeps its own frame, turned to y up."""
    y_up, order = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), []

    def node(j):
        order.append(j)
        offset = "OFFSET {:.6f} {:.6f} {:.6f} CHANNELS".format(*(100 * y_up @ bones[j]))
        kind, channels = ("JOINT", 3) if j else ("ROOT", "6 Xposition Yposition Zposition")
        below = "".join(node(c) for c in range(N_JOINTS) if JOINTS[c].parent == j)
        below = below or "End Site { OFFSET 0 -8 0 } "
        return f"{kind} {JOINTS[j].name} {{ {offset} {channels} Zrotation Xrotation Yrotation {below}}} "

    text = f"HIERARCHY\n{node(0)}\nMOTION\nFrames: {len(angles_rad)}\nFrame Time: 0.01\n"
    for angles, pelvis in zip(angles_rad, pelvis_m, strict=True):
        turns = Rotation.from_matrix(y_up @ rotations(angles)[order] @ y_up.T).as_euler("ZXY", degrees=True)
        text += " ".join(f"{v:.6f}" for v in (*(100 * y_up @ pelvis), *turns.ravel())) + "\n"
    return text


def test_a_bvh_of_the_skeleton_gives_back_its_angles(tmp_path):
    truth = synthesise(2, 40)
    bones = zero_bones(shipped_bodies()[3].joints_m)
    (tmp_path / "a.bvh").write_text(bvh_of(truth.angles_rad, truth.pelvis_m, bones))
    markers, places = read_bvh(tmp_path / "a.bvh")
    motion = solve(markers, markerset=places)
    for joint in ("left_knee", "right_knee", "left_elbow", "right_elbow"):
        assert np.median(angle_errors_deg(truth, motion)[:, JOINT_ID[joint], 0]) < 4


def test_bridges_are_straight_and_short():
    line = np.arange(12.0)[:, None, None] * [1.0, 2.0, 3.0] * np.ones((1, 2, 1))
    broken = line.copy()
    broken[3:6, 0] = np.nan
    broken[2:9, 1] = np.nan
    filled, status = bridge(broken, 3)
    np.testing.assert_allclose(filled[:, 0], line[:, 0])
    assert np.isnan(filled[2:9, 1]).all()
    assert (status[3:6, 0] == BRIDGED).all() and (status[2:9, 1] == MISSING).all()


def test_shoulder_passes_the_lock_of_its_euler_angles():
    """An arm held out sideways and swept forwards: its flexion is undefined at the start."""
    markerset = plug_in_gait()
    subject = Template.of(markerset).subject(Template.of(markerset).shape(1.0))
    angles = np.zeros((N_JOINTS, 3))
    angles[JOINT_ID["left_shoulder"], 1] = np.pi / 2
    state = State.of(angles, np.zeros(3))
    shoulder = JOINT_ID["left_shoulder"]
    start = state.local[shoulder].copy()
    for sweep in np.radians(np.arange(2, 80, 2)):
        turned = state.local.copy()
        turned[shoulder] = Rotation.from_rotvec([0, 0, -sweep]).as_matrix() @ start
        goal = markers_at(State(np.zeros(3), state.signed_rad, turned), subject)
        observed = Observed(goal, np.ones(len(goal)))
        state, _ = fit_posture(state, subject, observed, posture_prior(200, 20), steps=15)
        found = rotations(state.angles_rad)[shoulder]
        assert Rotation.from_matrix(found.T @ turned[shoulder]).magnitude() < np.radians(2)


def test_a_motion_strides_with_the_legs_of_its_body(solved):
    small, tall = shipped_bodies()[0], shipped_bodies()[7]
    ratio = solved.posture(3, tall).pelvis_m / solved.posture(3, small).pelvis_m
    assert np.ptp(ratio) < 1e-9 and ratio[0] > 1.2
    np.testing.assert_array_equal(solved.posture(3, tall).angles_rad, solved.angles_rad[3])


REAL = [
    ("pycgm_Movement_trial.c3d", "pycgm_Static_trial.c3d", 15, 25),
    ("STS1.trc", "static1.trc", 20, 25),
    ("nim_cmu_02_05.c3d", None, 20, 25),
    ("nim_squat.c3d", None, 20, 25),
    ("ktk_kinematics_tennis_serve.c3d", None, 20, 25),
]


@pytest.mark.parametrize(("name", "static", "median_mm", "rms_mm"), REAL)
def test_real_recordings(shared_data, name, static, median_mm, rms_mm):
    folder = shared_data / "mocap"
    whole = read_markers(folder / name)
    standing = read_markers(folder / static) if static else None
    motion = solve(replace(whole, positions=whole.positions[100:400]), standing)
    assert motion.report.median_mm <= median_mm / 3
    assert motion.report.rms_mm <= rms_mm / 2
    assert motion.report.count(GHOST).sum() <= 20 and motion.report.count(SWAPPED).sum() == 0
    up = np.array([rotations(a)[0][:, 2] for a in motion.angles_rad[::50]])
    assert (up[:, 2] > 0).mean() > 0.9


def test_a_marker_that_slides_on_its_bone_counts_for_less(truth, solved):
    time, heel = np.arange(200) / 10, plug_in_gait().names.index("LHEE")
    slide = 40 * np.stack([np.sin(time), np.cos(time), np.sin(1.3 * time)], axis=1)
    motion = damaged(truth, lambda positions: np.add.at(positions, np.s_[:, heel], slide))
    assert [line.split()[0] for line in motion.report.assumed] == ["LHEE"] and not solved.report.assumed
    ankle = JOINT_ID["left_ankle"]
    assert np.sqrt(np.mean(angle_errors_deg(truth, motion)[:, ankle, 0] ** 2)) < 4


def test_joint_angles_of_a_laboratory(shared_data):
    """Plug-in-Gait's own angles in the recording, after a constant offset.

    Its thigh markers are 40 degrees off to the front, by which its knees seem to abduct by 60 degrees. So its
    formulas are compared: of the recorded markers, and of those on the solved body.
    """
    trial, static = (read_markers(shared_data / f"mocap/pycgm_{n}_trial.c3d") for n in ("Movement", "Static"))
    at = columns(trial.labels, trial.positions)
    for side in "LR":
        lab = np.stack([at[f"{side}{joint}Angles"][:, 0] for joint in LEG], axis=1)
        assert (PlugInGait(trial, side).flexion_deg(at) - lab).std(axis=0).max() < 1e-3
    for plain, formula in errors_deg(trial, static).values():
        assert (formula < 2).all() and (plain < (0.7, 5.6, 3.1)).all()


def test_command(tmp_path, truth):
    from tests.helpers.marker_samples import write_trc

    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(cli.verbs.motion.solve)
    path = tmp_path / "a.trc"
    write_trc(path, truth.moving.positions[:20, :10] / 1000)
    result = CliRunner().invoke(app, [str(path), "--out", str(tmp_path / "m.npz"), "--json"])
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    assert said["frames"] == 20 and {"marker_median_mm", "marker_rms_mm", "frames_per_second"} <= said.keys()
    again = CliRunner().invoke(app, [str(path), "--out", str(tmp_path / "m.npz")])
    assert isinstance(again.exception, ExistsError)
    assert len(load_motion(tmp_path / "m.npz")) == 20
