"""Skeletons as other programs write them: names, position channels, defects, and joints in .npz files."""

import numpy as np
import pytest

from sensors.errors import CloudError, FormatError
from synth.body.skeleton import JOINT_ID
from synth.markers.solve import solve, solve_takes
from synth.motion.library import read_repertoire
from synth.motion_files.bvh import LEG_M, read_bvh
from synth.motion_files.joint_file import SMPL_JOINTS, SMPL_PARENTS, joints_of_rotations, read_joint_file
from synth.motion_files.marker_set import known_markers
from tests.helpers.walker import JOINTS, bvh_of, places_cm

PLACE = {
    "Hips": "pelvis", "Neck": "neck", "Head": "head", "Top": "head_end", "LeftShoulder": "left_clavicle",
    "LeftArm": "left_shoulder", "LeftForeArm": "left_elbow", "LeftHand": "left_wrist",
    "LeftUpLeg": "left_hip", "LeftLeg": "left_knee", "LeftFoot": "left_ankle", "LeftToeBase": "left_toe",
}  # fmt: skip
PLACE |= {name.replace("Left", "Right"): place.replace("left", "right") for name, place in PLACE.items()}
"""Our place at each of the walker's joints that has one."""
LEG_CM = 82.0


def file_of(path, **options):
    path.write_text(bvh_of(**options))
    return path


def assert_walks(markers, places):
    """Every joint is at the walker's, up to a turn about the vertical."""
    known = known_markers(markers, places)
    truth = places_cm() * LEG_M / LEG_CM
    columns = [JOINTS.index(name) for name in PLACE if PLACE[name] in places.names]
    assert len(columns) >= 20
    ours = known.positions_m[:, [places.names.index(PLACE[JOINTS[i]]) for i in columns]]
    theirs = truth[:, columns]
    np.testing.assert_allclose(ours[..., 2], theirs[..., 1], atol=2e-4)
    for origin in (0, 3):
        away = [np.linalg.norm(p - p[:1, origin : origin + 1], axis=2) for p in (ours, theirs)]
        np.testing.assert_allclose(*away, atol=3e-3)
    left = np.cross(theirs[0, 2] - theirs[0, 0], theirs[-1, 0] - theirs[0, 0]) @ (theirs[0, 8] - theirs[0, 0])
    mine = np.cross(ours[0, 2] - ours[0, 0], ours[-1, 0] - ours[0, 0]) @ (ours[0, 8] - ours[0, 0])
    assert np.sign(left) == np.sign(mine), "left and right are exchanged"


POSITIONS = {
    "root": "",
    "replace": "positions of 20 joints beside the root replace",
    "some": "positions of 5 joints beside the root replace",
    "add": "positions of 20 joints beside the root are added",
    "zero": "",
}


@pytest.mark.parametrize("style", POSITIONS)
def test_position_channels_replace_the_offset_unless_they_are_displacements(tmp_path, style):
    markers, places = read_bvh(file_of(tmp_path / "a.bvh", positions=style))
    assert_walks(markers, places)
    assert POSITIONS[style] in "; ".join(markers.assumed)


LIMBS = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")
MIXAMO = " ".join(LIMBS)
UPPER = "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0"
SMPL = "Collar Shoulder Elbow Wrist Hip Knee Ankle Foot"
VRM = "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot ToeBase"
SMPL_TRUNK = "Hips=Pelvis Spine=Spine1 Chest=Spine3"
METARIG = "Hips=hips Spine=spine.001 Chest=spine.003 Neck=spine.004 Head=spine.006"
KINECT = "Clavicle Shoulder Elbow Wrist Hip Knee Ankle Foot"
RIGIFY = "shoulder upper_arm forearm hand thigh shin foot toe"
SCAPULA = "Scapula Shoulder Elbow Wrist Hip Knee Ankle Toes"
DIALECTS = {
    "Xsens": ("Left% Right% %", "Collar Shoulder Elbow Wrist Hip Knee Ankle Toe", ""),
    "SMPL": ("L_% R_% %", SMPL, SMPL_TRUNK),
    "AIST": ("left_% right_% %", SMPL.lower(), "Hips=root"),
    "Biped": ("Bip01~L~% Bip01~R~% Bip01~%", UPPER, "Hips=Pelvis"),
    "Valve": ("ValveBiped.Bip01_L_% ValveBiped.Bip01_R_% ValveBiped.Bip01_%", UPPER, "Hips=Pelvis"),
    "Mixamo": ("mixamorig:Left% mixamorig:Right% mixamorig:%", MIXAMO, ""),
    "Mixamo without colon": ("mixamorigLeft% mixamorigRight% mixamorig%", MIXAMO, ""),
    "Mixamo numbered": ("mixamorig1:Left% mixamorig1:Right% mixamorig1:%", MIXAMO, ""),
    "MotionBuilder": ("Character1_Left% Character1_Right% Character1_%", MIXAMO, ""),
    "Unreal": (
        "%_l %_r %",
        "clavicle upperarm lowerarm hand thigh calf foot ball",
        "Hips=pelvis Neck=neck_01",
    ),
    "Bandai Namco": ("%_L %_R %", VRM.replace("ToeBase", "Toes"), ""),
    "Rokoko": ("Left% Right% %", "Shoulder Arm ForeArm Hand Thigh Shin Foot Toe", ""),
    "MVN": ("Left% Right% %", VRM.replace("LowerArm", "ForeArm"), "Hips=Pelvis"),
    "Daz": ("l% r% %", "Collar Shldr ForeArm Hand Thigh Shin Foot Toe", "Hips=hip"),
    "Motive": ("A_L% A_R% A_%", "Shoulder UArm FArm Hand Thigh Shin Foot Toe", "Hips=Hip"),
    "Kinect": ("%Left %Right %", KINECT, "Hips=SpineBase"),
    "VRM": ("J_Bip_L_% J_Bip_R_% J_Bip_C_%", VRM, ""),
    "Rigify": ("DEF-%.L DEF-%.R DEF-%", RIGIFY, ""),
    "Rigify's metarig": ("%.L %.R %", RIGIFY, METARIG),
    "DeepMotion": ("l_%_JNT r_%_JNT %_JNT", "shoulder arm forearm hand upleg leg foot toebase", ""),
    "AdvancedSkeleton": ("%_L %_R %_M", SCAPULA, "Hips=Root"),
}
"""Patterns of left, right and middle names (~: a blank), names of the limbs' joints, and of the trunk's."""


def mapped(patterns, limbs, trunk):
    """Names of the walker's joints in a dialect."""
    own = dict(zip(LIMBS, limbs.split(), strict=True)) | dict(pair.split("=") for pair in trunk.split())
    left, right, middle = patterns.split()

    def name(joint):
        side = next((side for side in ("Left", "Right") if joint.startswith(side)), "")
        bare = joint.removeprefix(side)
        pattern = {"Left": left, "Right": right, "": middle}[side]
        return pattern.replace("%", own.get(bare, bare)).replace("~", " ")

    return name


@pytest.mark.parametrize("dialect", DIALECTS)
def test_names_of_other_programs(tmp_path, dialect):
    assert_walks(*read_bvh(file_of(tmp_path / "a.bvh", names=mapped(*DIALECTS[dialect]))))


def row_count(text, stated):
    return text.replace("Frames: 24", f"Frames: {stated}")


DEFECTS = {
    "Latin-1": (lambda t: t.replace("Spine", "Hüfte").encode("latin-1"), "Latin-1"),
    "UTF-16": (lambda t: t.encode("utf-16"), ""),
    "decimal commas": (lambda t: t.replace(".", ","), ""),
    "one frame too many stated": (lambda t: row_count(t, 25), "states 25 and holds 24"),
    "one frame too few stated": (lambda t: row_count(t, 23), "states 23 and holds 24"),
    "CRLF": (lambda t: t.replace("\n", "\r\n"), ""),
    "a line above": (lambda t: "# exported by hand\n" + t, ""),
    "capitals": (lambda t: t.replace("HIERARCHY", "Hierarchy").replace("MOTION", "Motion"), ""),
    "the end of a DOS file": (lambda t: t + "\n\x1a", ""),
    "a blank before the colons": (lambda t: t.replace("Frames:", "Frames :").replace("Time:", "Time :"), ""),
    "a joint named MOTION": (lambda t: t.replace("JOINT Spine", "JOINT MOTION Spine"), ""),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_bvh_with_defects_is_read_and_what_was_assumed_is_named(tmp_path, defect):
    change, note = DEFECTS[defect]
    changed = change(bvh_of())
    (tmp_path / "a.bvh").write_bytes(changed if isinstance(changed, bytes) else changed.encode())
    markers, places = read_bvh(tmp_path / "a.bvh")
    assert_walks(markers, places)
    assert note in "; ".join(markers.assumed)


def test_a_cut_bvh_is_read_to_its_last_whole_frame(tmp_path):
    text = bvh_of()
    (tmp_path / "a.bvh").write_text(text[: int(0.97 * len(text))])
    markers, _ = read_bvh(tmp_path / "a.bvh")
    whole, _ = read_bvh(file_of(tmp_path / "b.bvh"))
    np.testing.assert_array_equal(markers.positions, whole.positions[: len(markers.positions)])
    assert 20 < len(markers.positions) < 24 and "cut off" in markers.assumed[0]


def test_a_folder_of_motions_names_what_was_assumed_once(tmp_path):
    for name in ("a", "b"):
        file_of(tmp_path / f"{name}.bvh", positions="replace" if name == "a" else "root")
    lines = read_repertoire(tmp_path).assumed
    assert any("replace" in line and "(1 of 2 files)" in line for line in lines)
    assert any("no unit" in line and "(2 of 2 files)" in line for line in lines)


def test_rows_of_other_than_the_channels_are_refused(tmp_path):
    head, _, rows = bvh_of().partition("0.033333\n")
    (tmp_path / "a.bvh").write_text(head + "0.033333\n" + rows.replace("\n", " 1.0\n"))
    with pytest.raises(FormatError, match="24 frames of 66 finite numbers and holds 1608"):
        read_bvh(tmp_path / "a.bvh")


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


LIMB_OF = dict(zip(("shoulder", "elbow", "wrist", "hip", "knee", "ankle"), LIMBS[1:7], strict=True))
COCO = "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow "
COCO += "left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle"


def test_key_points_without_parents_are_joints(tmp_path):
    at = dict(zip(JOINTS, np.moveaxis(places_cm(), 1, 0), strict=True))
    face = {"nose": (0, 5, 11), "left_eye": (3, 8, 9), "left_ear": (7, 6, 0)}
    face |= {"right_eye": (-3, 8, 9), "right_ear": (-7, 6, 0)}
    names = COCO.split()
    take = [
        at["Head"] + face[n] if n in face else at[n.split("_")[0].capitalize() + LIMB_OF[n.split("_")[1]]]
        for n in names
    ]
    path = saved(tmp_path / "coco.npz", joint_names=np.array(names), walk=np.stack(take, axis=1))
    takes, places = read_joint_file(path)
    known = known_markers(takes["walk"], places)
    truth = places_cm()[:, JOINTS.index("LeftLeg"), 1] / 100
    np.testing.assert_allclose(known.positions_m[:, places.names.index("left_knee"), 2], truth, atol=1e-9)
    assert {"nose", "left_eye", "right_ear"} <= set(places.names)
    motion = solve_takes(takes, places)["walk"]
    assert motion.report.median_mm < 10
    assert np.ptp(motion.pelvis_m, axis=0).max() == pytest.approx(1.61, abs=0.05)


def test_the_hand_of_a_short_wrist_bone_is_the_wrist_and_smpls_is_not(tmp_path):
    at = places_cm()
    names = [name.replace("Left", "l").replace("Right", "r").lower() for name in JOINTS]
    names = [
        {"larm": "lhumerus", "lforearm": "lradius", "lupleg": "lfemur", "lleg": "ltibia"}.get(n, n)
        for n in names
    ]
    hand, elbow = JOINTS.index("LeftHand"), JOINTS.index("LeftForeArm")
    for short, wrist in ((0.08, "lhand"), (0.4, "lwrist")):
        bend = at[:, hand] + short * (at[:, elbow] - at[:, hand])
        takes = {"walk": np.concatenate([at, bend[:, None]], axis=1)}
        takes, places = read_joint_file(
            saved(tmp_path / "a.npz", joint_names=np.array([*names, "lwrist"]), **takes)
        )
        found = takes["walk"].positions[:, places.names.index("left_wrist")]
        np.testing.assert_array_equal(found, bend if wrist == "lwrist" else at[:, hand])


def test_a_reference_above_the_hips_and_props_beside_them_change_nothing(tmp_path):
    text = bvh_of(positions="replace").replace("ROOT Hips", "JOINT Hips")
    hierarchy, _, motion = text.partition("MOTION")
    channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
    sword = "JOINT Sword\n{\nOFFSET 150 100 600\n" + channels + "End Site\n{\nOFFSET 0 0 30\n}\n}\n"
    root = "ROOT Reference\n{\nOFFSET 0 0 0\n" + channels
    head, rows = motion.split("0.033333\n")
    rows = "".join(
        f"0 0 0 0 0 0 {row} 151 101 {600 + 6 * i} 0 0 0\n" for i, row in enumerate(rows.splitlines())
    )
    body = root + hierarchy.removeprefix("HIERARCHY\n") + sword + "}\n"
    (tmp_path / "a.bvh").write_text(f"HIERARCHY\n{body}MOTION{head}0.033333\n{rows}")
    assert_walks(*read_bvh(tmp_path / "a.bvh"))


def amass(turn_x, **more):
    """Arrays of an AMASS file: a person lifts the left thigh by 50 degrees, by SMPL's own zero pose."""
    poses, trans = np.zeros((8, 156)), np.tile([0.3, -0.2, 0.9], (8, 1))
    poses[:, 0] = np.radians(turn_x)
    poses[:, 3] = -np.radians(np.linspace(0, 50, 8))
    trans[:, 0] += np.linspace(0, 1, 8)
    for joint, sign in ((16, -1), (17, 1)):
        poses[:, 3 * joint + 2] = sign * np.radians(80)
    return {"poses": poses, "trans": trans, "mocap_framerate": 120.0, "gender": "female", **more}


def test_rotations_of_amass_are_read_without_a_body_model(tmp_path):
    path = saved(tmp_path / "walk_poses.npz", **amass(90))
    takes, places = read_joint_file(path)
    (markers,) = takes.values()
    assert markers.frames_per_second == 120 and "SMPL's rotations" in markers.assumed[0]
    motion = solve(markers, markerset=places)
    hip = np.degrees(motion.angles_rad[:, JOINT_ID["left_hip"], 0])
    np.testing.assert_allclose(hip - hip[0], np.linspace(0, 50, 8), atol=2)
    assert np.abs(np.degrees(motion.angles_rad[:, JOINT_ID["right_hip"], 0])).max() < 8


def test_joints_without_names_are_smpls_by_their_number(tmp_path):
    takes, places = read_joint_file(
        saved(
            tmp_path / "named.npz", joint_names=np.array(SMPL_JOINTS), parents=SMPL_PARENTS, a=smpl_places()
        )
    )
    counted, same = read_joint_file(saved(tmp_path / "b.npz", joints=smpl_places()))
    assert same.names == places.names and "SMPL's, in SMPL's order" in counted["joints"].assumed[0]
    np.testing.assert_array_equal(counted["joints"].positions, takes["a"].positions)
    for shape in ((8, 17, 3), (8, 24, 2), (24, 3)):
        with pytest.raises(CloudError, match="joint_names"):
            read_joint_file(saved(tmp_path / "c.npz", joints=np.ones(shape)))
    with pytest.raises(CloudError, match="trans"):
        read_joint_file(saved(tmp_path / "c.npz", poses=np.zeros((8, 156))))


def smpl_places():
    body = joints_of_rotations(amass(0)["poses"], amass(0)["trans"])
    hands = body[:, 20:] + 0.4 * (body[:, 20:] - body[:, 18:20])
    return np.concatenate([body, hands], axis=1)
