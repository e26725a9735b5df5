"""Marker sets: places of names on the body, shipped and from files."""

import re

import numpy as np
import pytest

from sensors.errors import CloudError, FormatError
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.markers.solve import solve
from synth.motion_files.marker_files import Markers
from synth.motion_files.marker_set import choose_marker_set, key_of, load_marker_set, shipped_marker_sets
from synth.motion_files.vertical_axis import GIVEN, Upward
from tests.helpers.marker_truth import worn

UP = Upward("z", GIVEN)
PELVIS_M = np.array([0.0, 0.0, 0.93])


def test_shipped_sets_are_symmetric_and_name_each_marker_once():
    sizes = {s.name: len(s.names) for s in shipped_marker_sets()}
    assert {"plug_in_gait": 39, "cmu_41": 41, "vicon_53": 53}.items() <= sizes.items()
    for markerset in shipped_marker_sets():
        places = dict(zip(markerset.names, markerset.at_m, strict=True))
        for name, place in places.items():
            twin = ("R" if name[0] == "L" else "r" if name[0] == "l" else "") + name[1:]
            if name[0] in "Ll" and twin in places:
                np.testing.assert_allclose(places[twin], place * [-1, 1, 1])
        own = {key_of(name) for name in markerset.names}
        others = [key_of(name) for spellings in markerset.also.values() for name in spellings]
        assert len(set(others)) == len(others) and not own & set(others), markerset.name
    for label in ("Derrick:L_ASIS", "l.asis", "L-ASIS ", "SUBJ:x:LASIS"):
        assert key_of(label) == "lasis"


WRITTEN = {
    "opencap_43": """C7_study r_shoulder_study L_shoulder_study r.ASIS_study L.ASIS_study r.PSIS_study
        L.PSIS_study r_knee_study L_knee_study r_mknee_study r_ankle_study L_mankle_study r_calc_study
        L_toe_study r_5meta_study
        r_lelbow_study L_melbow_study r_lwrist_study L_mwrist_study r_thigh1_study L_thigh3_study r_sh1_study
        L_sh3_study RHJC_study LHJC_study RHip RKnee LHip LKnee RShoulder LShoulder Neck Head Nose""",
    "key_points": """Hip RHip RKnee RAnkle RBigToe RSmallToe RHeel LHip LKnee LAnkle LBigToe Neck Head Nose
        RShoulder RElbow RWrist LShoulder LElbow LWrist""",
    "key_points ": """nose left_eye right_ear left_shoulder right_shoulder left_elbow right_wrist
        left_hip right_hip left_knee right_ankle""",
    "landmarks": """L_IAS R_IAS L_IPS R_IPS L_FTC L_FLE L_FME L_FAX L_TTC L_FAL L_TAM L_FCC L_FM1 L_FM5 R_FLE
        R_FAL""",
    "landmarks ": "LASIS RASIS LPSIS RPSIS LLEK RLEK LMEK LLM RLM LHEE LTOE LMT5 SACR XYPH LLEE LMEE",
    "motive_qualisys": """Q_HeadL Q_HeadR Q_HeadFront Q_Chest Q_SpineThoracic2 Q_LShoulderTop Q_LElbowOut
        Q_LWristIn Q_WaistLFront Q_WaistRFront Q_WaistBack Q_LKneeOut Q_RKneeOut Q_LAnkleOut Q_RForefoot5""",
    "motive_qualisys ": """Skeleton~001_HeadTop Skeleton~001_BackTop Skeleton~001_Chest
        Skeleton~001_WaistLFront Skeleton~001_WaistRBack Skeleton~001_LElbowOut Skeleton~001_LKneeOut
        Skeleton~001_RKneeOut Skeleton~001_LAnkleOut Skeleton~001_LToeOut""",
    "motive_numbered": """Skeleton_Hip1 Skeleton_Hip2 Skeleton_Hip3 Skeleton_Hip4 Skeleton_Chest1
        Skeleton_Chest2 Skeleton_Head1 Skeleton_LUArm1 Skeleton_RUArm1 Skeleton_LHand1 Skeleton_LThigh1
        Skeleton_RThigh1 Skeleton_LShin1 Skeleton_RShin_2 Skeleton_LFoot1 Skeleton_LFoot_3""",
    "plug_in_gait": """251112_KUO_LASI 251112_KUO_RASI 251112_KUO_LPSI 251112_KUO_RPSI 251112_KUO_LTHI
        251112_KUO_LKNE 251112_KUO_RKNE 251112_KUO_LANK 251112_KUO_RBAK 251112_KUO_C7""",
}


@pytest.mark.parametrize("name", WRITTEN)
def test_labels_as_programs_write_them_choose_their_set(name):
    labels = tuple(label.replace("~", " ") for label in WRITTEN[name].split())
    markerset = choose_marker_set(labels)
    assert markerset.name == name.strip()
    places = [place for place in markerset.columns(labels) if place is not None]
    assert len(places) == len(set(places)) >= len(labels) - 6


@pytest.mark.parametrize("markerset", shipped_marker_sets(), ids=lambda s: s.name)
def test_every_shipped_set_bends_the_knee_that_is_bent(markerset):
    angles = np.zeros((12, N_JOINTS, 3))
    angles[:, JOINT_ID["left_knee"], 0] = -np.radians(np.linspace(0, 60, 12))
    angles[:, JOINT_ID["right_elbow"], 0] = np.radians(np.linspace(10, 80, 12))
    markers = Markers(markerset.names, worn(markerset, angles, PELVIS_M, 1.05), 30, "m", UP)
    motion = solve(markers, markerset=markerset)
    for joint in ("left_knee", "right_knee", "right_elbow", "left_elbow"):
        bent, true = (np.degrees(a[:, JOINT_ID[joint], 0]) for a in (motion.angles_rad, angles))
        assert np.abs((bent - bent.mean()) - (true - true.mean())).max() < 6, joint


BONES = {
    "Head": "HeadTop HeadFront HeadSide", "Chest": "SpineTop Chest BackL BackR",
    "Hip": "WaistLFront WaistRFront WaistLBack WaistRBack", "LShoulder": "LShoulderBack LShoulderTop",
    "LUArm": "LArm LElbowOut", "LHand": "LWristIn LWristOut LHandOut", "LThigh": "LThigh LKneeOut",
    "LShin": "LShin LAnkleOut", "LFoot": "LHeelBack LForefoot5 LForefoot1 LToeTip",
}  # fmt: skip


BONES |= {f"R{b[1:]}": re.sub(r"\bL", "R", own) for b, own in BONES.items() if b[0] == "L"}


def test_markers_that_name_their_bones_alone_move_the_limbs_all_the_same():
    places = next(s for s in shipped_marker_sets() if s.name == "motive_qualisys")
    angles, wave = np.zeros((30, N_JOINTS, 3)), np.arange(30) / 5
    for side, sign in (("left", 1), ("right", -1)):
        angles[:, JOINT_ID[f"{side}_hip"], 0] = 0.3 * sign * np.sin(wave)
        angles[:, JOINT_ID[f"{side}_knee"], 0] = -0.5 - 0.4 * sign * np.sin(wave + 1)
        angles[:, JOINT_ID[f"{side}_elbow"], 0] = 0.6 + 0.4 * sign * np.sin(wave)
        angles[:, JOINT_ID[f"{side}_shoulder"], 1] = 0.3
    angles[:, 0, 2] = 2 + 0.3 * np.sin(wave)
    labels = tuple(f"Skeleton_{b}{i}" for b, own in BONES.items() for i in range(1, len(own.split()) + 1))
    columns = [places.names.index(name) for own in BONES.values() for name in own.split()]
    motion = solve(Markers(labels, worn(places, angles, PELVIS_M, 1.03)[:, columns], 30, "m", UP))
    assert "constant" in motion.report.assumed[0] and motion.report.rms_mm < 4
    for joint, most in (("left_knee", 2), ("right_hip", 2), ("right_elbow", 3), ("pelvis", 2)):
        axis = 2 if joint == "pelvis" else 0
        off = np.degrees(motion.angles_rad[:, JOINT_ID[joint], axis] - angles[:, JOINT_ID[joint], axis])
        assert np.abs(off - off.mean()).max() < most and abs(off.mean()) < 9, joint


def test_any_marker_set_from_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('[markers]\nKneeOutL = { joint = "left_knee", at_m = [0.05, 0, 0], weight = 2 }\n')
    found = load_marker_set(path)
    assert found.name == "mine" and found.names == ("KneeOutL",) and found.weight[0] == 2
    for bad in (
        "[markers]",
        "x = 1",
        '[markers]\na = { joint = "tail", at_m = [0, 0, 0] }',
        "[markers]\na = 3",
        "][",
        "a = " + "[" * 9999,
        "markers." + "a." * 99 + "a = 1",
        '[markers]\na = { joint = "left_knee", at_m = [0, 0, 0], weight = 1' + "0" * 400 + " }",
        '[markers]\na = { joint = "left_knee", at_m = [0, nan, 0] }',
        '[markers]\na = { joint = "left_knee", at_m = [0, 0, 0], also = "b" }',
        '[markers]\na = { joint = "left_knee", at_m = [0, 0, 0], also = ["A."] }',
    ):
        path.write_text(bad)
        with pytest.raises(FormatError, match="mine"):
            load_marker_set(path)
    with pytest.raises(CloudError, match="unknown markers"):
        choose_marker_set(("nose", "tail", "wing"))
