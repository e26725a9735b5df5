"""A stripped session holds nothing of what was removed, and all of the rest."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import assert_refused, tree
from mcap.records import Attachment

from annotate.faces import (
    FaceBlur,
    LabelledHeads,
    Outline,
    PosedHeads,
    blur,
    head_of,
    headless_of,
    read_faces,
)
from annotate.labelset.label_set import LabelSet
from sensors.errors import FormatError
from sensors.rig.rig_calibration import calibration_to_json
from sensors.session.mcap_records import contents_at, record_offsets
from sensors.session.messages import COLOR, INFRARED, SUBJECT, THERMAL
from sensors.session.reader import Session
from sensors.session.repair import problems_of
from sensors.session.strip import COLOURS, TEMPERATURES, Removal, strip
from sensors.session.writer import SessionWriter
from synth.rig.simulate import truth_path

NAME, JPEG, PNG = "Anna Muster", b"\xff\xd8\xff", b"\x89PNG"


@pytest.fixture
def named(rig_session, tmp_path) -> Path:
    """A session of a named person with every kind of data that can hold a name or a picture."""
    source, path = Session(rig_session), tmp_path / "take.mcap"
    metadata = {SUBJECT: NAME, "note": f"second take of {NAME.upper()}"}
    with SessionWriter(path, source.calibration, f"{NAME} on a sofa", metadata=metadata) as writer:
        for frame in source:
            writer.write(replace(frame, infrared=frame.depth_mm))
        writer.event(int(source.times_ns[0]), f"{NAME.lower()} enters")
        picture = next(iter(source)).color_encoded
        number = writer._writer.register_channel("/webcam", "", 0, {"who": NAME})
        writer._writer.add_message(number, 1, picture, 1)
        writer._writer.add_metadata("other program", {"who": NAME})
        writer._writer.add_attachment(Attachment(0, 0, f"{NAME}.jpg", "image/jpeg", picture))
    return path


def unpacked(path: Path) -> bytes:
    """Return a session file's bytes, then its records, chunks unpacked."""
    with path.open("rb") as file:
        return path.read_bytes() + b"".join(contents_at(file, at) for at in record_offsets(file))


def quiet(count: int) -> None:
    """Show no progress."""


@pytest.mark.parametrize("topics", [COLOURS, TEMPERATURES, COLOURS | TEMPERATURES])
def test_a_copy_lacks_the_removed_images_and_holds_the_rest(named, tmp_path, topics):
    out = tmp_path / "out.mcap"
    done = strip(named, out, Removal(topics), quiet)
    assert problems_of(out) == [] and done.frames == 3
    assert set(done.left_out) <= topics and done.left_out.total() == 3 * len(
        {COLOR, INFRARED, THERMAL} & topics
    )
    for old, new in zip(Session(named), Session(out), strict=True):
        np.testing.assert_array_equal(old.depth_mm, new.depth_mm)
        assert new.color_encoded == (None if COLOR in topics else old.color_encoded)
        assert (new.infrared is None) == (INFRARED in topics)
        kept = None if THERMAL in topics else old.thermal_c
        assert new.thermal_c is kept is None or np.array_equal(new.thermal_c, kept, equal_nan=True)
    assert calibration_to_json(Session(out).calibration) == calibration_to_json(Session(named).calibration)
    assert Session(out).events == Session(named).events and Session(out).subject == NAME


def test_a_byte_search_finds_neither_name_nor_picture(named, tmp_path):
    before = unpacked(named)
    assert before.lower().count(NAME.lower().encode()) >= 6 and before.count(JPEG) >= 5
    strip(named, tmp_path / "out.mcap", Removal(COLOURS, NAME), quiet)
    after = unpacked(tmp_path / "out.mcap")
    assert NAME.lower().encode() not in after.lower() and JPEG not in after and PNG not in after
    left = Session(tmp_path / "out.mcap")
    assert left.subject == "" and left.name == "a person on a sofa"
    assert left.events[0][1] == "a person enters" and left.metadata["note"] == "second take of a person"


def test_an_interrupted_copy_leaves_no_file(named, tmp_path):
    def killed(count: int) -> None:
        raise KeyboardInterrupt

    before = tree(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        strip(named, tmp_path / "out.mcap", Removal(COLOURS), killed)
    assert tree(tmp_path) == before


def test_verbs_work_on_a_stripped_session(annotate_cloud, named, tmp_path):
    out = tmp_path / "out.mcap"
    words = ("strip", named, out, "--colour", "--thermal", "--subject", NAME, "--json")
    assert annotate_cloud(*words).result["left_out"] == {COLOR: 3, INFRARED: 3, THERMAL: 3}
    assert annotate_cloud("validate", out).code == annotate_cloud("info", out).code == 0
    assert annotate_cloud("predict", out, "--out", tmp_path / "parts").code == 0
    assert annotate_cloud("label", out, "--out", tmp_path / "people").code == 0
    assert len(LabelSet.open(tmp_path / "parts")) == 3
    for file in (tmp_path / "parts").rglob("*.json"):
        assert NAME not in file.read_text()


def test_mistakes_are_refused(annotate_cloud, named, tmp_path):
    out = tmp_path / "out.mcap"
    assert_refused(annotate_cloud("strip", named, out, "--subject", "Bea"), "does not hold the name 'Bea'")
    wrong = tmp_path / "anna muster.mcap"
    assert_refused(annotate_cloud("strip", named, wrong, "--subject", NAME), "give another name for the copy")
    assert_refused(annotate_cloud("strip", named, named, "--colour", "--overwrite"), "is the session itself")
    partial = shutil.copy(named, tmp_path / "cut.mcap")
    with Path(partial).open("r+b") as file:
        file.truncate(named.stat().st_size * 2 // 3)
    assert_refused(annotate_cloud("strip", partial, out, "--colour"), "annotate-cloud repair")
    (tmp_path / "poses.json").write_text('{"0.png": []}')
    words = ("strip", named, out, "--faces", tmp_path / "poses.json")
    assert_refused(annotate_cloud(*words), "1 images, ")
    assert not out.exists()


def detail(image: np.ndarray, mask: np.ndarray) -> float:
    """Return the variance of a picture's finest detail inside a mask."""
    return float(cv2.Laplacian(image.astype(np.float32), cv2.CV_32F)[mask].var())


def test_the_heads_of_labels_are_blurred_in_colour_and_nothing_else(rig_session, tmp_path):
    """The mask of comparison is drawn point by point, without the hull of the product."""
    source, labels = Session(rig_session), LabelSet.open(truth_path(rig_session))
    heads, out = LabelledHeads(labels, source), tmp_path / "out.mcap"
    done = strip(rig_session, out, Removal({INFRARED}, blur=FaceBlur(source, heads)), quiet)
    assert not done.left_out
    for old, new in zip(source, Session(out), strict=True):
        before, after = old.decode_color(), new.decode_color()
        head = np.zeros(before.shape[:2], np.bool_)
        points_px = np.concatenate([one.points_px for one in heads.outlines(old.index)])
        for column, row in np.rint(points_px).astype(int):
            if 0 <= row < head.shape[0] and 0 <= column < head.shape[1]:
                head[row, column] = True
        assert detail(after, head) < 0.2 * detail(before, head)
        side = int(np.ptp(np.argwhere(head), axis=0).max())
        far = cv2.dilate(head.astype(np.uint8), np.ones((2 * side + 1, 2 * side + 1))) == 0
        assert far.mean() > 0.5 and np.abs(after.astype(int) - before)[far].mean() < 2


def test_images_without_a_known_head_are_left_out(rig_session, tmp_path):
    labels = LabelSet.open(shutil.copytree(truth_path(rig_session), tmp_path / "truth"))
    first = labels.read("000000")
    labels.write(replace(first, parts=np.where(head_of(first), np.uint8(0), first.parts)))
    source = Session(rig_session)
    removal = Removal(blur=FaceBlur(source, LabelledHeads(labels, source)))
    done = strip(rig_session, tmp_path / "out.mcap", removal, quiet)
    assert dict(done.left_out) == {COLOR: 1}
    assert [frame.color_encoded is None for frame in Session(tmp_path / "out.mcap")] == [True, False, False]


def test_landmarks_give_a_square_about_the_face(rig_session, tmp_path):
    face = [[100 + dx, 50 + dy, 1.0] for dx, dy in ((-20, 0), (20, 0), *[(0, 0)] * 9)]
    people = {f"{n}.png": [face + [[0, 0, 0]] * 22] if n else [] for n in range(3)}
    (tmp_path / "people.json").write_text(json.dumps(people))
    heads = PosedHeads(tmp_path / "people.json", Session(rig_session))
    assert heads.outlines(0) == []
    ((corners_px, _),) = heads.outlines(1)
    np.testing.assert_allclose([corners_px.min(axis=0), corners_px.max(axis=0)], [(80, 30), (120, 70)])
    for text in ("[1]", '{"0": [[]]}', *(json.dumps({"0": [[[x, 0, 1]] * 33]}) for x in (1e9, 10**400))):
        (tmp_path / "people.json").write_text(text)
        with pytest.raises(FormatError, match=r"pose file|landmarks"):
            read_faces(tmp_path / "people.json")


def test_a_head_at_the_border_or_outside_is_no_error():
    image = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
    same = image.copy()
    blur(image, Outline(np.array([(-500.0, -500.0), (-480, -490)])))
    np.testing.assert_array_equal(image, same)
    blur(image, Outline(np.array([(-10.0, -10.0), (10, -10), (10, 10), (-10, 10)])))
    assert (image[:8, :8] != same[:8, :8]).any() and (image[30:] == same[30:]).all()


def test_people_without_a_labelled_head_are_blurred_whole(rig_session):
    labels = LabelSet.open(truth_path(rig_session))
    first = labels.read("000000")
    assert headless_of(first) == []
    persons = np.where((first.persons == 0) & (first.depth_mm > 0), np.uint8(2), first.persons)
    (other,) = headless_of(replace(first, persons=persons))
    np.testing.assert_array_equal(other, persons == 2)
