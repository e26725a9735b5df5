"""Marker files: reading gives back the written markers, and damage is one clear error."""

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
from synth.body.skeleton import JOINT_ID, N_JOINTS
from synth.markers.solve import solve
from synth.motion_files import bvh, marker_files, marker_set
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
from tests.helpers.marker_samples import NAMES, positions, write_c3d, write_trc
from tests.helpers.marker_truth import plug_in_gait, worn
from tests.helpers.walker import bvh_of

UP = Upward("z", GIVEN)
PELVIS_M = np.array([0.0, 0.0, 0.93])
FEW = positions(7) * 1000
ANALOG = {"analog": np.arange(42.0).reshape(7, 6)}
SHORT = list(NAMES)


def stated(*values, group="POINT"):
    return {"parameters": [(group, name, value) for name, value in values]}


C3D_DEFECTS = {
    "none": ({}, ""),
    "words": ({"scale": 0.1}, ""),
    "parameter twice": (stated(("USED", 10), ("USED", 10)), "POINT:USED is there 2"),
    "labels twice": (stated(("LABELS", ["a"]), ("LABELS", SHORT)), "LABELS is there 2"),
    "analog": (ANALOG | {"scale": 0.1}, ""),
    "fewer analog in the header": (ANALOG | {"header": {"analog": 4}}, "analog values a frame"),
    "no analog in the parameters": (ANALOG | stated(("USED", 0), group="ANALOG"), "0 and 6; 6 fits"),
    "analog rate": (ANALOG | stated(("RATE", 1000.0), group="ANALOG"), "60 and 6; 6 fits"),
    "scale of the header": ({"scale": 0.1, "header": {"scale": 0.2}}, "scale: the file states 0.1 and 0.2"),
    "words by the header": ({"header": {"scale": 0.1}}, "numbers as floats"),
    "words by the parameters": (stated(("SCALE", 0.1)), "numbers as floats"),
    "last frame": ({"lost_frames": 1}, "1 of 7 frames are missing"),
    "last frame, no padding": ({"lost_frames": 1, "padded": False}, "1 of 7 frames are missing"),
    "parameters elsewhere": ({"gap": 1024}, ""),
    "data elsewhere": (stated(("DATA_START", 9)), "start of the data"),
    "data elsewhere by the header": ({"header": {"data_block": 9}}, "start of the data"),
    "fewer points in the header": ({"header": {"points": 8}}, "points: the file states 10 and 8; 10 fits"),
    "other rate": ({"header": {"rate": 50.0}}, "frames a second: the file states 100 and 50"),
    "other frames": (stated(("FRAMES", 5)), "frames: the file states 7 and 5; 7 fits"),
    "nothing stated": (stated(*((name, None) for name in ("USED", "SCALE", "RATE", "FRAMES"))), ""),
}


@pytest.mark.parametrize("processor", PROCESSORS)
@pytest.mark.parametrize("defect", C3D_DEFECTS)
def test_c3d_with_defects_is_read_and_the_assumption_is_named(tmp_path, processor, defect):
    fields, note = C3D_DEFECTS[defect]
    found = read_markers(C3d(FEW, SHORT, processor=processor, **fields).write(tmp_path / "a.c3d"))
    assert found.labels == NAMES and (found.frames_per_second, found.unit) == (100, "mm")
    frames = len(FEW) - fields.get("lost_frames", 0)
    np.testing.assert_allclose(found.positions, FEW[:frames], atol=0.06 if "scale" in fields else 1e-3)
    assert (note in "; ".join(found.assumed)) if note else not found.assumed


def test_c3d_without_labels_or_parameters_or_with_too_long_claims_is_read(tmp_path):
    path = tmp_path / "a.c3d"
    for labels, names in ((None, ("1", "2", "3")), (["LASI"], ("LASI", "2", "3"))):
        found = read_markers(C3d(FEW, SHORT, **stated(("LABELS", labels))).write(path))
        assert found.labels[:3] == names and "no label" in found.assumed[0]
        np.testing.assert_allclose(found.positions, FEW, atol=1e-3)
    data = C3d(FEW, SHORT).write(path).read_bytes()
    claim = bytes([255, 2, len(SHORT[0]), len(SHORT)])
    assert data.count(claim) == 1
    path.write_bytes(data.replace(claim, bytes([255, 2, len(SHORT[0]), 255])))
    assert read_markers(path).labels == NAMES
    path.write_bytes(data.replace(claim, bytes([255, 250, 255, 255])))
    assert len(read_markers(path).labels) == len(NAMES)
    path.write_bytes(data[:515] + b"\0" + data[516:])
    found = read_markers(path)
    np.testing.assert_allclose(found.positions, FEW, atol=1e-3)
    assert "no parameters" in found.assumed[0]


def test_files_agree_with_the_c3d_library(shared_data, tmp_path):
    write_c3d(tmp_path / "a.c3d", positions())
    found = read_markers(tmp_path / "a.c3d")
    assert found.labels == NAMES and found.unit == "mm" and found.frames_per_second == 100
    np.testing.assert_allclose(found.positions / 1000, positions(), atol=1e-6)
    for path in (shared_data / "mocap").glob("*.c3d"):
        found = read_markers(path)
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader = c3d.Reader(file)
            frames = [np.where(p[:, 3:4] < 0, np.nan, p[:, :3]) for _, p, _ in reader.read_frames()]
            labels = tuple(label.strip() for label in reader.point_labels)
        np.testing.assert_array_equal(found.positions, np.array(frames))
        assert found.labels == labels[: len(found.labels)] and not found.assumed


def from_row(number, change):
    """Change the text of a TRC from a frame on."""
    return lambda t: t[: t.index(f"\n{number}\t")] + change(t[t.index(f"\n{number}\t") :])


TRC_DEFECTS = {
    "blank lines": (lambda t: t.rstrip("\n") + "\n" * 50, ""),
    "CRLF": (lambda t: t.replace("\n", "\r\n"), ""),
    "comments": (lambda t: "# by hand\n" + t.replace("\n1\t", "\n// here\n1\t"), ""),
    "no trailing tabs": (lambda t: "\n".join(line.rstrip("\t") for line in t.split("\n")), ""),
    "decimal commas": (from_row(1, lambda t: t.replace(".", ",")), ""),
    "spaces for tabs": (lambda t: t.replace("\t", "  ").replace("Anna:", ""), ""),
    "words in cells": (from_row(2, lambda t: t.replace("\t\t\t", "\tnone\tnan\t")), "cells are not numbers"),
    "more frames": (lambda t: t.replace("100\t100\t5", "100\t100\t4"), "frames: the file states 4"),
    "no rate": (lambda t: t.replace("100\t100\t5", "\t\t5"), "100 follow from the times"),
    "other count": (lambda t: t.replace("\t10\tm\t", "\t12\tm\t"), "markers: the file states 12"),
    "more numbers": (lambda t: t.rstrip("\n") + "\t7\n", "1 frames have more"),
    "text behind": (lambda t: t + "end of recording\n", "1 lines are not frames"),
    "cut": (lambda t: t + t.rstrip("\n").rpartition("\n")[2][:40], "cut off and was left out"),
    "commas for tabs": (lambda t: t.replace("\t", ","), ""),
    "semicolons for tabs": (lambda t: t.replace("\t", ";"), ""),
    "semicolons and decimal commas": (lambda t: t.replace("\t", ";").replace(".", ","), ""),
    "commas and blanks": (lambda t: t.replace("\t", ", "), ""),
    "Frame without a sign": (lambda t: t.replace("Frame#", "Frame"), ""),
    "labels over all columns": (lambda t: re.sub(r"(Anna:\w+)\t\t", r"\1\t\1\t\1", t), ""),
    "UTF-16": (lambda t: t.encode("utf-16"), ""),
    "no sixth line": (lambda t: t.replace("\n\n", "\n"), ""),
}


@pytest.mark.parametrize("defect", TRC_DEFECTS)
def test_trc_with_defects_is_read_and_the_assumption_is_named(tmp_path, defect):
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
    for column in set(range(len(NAMES))) - set(unnamed):
        at = found.labels.index(NAMES[column])
        np.testing.assert_allclose(found.positions[:, at], positions()[:, column], atol=1e-6)
    assert any("no label" in line or "states" in line or "have more" in line for line in found.assumed)


def test_places_of_zero_are_not_seen_and_files_without_positions_refused(tmp_path):
    points = np.nan_to_num(positions())
    write_trc(tmp_path / "a.trc", points)
    found = read_markers(tmp_path / "a.trc")
    np.testing.assert_allclose(found.positions, positions(), atol=1e-6)
    assert "0, 0, 0" in found.assumed[0]
    write_trc(tmp_path / "0.trc", 0 * points)
    C3d(0 * FEW, SHORT).write(tmp_path / "0.c3d")
    C3d(np.full_like(FEW, np.nan), SHORT).write(tmp_path / "nan.c3d")
    for name in ("0.trc", "0.c3d", "nan.c3d"):
        with pytest.raises(FormatError, match="no position"):
            read_markers(tmp_path / name)


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


def test_the_body_corrects_a_wrong_unit():
    right = known_markers(Markers(NAMES, positions(), 100, "m", UP), plug_in_gait())
    unstated = known_markers(Markers(NAMES, 1000 * positions(), 100), plug_in_gait())
    np.testing.assert_array_equal(unstated.seen, right.seen)
    wrong = known_markers(Markers(NAMES, positions(), 100, "mm", UP), plug_in_gait())
    np.testing.assert_array_equal(wrong.positions_m, right.positions_m)
    assert "'mm' does not fit a person; m is assumed" in wrong.assumed[0]
    with pytest.raises(CloudError, match="no person's size"):
        known_markers(Markers(NAMES, 30 * positions(), 100, "m", UP), plug_in_gait())


def test_claims_of_many_frames_are_corrected_by_the_data(tmp_path):
    write_trc(tmp_path / "a.trc", positions(), frames=10**9)
    assert "states 1e+09 and holds 5" in read_markers(tmp_path / "a.trc").assumed[0]
    (tmp_path / "a.bvh").write_text(bvh_of().replace("Frames: 24", f"Frames: {10**9}"))
    assert "states 1000000000 and holds 24" in read_bvh(tmp_path / "a.bvh")[0].assumed[0]
    write_c3d(tmp_path / "a.c3d", positions())
    data = bytearray((tmp_path / "a.c3d").read_bytes())
    data[8:10] = struct.pack("<H", 65535)
    (tmp_path / "a.c3d").write_bytes(data)
    assert len(read_markers(tmp_path / "a.c3d").positions) == 5


def original(path: Path) -> bytes:
    if path.suffix == ".toml":
        place = '{ joint = "left_knee", at_m = [0.05, 0, 0] }\n'
        path.write_text("[markers]\n" + "".join(f"M{i} = {place}" for i in range(600)))
    elif path.suffix == ".bvh":
        path.write_text(bvh_of())
    else:
        {".c3d": write_c3d, ".trc": write_trc}[path.suffix](path, positions(60))
    return path.read_bytes()


def read(path: Path):
    readers = {".bvh": lambda p: read_bvh(p)[0], ".toml": load_marker_set}
    return readers.get(path.suffix, read_markers)(path)


BOUNDS = {
    ".bvh": (bvh, "MAX_CENTRES", 24 * 26),
    ".trc": (marker_files, "MAX_POSITIONS", 60 * len(NAMES)),
    ".c3d": (marker_files, "MAX_POSITIONS", 60 * len(NAMES)),
    ".toml": (marker_set, "", 0),
}


@pytest.mark.parametrize("suffix", BOUNDS)
def test_files_are_bounded_by_bytes_and_by_positions(tmp_path, monkeypatch, suffix):
    path, (module, name, honest) = tmp_path / f"a{suffix}", BOUNDS[suffix]
    for bound, most, message in ((name, honest, "frames of"), ("MAX_FILE_BYTES", len(original(path)), "")):
        if bound:
            with monkeypatch.context() as patch:
                patch.setattr(module, bound, most)
                read(path)
                patch.setattr(module, bound, most - 1)
                with pytest.raises(FormatError, match=message or "larger|over|more|marker-set file"):
                    read(path)


CUT = [(s, k) for s in (".c3d", ".trc", ".bvh") for k in (0.0, 0.02, 0.6, 0.97) if s != ".bvh" or k < 0.5]


@pytest.mark.parametrize(("suffix", "keep"), CUT)
def test_a_cut_recording_is_read_as_far_as_it_goes_or_refused(tmp_path, suffix, keep):
    path = tmp_path / f"a{suffix}"
    data = original(path)
    path.write_bytes(data[: int(keep * len(data))])
    if keep < 0.5:
        with pytest.raises(CloudError, match="a" + suffix):
            read(path)
        return
    found = read(path)
    metres = found.positions / (1000 if suffix == ".c3d" else 1)
    np.testing.assert_allclose(metres, positions(60)[: len(metres)], atol=1e-6)
    assert 30 <= len(metres) < 60 and any("60" in note for note in found.assumed)


def test_missing_and_other_files_are_refused(tmp_path):
    for name in ("none.c3d", "none.trc", "none.csv"):
        with pytest.raises(CloudError, match="none"):
            read_markers(tmp_path / name)


CHANGES = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8)


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=CHANGES, cut=st.floats(0, 1))
def test_changed_bytes_are_read_or_refused(tmp_path, suffix, changes, cut):
    """Bytes change near the start, where the headers are, and some files are cut."""
    path = tmp_path / f"m{suffix}"
    data = bytearray(original(path))
    for where, value in changes:
        data[int(where * (min(3000, len(data)) - 1))] = value
    path.write_bytes(data[: int(min(cut / 0.3, 1.0) * len(data))])
    try:
        found = read(path)
    except CloudError as error:
        assert "\n" not in str(error)
    else:
        assert found.positions.shape[1] == len(found.labels)
