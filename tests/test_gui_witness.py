"""Joints and outline of a colour network: their note in a frame, and their drawing in the window."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtGui import QImage, QPainter

from annotate.gui.widgets.witness import RGB, Witness, draw_witness
from annotate.labelset.label_set import LabelSet
from annotate.witness.shown_person import ShownPerson, shown_people
from annotate.witness.skeleton import JOINT, JOINTS, Skeleton
from sensors.rig.camera import project
from tests.helpers.gui_driver import Driver

NECK, PELVIS = JOINT["neck"], JOINT["pelvis"]


def person(joints_m: dict[str, tuple[float, float, float]], mask=None) -> ShownPerson:
    at = np.full((len(JOINTS), 3), np.nan)
    for name, place in joints_m.items():
        at[JOINT[name]] = place
    return ShownPerson.of(Skeleton(at, np.zeros(len(JOINTS)), 0.5), mask)


def test_a_note_holds_sure_joints_and_the_masks_border():
    mask = np.zeros((48, 64), np.bool_)
    mask[10:30, 20:40] = True
    mask[15:20, 25:30] = False
    shown = person({"neck": (0.1, 0.2, 1.5)}, mask)
    note = shown.note()
    assert note["joints_mm"] == {"neck": [100.0, 200.0, 1500.0]}
    back = ShownPerson.from_note(note)
    np.testing.assert_allclose(back.joints_mm, shown.joints_mm)
    corners = [set(map(tuple, one.astype(int).tolist())) for one in back.outlines]
    assert {(20, 10), (39, 10), (39, 29), (20, 29)} in corners
    assert len(corners) == 2
    own = {"bearing": {"witness": note, "others": {"2": {"witness": person({}).note()}, "3": {}}}}
    assert [np.isfinite(one.joints_mm).any() for one in shown_people(own)] == [True, False]
    assert shown_people({}) == shown_people({"bearing": "x"}) == []


@pytest.mark.parametrize(
    "note",
    [
        *(None, {}, {"joints_mm": {}, "outlines": 3}, {"joints_mm": [], "outlines": []}),
        *(
            {"joints_mm": {"tail": [1, 2, 3]}, "outlines": []},
            {"joints_mm": {"neck": [1, 2]}, "outlines": []},
        ),
        {"joints_mm": {}, "outlines": [[1, 2, 3]]},
        {"joints_mm": {}, "outlines": [[[0, 0]] * 20_000]},
        {"joints_mm": {"neck": [1e9, 0, 1]}, "outlines": []},
        {"joints_mm": {}, "outlines": [[[float("nan"), 0]]]},
    ],
)
def test_malformed_notes_are_left_out(note):
    assert ShownPerson.from_note(note) is None


@pytest.fixture
def window(qapp, rig_labels, rig_session, tmp_path):
    """A window on a labelled frame whose witness shows a trunk, and on one without."""
    shutil.copytree(rig_labels.path, tmp_path / "labels")
    labels = LabelSet.open(tmp_path / "labels")
    frame = labels.read(labels.frame_ids[0])
    middle = np.argwhere(frame.on_body).mean(axis=0)
    camera = labels.intrinsics
    x, y = (middle[1] - camera.cx) / camera.fx * 2, (middle[0] - camera.cy) / camera.fy * 2
    shown = person({"neck": (x, y - 0.2, 2), "pelvis": (x, y + 0.2, 2)}, frame.on_body)
    labels.write_labels(replace(frame, notes={**frame.notes, "bearing": {"witness": shown.note()}}))
    driver = Driver(tmp_path / "labels", rig_session)
    yield driver, shown
    driver.close()


def test_a_key_draws_joints_and_outline_at_their_places(window):
    driver, shown = window
    depth, cloud = driver.views.depth, driver.views.cloud
    assert depth.layer.witness() is None
    driver.key("witness")
    drawn = depth.layer.witness()
    camera = driver.edits.frame.scene.cloud.camera
    u, v = project(camera, shown.joints_mm[[NECK]])[0]
    pixel = round(v) * camera.width + round(u)
    near = depth.place_of(pixel)
    assert np.abs(drawn.joints[0][NECK] - (near.x(), near.y())).max() < 20
    assert len(drawn.outlines) == len(shown.outlines)
    neck, pelvis = cloud.layer.witness().joints[0][[NECK, PELVIS]]
    # The camera's own view: the image and space agree, up to a scale.
    assert abs(neck[0] - pelvis[0]) < 0.1 * (pelvis[1] - neck[1])
    assert not cloud.layer.witness().outlines
    before = neck
    cloud.bring(pixel)
    assert not np.array_equal(cloud.layer.witness().joints[0][NECK], before)
    driver.key("next")
    assert depth.layer.witness() is None
    driver.key("witness")
    driver.key("witness")
    assert "No colour network labelled this frame" in driver.said


def test_unknown_joints_are_not_drawn(qapp):
    joints = np.full((len(JOINTS), 2), np.nan)
    joints[NECK], joints[PELVIS], joints[JOINT["head"]] = (20, 10), (20, 40), (np.nan, 5)
    image = QImage(64, 64, QImage.Format.Format_RGB888)
    image.fill(0)
    painter = QPainter(image)
    draw_witness(painter, Witness([joints], [np.array([[50.0, 5], [60, 5], [60, 15]])]))
    painter.end()
    rgb = np.frombuffer(image.constBits(), np.uint8).reshape(64, -1)[:, : 3 * 64].reshape(64, 64, 3)
    assert np.abs(rgb[25, 20].astype(int) - RGB).max() < 60
    assert rgb[:, 45:].any()
    assert not rgb[:, :14].any()
    assert not rgb[48:].any()
