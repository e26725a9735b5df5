"""Marker files: reading gives back the written markers, and damage is one clear error."""

import re
import struct
import warnings
from pathlib import Path

import c3d
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from sensors.errors import CloudError, FormatError
from synth.motion_files import bvh, marker_files, marker_set
from synth.motion_files.bvh import read_bvh
from synth.motion_files.marker_files import Markers, read_markers
from synth.motion_files.marker_set import (
    key_of,
    known_markers,
    load_marker_set,
)
from synth.motion_files.vertical_axis import GIVEN, Upward
from tests.helpers.c3d_bytes import PROCESSORS, C3d
from tests.helpers.marker_samples import NAMES, positions, write_c3d, write_trc
from tests.helpers.marker_truth import plug_in_gait
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


MUTATIONS = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh"])
@settings(MUTATIONS, max_examples=60)
@given(changes=CHANGES, cut=st.floats(0, 1))
@example(changes=[(0.7751152584826952, 127)], cut=1.0)  # a number becomes a NaN that signals
def test_changed_bytes_are_read_or_refused(tmp_path, suffix, changes, cut):
    path = tmp_path / f"m{suffix}"
    assert_read_or_refused(path, bytearray(original(path)), changes, cut)


@pytest.mark.parametrize("name", ["nim_cmu_02_05.c3d", "static1.trc"])
@settings(MUTATIONS, max_examples=12)
@given(changes=CHANGES, cut=st.floats(0, 1))
def test_changed_bytes_of_real_files_are_read_or_refused(tmp_path, shared_data, name, changes, cut):
    data = bytearray((shared_data / "mocap" / name).read_bytes())
    assert_read_or_refused(tmp_path / name, data, changes, cut)


def assert_read_or_refused(path, data, changes, cut):
    """Change bytes near the start, where the headers are, cut some files, and read."""
    for where, value in changes:
        data[int(where * (min(4000, len(data)) - 1))] = value
    path.write_bytes(data[: int(min(cut / 0.3, 1.0) * len(data))])
    try:
        found = read(path)
    except CloudError as error:
        assert "\n" not in str(error)
    else:
        assert found.positions.shape[1] == len(found.labels)
