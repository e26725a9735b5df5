"""A recording written out as the README's folder keeps the colours and temperatures of its points."""

import json
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.labelset.label_set import LabelSet
from annotate.labelset.nameless import person_code
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics, project, rays
from sensors.rig.rig_calibration import Pose
from sensors.session.messages import SUBJECT
from sensors.session.reader import Session


def registered(
    image: np.ndarray, points_m: np.ndarray, camera: Intrinsics, pose: Pose, share: float
) -> np.ndarray:
    """An image's pixels at the places of depth's points (h, w, 3); 0 where hidden or without depth.

    share: of its depth by which a point behind the nearest one of its pixel and its neighbours is hidden.
    """
    seen = pose.apply(points_m)
    column, row = np.rint(np.nan_to_num(project(camera, seen), nan=-1)).astype(int).transpose(2, 0, 1)
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    nearest = np.full(camera.shape, np.inf, np.float32)
    np.minimum.at(nearest, (row[inside], column[inside]), seen[inside, 2].astype(np.float32))
    front = cv2.erode(nearest, np.ones((3, 3), np.uint8))
    inside[inside] &= seen[inside, 2] <= front[row[inside], column[inside]] * (1 + share)
    out = np.zeros((*inside.shape, *image.shape[2:]), image.dtype)
    out[inside] = image[row[inside], column[inside]]
    return out


@pytest.fixture(scope="module")
def folder(rig_session, tmp_path_factory) -> Path:
    """The rig's recording, written by OpenCV, colour and temperatures registered to depth by the geometry."""
    out, session = tmp_path_factory.mktemp("readme"), Session(rig_session)
    rig = session.calibration
    for name in ("depth", "color", "thermal"):
        (out / name).mkdir()
    camera = {name: value for name, value in asdict(rig.depth).items() if value or name[0] != "k"}
    (out / "intrinsics.json").write_text(json.dumps(camera))
    for frame in session:
        points = np.where(frame.depth_mm > 0, frame.depth_mm / 1000.0, np.nan)[..., None] * rays(rig.depth)
        color = registered(frame.decode_color(), points, rig.color, rig.color_from_depth, 0.02)
        words = np.rint((np.nan_to_num(frame.thermal_c, nan=-100) + 100) * 100).astype(np.uint16)
        thermal = registered(words, points, rig.thermal, rig.thermal_from_depth, 0.1)
        for name, image in (("depth", frame.depth_mm), ("color", color[..., ::-1]), ("thermal", thermal)):
            cv2.imwrite(str(out / name / f"{frame.index}.png"), image)
    return out


def test_points_have_the_colours_and_temperatures_of_the_recording(rig_session, folder):
    session, source = Session(rig_session), open_source(folder)
    one, other = Fuser(session.calibration), Fuser(source.calibration)
    for recorded, aligned in zip(session, source, strict=True):
        a, b = one.fuse_frame(recorded), other.fuse_frame(aligned)
        np.testing.assert_array_equal(a.depth_mm, b.depth_mm)
        assert (b.color_valid | ~a.color_valid).all()
        same = np.abs(a.color_rgb.astype(int) - b.color_rgb).max(axis=-1) < 40
        assert same[a.color_valid].mean() > 0.97
        both = np.isfinite(a.temperature_c) & np.isfinite(b.temperature_c)
        assert both.sum() > 0.9 * np.isfinite(a.temperature_c).sum()
        assert np.median(np.abs(a.temperature_c - b.temperature_c)[both]) < 0.5


def test_the_command_prints_what_it_assumes_and_keeps_the_subject(annotate_cloud, folder, tmp_path):
    out = tmp_path / "x.mcap"
    done = annotate_cloud("import", folder, out, "--subject", "anna", "--rate", "10", "--depth-unit", "1")
    for text in (
        "intrinsics from intrinsics.json",
        "1 mm a step (declared)",
        "at the 1st, 50th and 99th percentile; no reading: ",
        "10 frames a second as declared, in the natural order of names",
        "colour assumed to be aligned with depth pixel for pixel",
        "depth camera: 512x424, focal length 365.2 px (70 degrees wide), with a lens; colour camera at",
    ):
        assert text in done.err, done.err
    session = Session(out)
    assert (session.subject, session.metadata[SUBJECT]) == ("anna", "anna")
    assert np.diff(session.times_ns).tolist() == [100_000_000] * (len(session) - 1)
    annotate_cloud("predict", out, "--out", tmp_path / "p")
    labels = LabelSet.open(tmp_path / "p")
    assert {frame.subject for frame in labels} == {person_code("anna")}
    refused = annotate_cloud("import", folder, tmp_path / "labels", "--turn", "90")
    assert refused.code != 0 and "out.mcap" in refused.err


def test_doubts_are_printed_by_every_verb(annotate_cloud, folder, tmp_path):
    """Depth that a user declared wrongly stays in the session; every verb warns."""
    annotate_cloud("import", folder, tmp_path / "x.mcap", "--depth-unit", "10")
    info = annotate_cloud("info", tmp_path / "x.mcap")
    checked = annotate_cloud("validate", tmp_path / "x.mcap")
    predicted = annotate_cloud("predict", tmp_path / "x.mcap", "--out", tmp_path / "p")
    for text in (info.out, checked.out, predicted.err):
        assert "doubtful depth: nothing is nearer than" in text
    assert checked.code == 0 and "no other problems found" in checked.out
