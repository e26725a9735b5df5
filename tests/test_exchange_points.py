"""Labels of a cloud go back onto its own points, in its order and coordinates."""

import numpy as np
import pytest

from annotate.exchange.labelled_points import export_points
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import UNDEFINED
from sensors.errors import FormatError
from sensors.importers.clouds.cloud_source import CloudFile
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.ply_file import read_ply
from sensors.importers.open_source import open_source
from sensors.importers.options import ImportOptions
from tests.helpers.cloud_files import (
    CLOUD_FROM_CAMERA,
    camera_points,
    colored_pcd,
    pcd,
    ply,
    random_colors,
    room,
)
from tests.helpers.depth_files import write
from tests.helpers.samples import las

READERS = {"pcd": read_pcd, "ply": read_ply}


def known_parts(count: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 12, count, dtype=np.uint8)


def labelled(source, parts: np.ndarray, path) -> LabelSet:
    """A label set in which the pixel that shows each point has the point's part."""
    image = np.zeros(source.calibration.depth.shape, np.uint8)
    shown = source.pixels >= 0
    image.ravel()[source.pixels[shown]] = parts[shown]
    labels = LabelSet.create(path, source.calibration.depth, {})
    labels.write(FrameLabels("000000", source.frame(0).depth_mm, image))
    return LabelSet.open(path)


def shuffled(seed: int = 0) -> np.ndarray:
    """Points of the room in metres in the camera's frame, in random order, a few of them NaN."""
    points = camera_points(room()).reshape(-1, 3)
    rng = np.random.default_rng(seed)
    keep = np.isfinite(points).all(axis=1) | (rng.random(len(points)) < 0.01)
    return points[keep][rng.permutation(keep.sum())].astype(np.float32)


@pytest.mark.parametrize(("axes", "out"), [("camera", "ply"), *((axes, "pcd") for axes in CLOUD_FROM_CAMERA)])
def test_known_labels_go_round(tmp_path, axes, out):
    """Unorganised, coloured, in any axes and order: every point has its label, and is the point it was."""
    points = (shuffled() @ CLOUD_FROM_CAMERA[axes].T * 1000).astype(np.float32)
    source = open_source(write(tmp_path / "c.pcd", colored_pcd(points, random_colors(len(points)))))
    parts = known_parts(len(points))
    done = export_points(labelled(source, parts, tmp_path / "labels"), source.path, out, tmp_path / "out")
    finite = np.isfinite(points).all(axis=1)
    assert done == (len(points), np.count_nonzero(finite))
    back = READERS[out](tmp_path / "out" / f"000000.{out}")
    np.testing.assert_array_equal(back.points().astype(np.float32), points)
    np.testing.assert_array_equal(back.colors(), source.cloud.colors())
    np.testing.assert_array_equal(back.records["label"], np.where(finite, parts, UNDEFINED))


def test_a_grid_keeps_its_grid_its_viewpoint_and_all_fields(tmp_path):
    depth = room()
    points = camera_points(depth).reshape(-1, 3)
    layout = [("xyz", "<f4", 3), ("_", "u1", 4), ("h", "<f4", 5), ("label", "<u2")]
    records = np.zeros(len(points), layout)
    records["xyz"], records["label"] = points, 7
    records["h"] = np.random.default_rng(0).random((len(points), 5))
    header = {
        "FIELDS": "x y z _ h label",
        "SIZE": "4 4 4 1 4 2",
        "TYPE": "F F F U F U",
        "COUNT": "1 1 1 4 5 1",
    }
    content = pcd(points, *depth.shape[::-1], records.tobytes(), **header, VIEWPOINT="0.1 0 0 1 0 0 0")
    source = open_source(write(tmp_path / "c.pcd", content))
    parts = known_parts(len(points))
    export_points(labelled(source, parts, tmp_path / "labels"), source.path, "pcd", tmp_path / "out")
    back = read_pcd(tmp_path / "out" / "000000.pcd")
    assert back.grid == depth.shape and back.viewpoint.translation_m[0] == pytest.approx(0.1)
    np.testing.assert_array_equal(back.records["h"], records["h"])
    np.testing.assert_array_equal(back.records["label"], np.where(depth.ravel() > 0, parts, UNDEFINED))
    np.testing.assert_array_equal(back.points(), source.cloud.points())


def test_hidden_points_are_undefined_and_visible_ones_are_not(tmp_path):
    """A ball: its near half is seen, its far half is hidden by it."""
    directions = np.random.default_rng(0).normal(size=(20_000, 3))
    ball = 0.3 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [0.1, 0.2, 2.0]
    source = open_source(write(tmp_path / "ball.ply", ply(ball)))
    export_points(
        labelled(source, np.full(len(ball), 2), tmp_path / "labels"), source.path, "ply", tmp_path / "out"
    )
    label = read_ply(tmp_path / "out" / "000000.ply").records["label"]
    facing = (ball * (ball - [0.1, 0.2, 2.0])).sum(axis=1) / 0.3 / np.linalg.norm(ball, axis=1)
    assert (label[facing < -0.3] == 2).mean() > 0.99
    assert (label[facing > 0.3] == UNDEFINED).mean() > 0.98  # the rest lies in gaps
    assert set(np.unique(label)) == {2, UNDEFINED}


def test_coordinates_of_a_map_keep_their_digits(tmp_path):
    points = camera_points(room()).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)] @ CLOUD_FROM_CAMERA["z-up"].T
    source = open_source(write(tmp_path / "m.las", las(points, 500_000.0, False)))
    export_points(
        labelled(source, known_parts(len(points)), tmp_path / "l"), source.path, "pcd", tmp_path / "out"
    )
    back = read_pcd(tmp_path / "out" / "000000.pcd").points()
    np.testing.assert_allclose(back, points + 500_000.0, atol=0.0006)


def test_labels_of_another_cloud_are_refused_and_leave_nothing(tmp_path):
    points = shuffled()
    source = open_source(write(tmp_path / "c.ply", ply(points)))
    labels = labelled(source, known_parts(len(points)), tmp_path / "labels")
    other = write(tmp_path / "d.ply", ply(points * np.float32(1.1)))
    with pytest.raises(FormatError, match="shows another depth image than its labels"):
        export_points(labels, other, "ply", tmp_path / "out")
    assert not (tmp_path / "out").exists()


DECLARED = [
    ImportOptions(turn_deg=90),
    ImportOptions(turn_deg=180, depth_unit_mm=10),
    ImportOptions(axes="kinect"),
]


@pytest.mark.parametrize("options", DECLARED)
def test_labels_of_a_turned_import_go_back_too(tmp_path, options):
    """The label set shows what was declared at the import."""
    points = shuffled()
    plain = open_source(write(tmp_path / "c.ply", ply(points)))
    source = open_source(plain.path, options)
    depth = source.frame(0).depth_mm
    parts = np.random.default_rng(2).integers(0, 12, depth.shape, dtype=np.uint8)
    labels = LabelSet.create(tmp_path / "labels", source.calibration.depth, {})
    labels.write(FrameLabels("000000", depth, parts))
    export_points(LabelSet.open(tmp_path / "labels"), plain.path, "ply", tmp_path / "out")
    found = read_ply(tmp_path / "out" / "000000.ply").records["label"]
    quarters = options.turn_deg // 90
    own = np.rot90(parts, quarters)
    pixels = CloudFile(plain.path, options).pixels
    np.testing.assert_array_equal(found, np.where(pixels >= 0, own.ravel()[pixels], UNDEFINED))
    assert (pixels >= 0).mean() > 0.9


def test_a_mirrored_grid_gets_its_labels(tmp_path):
    depth = room()
    path = write(tmp_path / "c.pcd", pcd(camera_points(depth)[:, ::-1], *depth.shape[::-1]))
    source = open_source(path, ImportOptions(mirror=True))
    assert np.abs(source.frame(0).depth_mm.astype(int) - depth).max() <= 1
    parts = np.random.default_rng(2).integers(0, 12, depth.shape, dtype=np.uint8)
    labels = LabelSet.create(tmp_path / "labels", source.calibration.depth, {})
    labels.write(FrameLabels("000000", source.frame(0).depth_mm, parts))
    export_points(LabelSet.open(tmp_path / "labels"), path, "pcd", tmp_path / "out")
    found = read_pcd(tmp_path / "out" / "000000.pcd").records["label"].reshape(depth.shape)[:, ::-1]
    np.testing.assert_array_equal(found, np.where(depth > 0, parts, UNDEFINED))


def test_the_command_writes_labels_back(tmp_path, annotate_cloud):
    points = shuffled()
    source = open_source(write(tmp_path / "c.ply", ply(points)))
    parts = known_parts(len(points))
    labelled(source, parts, tmp_path / "labels")
    done = annotate_cloud(
        "export", tmp_path / "labels", tmp_path / "out", "--format", "pcd", "--session", tmp_path / "c.ply"
    )
    assert done.code == 0, done.err
    assert "points of" in done.out
    back = read_pcd(tmp_path / "out" / "000000.pcd")
    finite = np.isfinite(points).all(axis=1)
    np.testing.assert_array_equal(back.records["label"][finite], parts[finite])
    for format_ in ("coco", "pcd"):
        wrong = tmp_path / ("c.ply" if format_ == "coco" else "c.mcap")
        again = ("export", tmp_path / "labels", tmp_path / "more", "--format", format_, "--session", wrong)
        assert annotate_cloud(*again).code != 0 and not (tmp_path / "more").exists()
