"""Marker files: what is read is what was written, and what is damaged is one clear error."""

import struct
from pathlib import Path

import c3d
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sensors.errors import CloudError, FormatError
from synth.markers import bvh, marker_files
from synth.markers.bvh import read_bvh
from synth.markers.marker_files import Markers, read_markers
from synth.markers.markerset import (
    choose_marker_set,
    key_of,
    known_markers,
    load_marker_set,
    shipped_marker_sets,
)
from tests.helpers.marker_samples import NAMES, bvh_text, positions, write_c3d, write_trc

MUTATIONS = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def test_a_trc_may_hold_blank_lines_but_no_more_frames_than_it_claims(tmp_path):
    path = tmp_path / "a.trc"
    write_trc(path, positions())
    text = path.read_text()
    path.write_text(text.rstrip("\n") + "\n" + "\n" * 50)
    np.testing.assert_allclose(read_markers(path).positions, positions(), atol=1e-6)
    path.write_text(text + text.rstrip("\n").rpartition("\n")[2] + "\n")
    with pytest.raises(FormatError, match="claims"):
        read_markers(path)


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
    ):
        path.write_text(bad)
        with pytest.raises(FormatError, match="mine"):
            load_marker_set(path)


def test_unknown_markers_are_named():
    with pytest.raises(CloudError, match="unknown markers"):
        choose_marker_set(("nose", "tail", "wing"))


def test_wrong_unit_is_told_by_the_body():
    places = next(s for s in shipped_marker_sets() if s.name == "plug_in_gait")
    right = Markers(NAMES, positions(), 100, "m", 2)
    np.testing.assert_array_equal(
        known_markers(Markers(NAMES, 1000 * positions(), 100), places).seen, known_markers(right, places).seen
    )
    with pytest.raises(CloudError, match="declares 'mm'"):
        known_markers(Markers(NAMES, positions(), 100, "mm", 2), places)


def test_hostile_sizes_are_refused_at_once(tmp_path):
    write_trc(tmp_path / "a.trc", positions(), frames=10**9)
    with pytest.raises(FormatError, match="1000000000 frames"):
        read_markers(tmp_path / "a.trc")
    (tmp_path / "a.bvh").write_text(bvh_text().replace("Frames: 2", f"Frames: {10**9}"))
    with pytest.raises(FormatError, match="1000000000 frames"):
        read_bvh(tmp_path / "a.bvh")
    write_c3d(tmp_path / "a.c3d", positions())
    data = bytearray((tmp_path / "a.c3d").read_bytes())
    data[8:10] = struct.pack("<H", 65535)
    (tmp_path / "a.c3d").write_bytes(data)
    with pytest.raises(CloudError):
        read_markers(tmp_path / "a.c3d")


@pytest.mark.parametrize("name", ["UNITS", "LABELS"])
def test_a_parameter_that_claims_more_letters_than_it_has_is_refused(tmp_path, monkeypatch, name):
    """Four bytes claim 16 million texts; the library makes an object of each."""
    write_c3d(tmp_path / "a.c3d", positions())
    real = c3d.Reader.get

    def get(self, asked, *default):
        found = real(self, asked, *default)
        if asked == f"POINT:{name}":
            found.dimensions = [1, 255, 255, 255]
            monkeypatch.setattr(type(found), "string_array", property(lambda _: pytest.fail("it was read")))
        return found

    monkeypatch.setattr(c3d.Reader, "get", get)
    with pytest.raises(FormatError, match=f"POINT:{name} claims"):
        read_markers(tmp_path / "a.c3d")


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


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh"])
@pytest.mark.parametrize("keep", [0.0, 0.1, 0.6, 0.97])
def test_empty_and_cut_files_are_refused(tmp_path, suffix, keep):
    path = tmp_path / f"a{suffix}"
    data = original(path)
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(CloudError, match="a" + suffix):
        read(path)


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
    monkeypatch.setattr("synth.markers.markerset.MAX_FILE_BYTES", path.stat().st_size)
    assert len(load_marker_set(path).names) == 600
    monkeypatch.setattr("synth.markers.markerset.MAX_FILE_BYTES", path.stat().st_size - 1)
    with pytest.raises(FormatError, match="marker-set file"):
        load_marker_set(path)
