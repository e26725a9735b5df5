"""Marker files: what is read is what was written, and what is damaged is one clear error."""

import re
import struct
import warnings
from pathlib import Path

import c3d
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sensors.errors import CloudError, FormatError
from synth.body.body import shipped_bodies
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.markers.kinematics import State, Subject, markers_at
from synth.markers.person_fit import zero_bones
from synth.markers.solve import solve
from synth.motion_files import bvh, marker_files
from synth.motion_files.bvh import read_bvh
from synth.motion_files.marker_files import Markers, read_markers
from synth.motion_files.marker_set import (
    choose_marker_set,
    key_of,
    known_markers,
    load_marker_set,
    shipped_marker_sets,
)
from synth.motion_files.vertical_axis import GIVEN, Upward
from tests.helpers.c3d_bytes import PROCESSORS, C3d
from tests.helpers.marker_samples import NAMES, bvh_text, positions, write_c3d, write_trc

UP = Upward("z", GIVEN)
MUTATIONS = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


FEW = positions(7) * 1000
ANALOG = np.arange(42.0).reshape(7, 6)
SHORT = list(NAMES)
C3D_DEFECTS = {
    "none": ({}, ""),
    "words": ({"scale": 0.1}, ""),
    "parameter twice": (
        {"parameters": [("POINT", "USED", 10), ("POINT", "USED", 10)]},
        "POINT:USED is there 2",
    ),
    "labels twice": (
        {"parameters": [("POINT", "LABELS", ["a"]), ("POINT", "LABELS", SHORT)]},
        "LABELS is there 2",
    ),
    "analog": ({"analog": ANALOG, "scale": 0.1}, ""),
    "fewer analog in the header": ({"analog": ANALOG, "header": {"analog": 4}}, "analog values a frame"),
    "no analog in the parameters": (
        {"analog": ANALOG, "parameters": [("ANALOG", "USED", 0)]},
        "0 and 6; 6 fits",
    ),
    "analog rate": ({"analog": ANALOG, "parameters": [("ANALOG", "RATE", 1000.0)]}, "60 and 6; 6 fits"),
    "scale of the header": ({"scale": 0.1, "header": {"scale": 0.2}}, "scale: the file states 0.1 and 0.2"),
    "words by the header": ({"header": {"scale": 0.1}}, "numbers as floats"),
    "words by the parameters": ({"parameters": [("POINT", "SCALE", 0.1)]}, "numbers as floats"),
    "last frame": ({"lost_frames": 1}, "1 of 7 frames are missing"),
    "last frame, no padding": ({"lost_frames": 1, "padded": False}, "1 of 7 frames are missing"),
    "parameters elsewhere": ({"gap": 1024}, ""),
    "data elsewhere": ({"parameters": [("POINT", "DATA_START", 9)]}, "start of the data"),
    "data elsewhere by the header": ({"header": {"data_block": 9}}, "start of the data"),
    "fewer points in the header": ({"header": {"points": 8}}, "points: the file states 10 and 8; 10 fits"),
    "other rate": ({"header": {"rate": 50.0}}, "frames a second: the file states 100 and 50"),
    "other frames": ({"parameters": [("POINT", "FRAMES", 5)]}, "frames: the file states 7 and 5; 7 fits"),
    "nothing stated": ({"parameters": [("POINT", n, None) for n in ("USED", "SCALE", "RATE", "FRAMES")]}, ""),
}


@pytest.mark.parametrize("processor", PROCESSORS)
@pytest.mark.parametrize("defect", C3D_DEFECTS)
def test_c3d_with_defects_is_read_and_what_was_assumed_is_named(tmp_path, processor, defect):
    fields, note = C3D_DEFECTS[defect]
    found = read_markers(C3d(FEW, SHORT, processor=processor, **fields).write(tmp_path / "a.c3d"))
    assert found.labels == NAMES and (found.frames_per_second, found.unit) == (100, "mm")
    frames = len(FEW) - fields.get("lost_frames", 0)
    np.testing.assert_allclose(found.positions, FEW[:frames], atol=0.06 if "scale" in fields else 1e-3)
    assert (note in "; ".join(found.assumed)) if note else not found.assumed


def test_points_without_labels_are_numbered(tmp_path):
    for labels, names in ((None, ("1", "2", "3")), (["LASI"], ("LASI", "2", "3"))):
        file = C3d(FEW, SHORT, parameters=[("POINT", "LABELS", labels)])
        found = read_markers(file.write(tmp_path / "a.c3d"))
        assert found.labels[:3] == names and "no label" in found.assumed[0]
        np.testing.assert_allclose(found.positions, FEW, atol=1e-3)


def test_a_c3d_without_readable_parameters_is_read_by_its_header(tmp_path):
    data = bytearray(C3d(FEW, SHORT).write(tmp_path / "a.c3d").read_bytes())
    data[512 + 3] = 0
    (tmp_path / "a.c3d").write_bytes(data)
    found = read_markers(tmp_path / "a.c3d")
    np.testing.assert_allclose(found.positions, FEW, atol=1e-3)
    assert "no parameters" in found.assumed[0]


def test_real_files_are_read_as_the_c3d_library_reads_them(shared_data):
    for path in (shared_data / "mocap").glob("*.c3d"):
        found = read_markers(path)
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader = c3d.Reader(file)
            frames = [np.where(p[:, 3:4] < 0, np.nan, p[:, :3]) for _, p, _ in reader.read_frames()]
            labels = tuple(label.strip() for label in reader.point_labels)
        np.testing.assert_array_equal(found.positions, np.array(frames))
        assert found.labels == labels[: len(found.labels)] and not found.assumed


TRC_DEFECTS = {
    "blank lines": (lambda t: t.rstrip("\n") + "\n" * 50, ""),
    "CRLF": (lambda t: t.replace("\n", "\r\n"), ""),
    "comments": (lambda t: "# by hand\n" + t.replace("\n1\t", "\n// here\n1\t"), ""),
    "no trailing tabs": (lambda t: "\n".join(line.rstrip("\t") for line in t.split("\n")), ""),
    "decimal commas": (lambda t: t[: t.index("\n1\t")] + t[t.index("\n1\t") :].replace(".", ","), ""),
    "spaces for tabs": (lambda t: t.replace("\t", "  ").replace("Anna:", ""), ""),
    "words in cells": (
        lambda t: t[: t.index("\n2\t")] + t[t.index("\n2\t") :].replace("\t\t\t", "\tnone\tnan\t"),
        "cells are not numbers",
    ),
    "more frames": (
        lambda t: t.replace("100\t100\t5", "100\t100\t4"),
        "frames: the file states 4 and holds 5",
    ),
    "no rate": (lambda t: t.replace("100\t100\t5", "\t\t5"), "100 follow from the times"),
    "other count": (
        lambda t: t.replace("\t10\tm\t", "\t12\tm\t"),
        "markers: the file states 12 and holds 10",
    ),
    "more numbers": (
        lambda t: t.replace("\n1\t0.0", "\n1\t0.0", 1).rstrip("\n") + "\t7\n",
        "1 frames have more",
    ),
    "text behind": (lambda t: t + "end of recording\n", "1 lines are not frames"),
    "cut": (lambda t: t + t.rstrip("\n").rpartition("\n")[2][:40], "cut off and was left out"),
    "commas for tabs": (lambda t: t.replace("\t", ","), ""),
    "semicolons for tabs": (lambda t: t.replace("\t", ";"), ""),
    "semicolons and decimal commas": (lambda t: t.replace("\t", ";").replace(".", ","), ""),
    "commas and blanks": (lambda t: t.replace("\t", ", "), ""),
    "Frame without a sign": (lambda t: t.replace("Frame#", "Frame"), ""),
    "labels over all columns": (
        lambda t: re.sub(r"(Anna:\w+)\t\t", r"\1\t\1\t\1", t),
        "",
    ),
    "UTF-16": (lambda t: t.encode("utf-16"), ""),
    "no sixth line": (lambda t: t.replace("\n\n", "\n"), ""),
}


@pytest.mark.parametrize("defect", TRC_DEFECTS)
def test_trc_with_defects_is_read_and_what_was_assumed_is_named(tmp_path, defect):
    change, note = TRC_DEFECTS[defect]
    points = np.nan_to_num(positions(), nan=0.5) if defect == "spaces for tabs" else positions()
    write_trc(tmp_path / "a.trc", points)
    text = change((tmp_path / "a.trc").read_text())
    (tmp_path / "a.trc").write_bytes(text if isinstance(text, bytes) else text.encode())
    found = read_markers(tmp_path / "a.trc")
    assert [key_of(label) for label in found.labels] == [key_of(name) for name in NAMES]
    np.testing.assert_allclose(found.positions, points, atol=1e-6)
    assert (note in "; ".join(found.assumed)) if note else not found.assumed
    assert found.frames_per_second == pytest.approx(100)


@pytest.mark.parametrize("stated", [10, 8])
@pytest.mark.parametrize("unnamed", [(3,), (0, 4), (9,), (5, 6)])
def test_a_column_without_a_name_shifts_no_other(tmp_path, unnamed, stated):
    write_trc(tmp_path / "a.trc", positions())
    text = (tmp_path / "a.trc").read_text().replace("\t10\tm\t", f"\t{stated}\tm\t")
    for column in unnamed:
        text = text.replace(NAMES[column], "")
    (tmp_path / "a.trc").write_text(text)
    found = read_markers(tmp_path / "a.trc")
    kept = [column for column in range(len(NAMES)) if column not in unnamed]
    for column in kept:
        at = found.labels.index(NAMES[column])
        np.testing.assert_allclose(found.positions[:, at], positions()[:, column], atol=1e-6)
    assert any("no label" in line or "states" in line or "behind" in line for line in found.assumed)


def test_places_of_zero_are_not_seen_and_files_without_positions_refused(tmp_path):
    points = np.nan_to_num(positions())
    write_trc(tmp_path / "a.trc", points)
    found = read_markers(tmp_path / "a.trc")
    np.testing.assert_allclose(found.positions, positions(), atol=1e-6)
    assert "0, 0, 0" in found.assumed[0]
    write_trc(tmp_path / "a.trc", 0 * points)
    with pytest.raises(FormatError, match="no position"):
        read_markers(tmp_path / "a.trc")
    for nothing in (0 * FEW, np.full_like(FEW, np.nan)):
        with pytest.raises(FormatError, match="no position"):
            read_markers(C3d(nothing, SHORT).write(tmp_path / "a.c3d"))


@pytest.mark.parametrize(
    ("suffix", "write", "unit", "scale"), [("trc", write_trc, "m", 1), ("c3d", write_c3d, "mm", 1000)]
)
def test_marker_files_round_trip(tmp_path, suffix, write, unit, scale):
    write(tmp_path / f"a.{suffix}", positions())
    found = read_markers(tmp_path / f"a.{suffix}")
    assert found.labels == NAMES and found.unit == unit and found.frames_per_second == 100
    np.testing.assert_allclose(found.positions / scale, positions(), atol=1e-6)


def test_bvh_joints_stand_where_the_offsets_put_them(tmp_path):
    (tmp_path / "a.bvh").write_text(bvh_text())
    markers, places = read_bvh(tmp_path / "a.bvh")
    at = dict(zip(markers.labels, np.moveaxis(markers.positions, 1, 0), strict=True))
    scale = 0.82 / 82
    np.testing.assert_allclose(at["left_knee"][0], np.array([10, 50, 0]) * scale)
    np.testing.assert_allclose(at["left_knee"][1], np.array([10, 90, 40]) * scale, atol=1e-12)
    np.testing.assert_allclose(at["head_end"][0], np.array([0, 168, 0]) * scale)
    assert markers.frames_per_second == pytest.approx(100) and places.names == markers.labels


@pytest.mark.parametrize("label", ["Derrick:L_ASIS", "l.asis", "L-ASIS ", "SUBJ:x:LASIS"])
def test_labels_are_one_in_any_spelling(label):
    assert key_of(label) == "lasis"


def test_shipped_sets_are_symmetric_and_complete():
    sets = {s.name: s for s in shipped_marker_sets()}
    assert {"plug_in_gait": 39, "cmu_41": 41, "vicon_53": 53}.items() <= {
        n: len(s.names) for n, s in sets.items()
    }.items()
    for markerset in sets.values():
        places = dict(zip(markerset.names, markerset.at_m, strict=True))
        for name, place in places.items():
            twin = ("R" if name[0] == "L" else "r" if name[0] == "l" else "") + name[1:]
            if name[0] in "Ll" and twin in places:
                np.testing.assert_allclose(places[twin], place * [-1, 1, 1])


def test_other_names_of_a_set_are_no_other_markers():
    for markerset in shipped_marker_sets():
        own = {key_of(name) for name in markerset.names}
        others = [key_of(name) for spellings in markerset.also.values() for name in spellings]
        assert len(set(others)) == len(others) and not own & set(others), markerset.name


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
    known = [
        label for label, place in zip(labels, markerset.columns(labels), strict=True) if place is not None
    ]
    assert len(known) == len(set(markerset.columns(known))) >= len(labels) - 6


@pytest.mark.parametrize("markerset", shipped_marker_sets(), ids=lambda s: s.name)
def test_every_shipped_set_bends_the_knee_that_is_bent(markerset):
    angles, pelvis = np.zeros((12, N_JOINTS, 3)), np.tile([0.0, 0.0, 0.93], (12, 1))
    angles[:, JOINT_ID["left_knee"], 0] = -np.radians(np.linspace(0, 60, 12))
    angles[:, JOINT_ID["right_elbow"], 0] = np.radians(np.linspace(10, 80, 12))
    subject = Subject(zero_bones(shipped_bodies()[7].joints_m), markerset.joint, 1.05 * markerset.at_m)
    at = np.array([markers_at(State.of(a, p), subject) for a, p in zip(angles, pelvis, strict=True)])
    motion = solve(Markers(markerset.names, at, 30, "m", UP), markerset=markerset)
    for joint in ("left_knee", "right_knee", "right_elbow", "left_elbow"):
        bent = np.degrees(motion.angles_rad[:, JOINT_ID[joint], 0])
        true = np.degrees(angles[:, JOINT_ID[joint], 0])
        assert np.abs((bent - bent.mean()) - (true - true.mean())).max() < 6, joint


BONES = {
    "Head": ["HeadTop", "HeadFront", "HeadSide"],
    "Chest": ["SpineTop", "Chest", "BackL", "BackR"],
    "Hip": ["WaistLFront", "WaistRFront", "WaistLBack", "WaistRBack"],
    "LShoulder": ["LShoulderBack", "LShoulderTop"],
    "LUArm": ["LArm", "LElbowOut"],
    "LHand": ["LWristIn", "LWristOut", "LHandOut"],
    "LThigh": ["LThigh", "LKneeOut"],
    "LShin": ["LShin", "LAnkleOut"],
    "LFoot": ["LHeelBack", "LForefoot5", "LForefoot1", "LToeTip"],
}
BONES |= {f"R{bone[1:]}": [f"R{n[1:]}" for n in own] for bone, own in BONES.items() if bone[0] == "L"}


def test_markers_that_name_their_bones_alone_move_the_limbs_all_the_same():
    places = next(s for s in shipped_marker_sets() if s.name == "motive_qualisys")
    angles, pelvis = np.zeros((30, N_JOINTS, 3)), np.tile([0.0, 0.0, 0.93], (30, 1))
    wave = np.arange(30) / 5
    for side, sign in (("left", 1), ("right", -1)):
        angles[:, JOINT_ID[f"{side}_hip"], 0] = 0.3 * sign * np.sin(wave)
        angles[:, JOINT_ID[f"{side}_knee"], 0] = -0.5 - 0.4 * sign * np.sin(wave + 1)
        angles[:, JOINT_ID[f"{side}_elbow"], 0] = 0.6 + 0.4 * sign * np.sin(wave)
        angles[:, JOINT_ID[f"{side}_shoulder"], 1] = 0.3
    angles[:, 0, 2] = 2 + 0.3 * np.sin(wave)
    subject = Subject(zero_bones(shipped_bodies()[7].joints_m), places.joint, 1.03 * places.at_m)
    at = np.array([markers_at(State.of(a, p), subject) for a, p in zip(angles, pelvis, strict=True)])
    labels = tuple(f"Skeleton_{bone}{i}" for bone, own in BONES.items() for i in range(1, len(own) + 1))
    columns = [places.names.index(name) for own in BONES.values() for name in own]
    motion = solve(Markers(labels, at[:, columns], 30, "m", UP))
    assert "constant" in motion.report.assumed[0] and motion.report.rms_mm < 4
    for joint, most in (("left_knee", 2), ("right_hip", 2), ("right_elbow", 3), ("pelvis", 2)):
        off = np.degrees(motion.angles_rad[:, JOINT_ID[joint]] - angles[:, JOINT_ID[joint]])
        axis = 2 if joint == "pelvis" else 0
        assert np.abs(off[:, axis] - off[:, axis].mean()).max() < most and abs(off[:, axis].mean()) < 9, joint


def test_two_people_in_a_file_are_named():
    both = tuple(f"{who}:{name.partition(':')[2]}" for who in ("Anna", "Ben") for name in NAMES)
    markers = Markers(both, np.concatenate([positions(), 9 + positions()], axis=1), 100, "m", UP)
    known = known_markers(markers, next(s for s in shipped_marker_sets() if s.name == "plug_in_gait"))
    assert np.nanmax(known.positions_m) < 3
    assert known.assumed[0] == "the file holds 2 people ('Anna', 'Ben'); 'Anna' is used"


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


def test_unknown_markers_are_named():
    with pytest.raises(CloudError, match="unknown markers"):
        choose_marker_set(("nose", "tail", "wing"))


def test_wrong_unit_is_told_by_the_body():
    places = next(s for s in shipped_marker_sets() if s.name == "plug_in_gait")
    right = Markers(NAMES, positions(), 100, "m", UP)
    np.testing.assert_array_equal(
        known_markers(Markers(NAMES, 1000 * positions(), 100), places).seen, known_markers(right, places).seen
    )
    wrong = known_markers(Markers(NAMES, positions(), 100, "mm", UP), places)
    np.testing.assert_array_equal(wrong.positions_m, known_markers(right, places).positions_m)
    assert "'mm' does not fit a person; m is assumed" in wrong.assumed[0]
    with pytest.raises(CloudError, match="no person's size"):
        known_markers(Markers(NAMES, 30 * positions(), 100, "m", UP), places)


def test_hostile_sizes_are_refused_at_once(tmp_path):
    write_trc(tmp_path / "a.trc", positions(), frames=10**9)
    assert "states 1e+09 and holds 5" in read_markers(tmp_path / "a.trc").assumed[0]
    (tmp_path / "a.bvh").write_text(bvh_text().replace("Frames: 2", f"Frames: {10**9}"))
    assert "states 1000000000 and holds 2" in read_bvh(tmp_path / "a.bvh")[0].assumed[0]
    write_c3d(tmp_path / "a.c3d", positions())
    data = bytearray((tmp_path / "a.c3d").read_bytes())
    data[8:10] = struct.pack("<H", 65535)
    (tmp_path / "a.c3d").write_bytes(data)
    assert len(read_markers(tmp_path / "a.c3d").positions) == 5


def test_a_parameter_that_claims_more_letters_than_it_has_is_read_as_far_as_it_goes(tmp_path):
    data = C3d(FEW, SHORT).write(tmp_path / "a.c3d").read_bytes()
    claim = bytes([255, 2, len(SHORT[0]), len(SHORT)])
    assert data.count(claim) == 1
    (tmp_path / "a.c3d").write_bytes(data.replace(claim, bytes([255, 2, len(SHORT[0]), 255])))
    assert read_markers(tmp_path / "a.c3d").labels == NAMES
    (tmp_path / "a.c3d").write_bytes(data.replace(claim, bytes([255, 250, 255, 255])))
    assert len(read_markers(tmp_path / "a.c3d").labels) == len(NAMES)


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh"])
def test_marker_files_are_bounded_by_their_size(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"a{suffix}"
    size = len(original(path))
    for bound in (size, size - 1):
        for module in (bvh, marker_files):
            monkeypatch.setattr(module, "MAX_FILE_BYTES", bound)
        if bound == size:
            assert len(read(path).positions) > 1
    with pytest.raises(FormatError, match=r"larger|over|more"):
        read(path)


def test_frames_times_joints_and_frames_times_markers_are_bounded(tmp_path, monkeypatch):
    for suffix, module, bound, honest in (
        (".bvh", bvh, "MAX_CENTRES", 2 * 12),
        (".trc", marker_files, "MAX_POSITIONS", 60 * len(NAMES)),
        (".c3d", marker_files, "MAX_POSITIONS", 60 * len(NAMES)),
    ):
        path = tmp_path / f"a{suffix}"
        original(path)
        monkeypatch.setattr(module, bound, honest)
        assert len(read(path).positions) > 1
        monkeypatch.setattr(module, bound, honest - 1)
        with pytest.raises(FormatError, match="frames of"):
            read(path)


def test_a_motion_of_other_than_its_frames_is_refused(tmp_path):
    (tmp_path / "a.bvh").write_text(bvh_text().rstrip() + " 0" * 1000)
    with pytest.raises(FormatError, match="2 frames of 30 finite numbers and holds 1060"):
        read_bvh(tmp_path / "a.bvh")


@pytest.mark.parametrize(
    ("suffix", "keep"),
    [(s, k) for s in (".c3d", ".trc", ".bvh") for k in (0.0, 0.02, 0.6) if s == ".bvh" or k < 0.5],
)
def test_empty_and_cut_files_are_refused(tmp_path, suffix, keep):
    path = tmp_path / f"a{suffix}"
    data = original(path)
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(CloudError, match="a" + suffix):
        read(path)


@pytest.mark.parametrize("suffix", [".c3d", ".trc"])
@pytest.mark.parametrize("keep", [0.6, 0.97])
def test_a_cut_recording_is_read_as_far_as_it_goes(tmp_path, suffix, keep):
    path = tmp_path / f"a{suffix}"
    data = original(path)
    path.write_bytes(data[: int(keep * len(data))])
    found = read(path)
    np.testing.assert_allclose(
        found.positions / (1000 if suffix == ".c3d" else 1), positions(60)[: len(found.positions)], atol=1e-6
    )
    assert 30 <= len(found.positions) < 60 and any("60" in note for note in found.assumed)


def test_missing_and_other_files_are_refused(tmp_path):
    for name in ("none.c3d", "none.trc", "none.csv"):
        with pytest.raises(CloudError, match="none"):
            read_markers(tmp_path / name)


def original(path: Path) -> bytes:
    if path.suffix == ".bvh":
        path.write_text(bvh_text())
    else:
        {".c3d": write_c3d, ".trc": write_trc}[path.suffix](path, positions(60))
    return path.read_bytes()


def read(path: Path) -> Markers:
    return read_bvh(path)[0] if path.suffix == ".bvh" else read_markers(path)


CHANGES = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8)


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh"])
@MUTATIONS
@given(changes=CHANGES, cut=st.floats(0, 1))
def test_changed_bytes_are_read_or_refused(tmp_path, suffix, changes, cut):
    path = tmp_path / f"m{suffix}"
    mutate(path, original(path), changes, cut, 3000)


@pytest.mark.parametrize("name", ["nim_cmu_02_05.c3d", "static1.trc"])
@settings(MUTATIONS, max_examples=12)
@given(changes=CHANGES, cut=st.floats(0, 1))
def test_changed_bytes_of_real_files_are_read_or_refused(tmp_path, shared_data, name, changes, cut):
    mutate(tmp_path / name, (shared_data / "mocap" / name).read_bytes(), changes, cut, 6000)


def mutate(path: Path, data: bytes, changes: list[tuple[float, int]], cut: float, head: int) -> None:
    """Change bytes near the start, where the headers are, cut some files, and read."""
    changed = bytearray(data)
    for where, value in changes:
        changed[int(where * (min(head, len(data)) - 1))] = value
    path.write_bytes(changed[: int(min(cut / 0.3, 1.0) * len(changed))])
    try:
        found = read(path)
    except CloudError as error:
        assert "\n" not in str(error)
    else:
        assert found.positions.shape[1] == len(found.labels)


def test_a_marker_set_is_bounded_by_its_size(tmp_path, monkeypatch):
    path = tmp_path / "m.toml"
    place = '{ joint = "left_knee", at_m = [0.05, 0, 0] }'
    path.write_text(f"[markers]\n{''.join(f'M{i} = {place}' + chr(10) for i in range(600))}")
    monkeypatch.setattr("synth.motion_files.marker_set.MAX_FILE_BYTES", path.stat().st_size)
    assert len(load_marker_set(path).names) == 600
    monkeypatch.setattr("synth.motion_files.marker_set.MAX_FILE_BYTES", path.stat().st_size - 1)
    with pytest.raises(FormatError, match="marker-set file"):
        load_marker_set(path)
