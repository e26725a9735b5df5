"""Label sets and datasets hold their scheme; without one they are the paper's."""

import ast
import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import annotate
from annotate.crop import person_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import MANIFEST as DATASET
from annotate.labelset.dataset import Dataset, encode_shard
from annotate.labelset.images import decode_parts, encode_parts
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import MANIFEST, LabelSet, validate
from annotate.labelset.scheme_note import scheme_note
from annotate.labelset.stroke import Stroke
from annotate.parts import PAPER
from annotate.scheme.scheme import UNDEFINED
from annotate.scheme.scheme_file import SHIPPED, load_scheme, scheme_from_fields, scheme_to_fields
from sensors.errors import ExistsError, FormatError
from tests.helpers.label_sets import CAMERA
from tests.helpers.same_frame import assert_same_frame
from tests.helpers.schemes import WARD, frame_in

OLD_MANIFEST = {
    "schema": 1,
    "versions": {"annotate-cloud": "0.2.0"},
    "parts": {
        "background": 0,
        "head": 1,
        "torso": 2,
        "left_upper_arm": 3,
        "right_upper_arm": 4,
        "left_forearm": 5,
        "right_forearm": 6,
        "hip": 7,
        "left_upper_leg": 8,
        "right_upper_leg": 9,
        "left_lower_leg": 10,
        "right_lower_leg": 11,
    },
    "intrinsics": {"width": 32, "height": 24, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5},
    "source": "walk",
}
SCHEMES = [*map(load_scheme, SHIPPED), WARD]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_a_label_set_opens_without_its_scheme_s_file(tmp_path, scheme):
    labels = LabelSet.create(tmp_path / "set", CAMERA, {"source": "x"} | scheme_note(scheme))
    frame = frame_in(scheme)
    labels.write(frame)
    again = LabelSet.open(labels.path)
    assert again.scheme == scheme and validate(again) == []
    assert_same_frame(again.read(frame.frame_id), frame)
    assert ("scheme" in json.loads((labels.path / MANIFEST).read_text())) == (scheme != PAPER)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_a_dataset_opens_without_its_scheme_s_file(tmp_path, scheme):
    dataset = dataset_of(tmp_path, [frame_in(scheme)], scheme_note(scheme))
    assert dataset.scheme == scheme
    (again,), (entry,) = dataset, dataset.entries()
    np.testing.assert_array_equal(again.parts, frame_in(scheme).parts)
    assert again.scheme == dataset.load(entry).scheme == scheme


def dataset_of(folder, frames, info) -> Dataset:
    data = encode_shard(frames)
    (folder / "s.tar").write_bytes(data)
    shards = [{"file": "s.tar", "sha256": hashlib.sha256(data).hexdigest()}]
    manifest = {"schema": 1, "images": len(frames), "shards": shards, **info}
    (folder / DATASET).write_text(json.dumps(manifest))
    return Dataset.open(folder)


def test_sets_of_version_0_2_are_the_paper_s(tmp_path):
    (tmp_path / MANIFEST).write_text(json.dumps(OLD_MANIFEST))
    assert LabelSet.open(tmp_path).scheme == PAPER
    (tmp_path / "shards").mkdir()
    assert dataset_of(tmp_path / "shards", [frame_in(PAPER)], {"preset": "paper"}).scheme == PAPER


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_a_scheme_survives_json(scheme):
    assert scheme_from_fields(json.loads(json.dumps(scheme_to_fields(scheme)))) == scheme


@pytest.mark.parametrize("scheme", ["paper", {}, {"name": "x", "parts": []}, {"parts": 7}, None])
def test_a_malformed_scheme_is_named(tmp_path, scheme):
    for name, open_ in ((MANIFEST, LabelSet.open), (DATASET, Dataset.open)):
        content = OLD_MANIFEST | {"scheme": scheme, "images": 0, "shards": []}
        (tmp_path / name).write_text(json.dumps(content))
        with pytest.raises(FormatError, match=rf"{name}: field scheme is malformed") as refusal:
            open_(tmp_path)
        assert "\n" not in str(refusal.value)


def test_parts_of_another_scheme_are_refused(tmp_path):
    (tmp_path / MANIFEST).write_text(json.dumps(OLD_MANIFEST | scheme_note(WARD)))
    with pytest.raises(FormatError, match="other parts than scheme 'ward'"):
        LabelSet.open(tmp_path)


def test_a_frame_of_another_scheme_is_refused_in_one_line(tmp_path):
    labels = LabelSet.create(tmp_path / "set", CAMERA, scheme_note(WARD))
    for write in (labels.write, labels.write_labels):
        with pytest.raises(FormatError, match=r"has scheme 'paper', .* has 'ward'; convert") as refusal:
            write(frame_in(PAPER))
        assert "\n" not in str(refusal.value)
    assert labels.frame_ids == [] and not list((labels.path / "frames").iterdir())


def test_another_scheme_does_not_resume_a_set(tmp_path):
    LabelSet.create(tmp_path / "set", CAMERA, {"source": "x"} | scheme_note(WARD))
    assert LabelSet.resume(tmp_path / "set", CAMERA, {"source": "x"} | scheme_note(WARD)).scheme == WARD
    with pytest.raises(ExistsError):
        LabelSet.resume(tmp_path / "set", CAMERA, {"source": "x"})


def test_ids_are_the_scheme_s_alone():
    depth, parts = np.ones((2, 2), np.uint16), np.array([[0, 255], [1, 16]], np.uint8)
    with pytest.raises(FormatError, match=r"id 16 is unknown in scheme 'paper'; use 0 to 11, or 255"):
        FrameLabels("a", depth, parts)
    assert FrameLabels("a", depth, parts, scheme=WARD).scheme is WARD
    with pytest.raises(FormatError, match=r"id 17 is unknown in scheme 'ward'; use 0 to 16, 40 to 42, or"):
        FrameLabels("a", depth, parts + (parts == 16), scheme=WARD)


def test_things_are_not_the_person():
    frame = frame_in(WARD)
    things = [part.id for part in WARD.parts if part.is_free]
    assert not frame.on_body[np.isin(frame.parts, [0, UNDEFINED, *things])].any()
    assert frame.on_body[~np.isin(frame.parts, [0, UNDEFINED, *things])].all()
    np.testing.assert_array_equal(frame.on_person, frame.on_body | (frame.parts == UNDEFINED))
    np.testing.assert_array_equal(frame.on_person, person_of(frame.parts, WARD))


def test_label_images_have_the_scheme_s_colours():
    parts = np.array([[16, 40]], np.uint8)
    data = encode_parts(parts, WARD)
    np.testing.assert_array_equal(decode_parts(data), parts)
    colors = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
    np.testing.assert_array_equal(colors, WARD.palette_rgb()[parts])


def test_strokes_are_checked_by_the_set_s_scheme(tmp_path):
    journal = Journal.of(tmp_path, WARD)
    journal.add(Stroke("a", "paint", np.array([[0, 2, 0, 16]], np.int64), 16))
    journal.flush()
    assert len(Journal.of(tmp_path, WARD)) == 1
    with pytest.raises(FormatError, match=r"line 1: part id 16 is unknown in scheme 'paper'"):
        Journal.of(tmp_path)


def test_labelset_and_exchange_know_no_part_and_no_number_of_parts():
    names = {part.name for scheme in SCHEMES for part in scheme.parts}
    for folder in ("labelset", "exchange"):
        for file in (Path(annotate.__file__).parent / folder).glob("*.py"):
            values = {node.value for node in ast.walk(ast.parse(file.read_text())) if is_plain(node)}
            assert not values & (names | {11, 12}), file
            assert not {"N_CLASSES", "PARTS", "BODY_PARTS", "PART_ID"} & {*file.read_text().split()}, file


def is_plain(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | str)


def test_correction_and_views_know_no_part():
    names = {part.name for scheme in SCHEMES for part in scheme.parts}
    for folder in ("correction", "effort", "live", "foxglove", "gui"):
        for file in (Path(annotate.__file__).parent / folder).rglob("*.py"):
            source = file.read_text()
            assert not {"N_CLASSES", "PARTS", "BODY_PARTS", "PART_ID", "LEFT_RIGHT"} & imported(source), file
            # A skeleton's joints have names of their own.
            if file.name != "skeleton.py":
                assert not {node.value for node in ast.walk(ast.parse(source)) if is_plain(node)} & names, (
                    file
                )


def test_the_product_knows_the_scheme_of_the_paper_alone():
    """No list, number or table of its parts is imported."""
    root = Path(annotate.__file__).parents[1]
    for package in ("sensors", "annotate", "synth", "eval", "cli"):
        for file in (root / package).rglob("*.py"):
            assert imported(file.read_text()) <= {"PAPER", "BACKGROUND", "UNDEFINED"}, file


def imported(source: str) -> set[str]:
    """Return the names that a module imports from ``annotate.parts``; most modules do not name it."""
    if "annotate.parts" not in source:
        return set()
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
    return {alias.name for node in nodes if node.module == "annotate.parts" for alias in node.names}
