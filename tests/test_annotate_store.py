"""A label set survives to the bit, refuses corrupt or unsafe files, and is never half-written."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import annotate.labelset.json_object
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import (
    encode_parts,
    encode_png,
)
from annotate.labelset.label_set import LEARNT, MANIFEST, LabelSet, validate
from annotate.parts import (
    N_CLASSES,
)
from sensors.errors import CloudError, ExistsError, FormatError
from tests.helpers.label_maps import CAMERA, confidences, depths, law, part_maps
from tests.helpers.same_frame import assert_same_frame

notes = st.dictionaries(  # ``LEARNT`` names a folder of the label set, so other values are refused
    st.text(max_size=8).filter(lambda name: name != LEARNT),
    st.none() | st.booleans() | st.integers() | st.text(max_size=8),
    max_size=3,
)


def labels(frame_id: str = "a", seed: int = 0, **fields) -> FrameLabels:
    rng = np.random.default_rng(seed)
    depth = rng.integers(1, 65536, (6, 8), np.uint16)
    return FrameLabels(frame_id, depth, rng.integers(0, N_CLASSES, (6, 8), np.uint8), **fields)


@pytest.fixture
def label_set(tmp_path) -> LabelSet:
    created = LabelSet.create(tmp_path / "set", CAMERA, {"source": "test"})
    for i in range(3):
        created.write(labels(f"{i:06}", i))
    return created


# Labels


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"depth_mm": np.ones((6, 8), np.float32)}, "float32"),
        ({"depth_mm": np.ones((6, 8, 1), np.uint16)}, r"\(6, 8, 1\)"),
        ({"parts": np.zeros((6, 7), np.uint8)}, r"\(6, 8\)"),
        ({"parts": np.zeros((6, 8), np.int64)}, "int64"),
        ({"parts": np.full((6, 8), 12, np.uint8)}, "part id 12"),
        ({"confidence": np.zeros((1, 1), np.float32)}, "confidence"),
        ({"persons": np.zeros((6, 8), np.int64)}, "int64"),
        ({"status": "guessed"}, "guessed"),
        ({"subject": 7}, "subject is 7"),
        ({"notes": ["dim light"]}, "dim light"),
    ],
)
def test_impossible_labels_are_refused(changes, says):
    good = {"depth_mm": np.ones((6, 8), np.uint16), "parts": np.zeros((6, 8), np.uint8)}
    with pytest.raises(FormatError, match=says):
        FrameLabels("a", **{**good, **changes})


# The store


@given(
    depth=depths,
    parts=part_maps,
    confidence=confidences,
    status=st.sampled_from(["auto", "corrected", "reviewed", "truth"]),
    subject=st.text(max_size=9),
    noted=notes,
    persons=st.none() | arrays(np.uint8, (6, 8)),
)
@law
def test_a_frame_survives_to_the_bit(label_set, depth, parts, confidence, status, subject, noted, persons):
    frame = FrameLabels("000001", depth, parts, confidence, status, subject, noted, persons)
    label_set.write(frame)
    assert_same_frame(LabelSet.open(label_set.path).read("000001"), frame)


def test_a_label_set_reopens_as_it_was(label_set, tmp_path):
    reopened = LabelSet.open(label_set.path)
    assert (reopened.intrinsics, reopened.info) == (CAMERA, {"source": "test"})
    assert reopened.frame_ids == ["000000", "000001", "000002"] and len(reopened) == 3
    assert "000001" in reopened and "000009" not in reopened
    for i, frame in enumerate(reopened):
        assert_same_frame(frame, labels(f"{i:06}", i))
    with pytest.raises(FormatError, match=r"\(4, 4\)"):
        reopened.write(FrameLabels("a", np.ones((4, 4), np.uint16), np.zeros((4, 4), np.uint8)))
    (tmp_path / "file").write_text("mine")
    for taken in (label_set.path, tmp_path / "file"):
        with pytest.raises(ExistsError, match="choose another folder"):
            LabelSet.create(taken, CAMERA, {})
    assert validate(reopened) == []


UNSAFE = ["", ".", "..", "../x", "a/b", "/etc/passwd", "a\0b", "a\n"]
UNSAFE += ["-rf", ".hidden", "é", "x" * 101, "C:\\x"]


@pytest.mark.parametrize("frame_id", UNSAFE)
def test_unsafe_ids_touch_no_file(label_set, frame_id):
    before = sorted(label_set.path.parent.rglob("*"))
    for action in (
        lambda: label_set.write(labels(frame_id)),
        lambda: label_set.read(frame_id),
        lambda: frame_id in label_set,
    ):
        with pytest.raises(FormatError, match="unsafe"):
            action()
    assert sorted(label_set.path.parent.rglob("*")) == before


@pytest.mark.parametrize("fails_at", range(4))
def test_a_write_that_fails_midway_leaves_no_new_frame_and_no_litter(label_set, monkeypatch, fails_at):
    """After the new frame's, the first file of an old frame fails; the old frame stays."""
    written, old, real = [], label_set.read("000001"), Path.write_bytes

    def failing(path: Path, data: bytes) -> int:
        if len(written) == fails_at:
            real(path, data[: len(data) // 2])
            raise OSError(28, "No space left on device")
        written.append(path)
        return real(path, data)

    monkeypatch.setattr(Path, "write_bytes", failing)
    for frame in (labels("new", confidence=np.zeros((6, 8), np.float32)), labels("000001", 99)):
        with pytest.raises(OSError, match="No space"):
            label_set.write(frame)
    reopened = LabelSet.open(label_set.path)
    assert_same_frame(reopened.read("000001"), old)
    assert "new" not in reopened
    assert reopened.frame_ids == ["000000", "000001", "000002"]
    assert validate(reopened) == []
    assert not list(label_set.path.rglob("*.partial"))


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"null", b"\xff\xfe", b"[" * 100_000, b'{"schema": 2}']
)
@pytest.mark.parametrize("name", [MANIFEST, "frames/000001.json"])
def test_a_corrupt_json_blocks_and_is_left_alone(label_set, name, content):
    file = label_set.path / name
    file.write_bytes(content)
    with pytest.raises(FormatError) as error:
        LabelSet.open(label_set.path).read("000001")
    assert file.name in str(error.value)
    assert "\n" not in str(error.value)
    assert file.read_bytes() == content


def test_a_json_as_large_as_the_bound_is_read_and_a_larger_one_refused(label_set, monkeypatch):
    size = max(path.stat().st_size for path in label_set.path.rglob("*.json"))
    monkeypatch.setattr(annotate.labelset.json_object, "MAX_JSON_BYTES", size)
    assert validate(LabelSet.open(label_set.path)) == []
    monkeypatch.setattr(annotate.labelset.json_object, "MAX_JSON_BYTES", size - 1)
    with pytest.raises(FormatError, match=f"larger than {size - 1} bytes"):
        validate(LabelSet.open(label_set.path))


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


FIELDS = [(MANIFEST, name) for name in ("schema", "parts", "intrinsics", "other")]
FIELDS += [("frames/000001.json", name) for name in ("status", "subject", "notes", "frame_id", "depth_mm")]


@given(field=st.sampled_from(FIELDS), value=json_values)
@law
def test_any_entry_of_a_json_may_be_anything(label_set, field, value):
    file = label_set.path / field[0]
    original = file.read_bytes()
    file.write_text(json.dumps({**json.loads(original), field[1]: value}))
    try:
        LabelSet.open(label_set.path).read("000001")
    except CloudError as error:
        assert "\n" not in str(error)
    finally:
        file.write_bytes(original)


@pytest.mark.parametrize("changes", [{"width": 8.0}, {"fx": [1, 2]}, {"fx": -1}, {"zoom": 1}])
def test_a_manifest_with_an_impossible_camera_is_named(label_set, changes):
    manifest = json.loads((label_set.path / MANIFEST).read_text())
    (label_set.path / MANIFEST).write_text(
        json.dumps(manifest | {"intrinsics": manifest["intrinsics"] | changes})
    )
    with pytest.raises(FormatError, match=f"{MANIFEST} has malformed intrinsics"):
        LabelSet.open(label_set.path)


def test_validate_finds_every_planted_fault(label_set):
    frames = label_set.path / "frames"
    for i in range(3, 9):
        label_set.write(labels(f"{i:06}", i))
    assert validate(label_set) == []
    (frames / "000000.depth.png").unlink()
    (frames / "000001.parts.png").write_bytes(b"no PNG")
    (frames / "000002.json").write_text("{")
    (frames / "000003.parts.png").write_bytes(encode_parts(np.full((6, 8), 77, np.uint8)))
    (frames / "000004.depth.png").write_bytes(encode_png(np.ones((5, 8), np.uint16)))
    (frames / "000005.depth.png").write_bytes(encode_png(np.zeros((6, 8), np.uint16)))
    (frames / "000005.parts.png").write_bytes(encode_parts(np.full((6, 8), 3, np.uint8)))
    (frames / "000006.depth.png").write_bytes(encode_png(labels().depth_mm)[:50])
    (frames / "000007.json").write_text(json.dumps({"status": "guessed", "subject": "", "notes": {}}))
    problems = validate(label_set)
    assert len(problems) == 8
    for i, problem in enumerate(problems):
        assert f"{i:06}" in problem
        assert "\n" not in problem
    assert "48 pixels" in problems[5]


def test_an_empty_set_is_a_problem_and_none_is_an_error(tmp_path):
    assert "no frames" in validate(LabelSet.create(tmp_path / "set", CAMERA, {}))[0]
    with pytest.raises(FormatError, match=MANIFEST):
        LabelSet.open(tmp_path / "set" / "frames")
