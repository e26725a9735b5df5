"""Contact sheets of the worst frames: which frames, what they show, and where they are written."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID, palette_rgb
from eval.compare.compare import compare_sets
from sensors.rig.camera import Intrinsics
from tools.figures import table as measuring
from tools.figures import worst_frames
from tools.figures.figure import Figure
from tools.figures.pages import DIGEST_ROWS, SHEETS
from tools.figures.table import IMAGES, Table, load, measure
from tools.figures.tables import TABLES
from tools.figures.worst_frames import COUNT, MOST_BYTES, SIDE_PX, Tile

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
FRAMES = 14


def tiles(errors) -> list[Tile]:
    image = np.zeros((SIDE_PX, 2 * SIDE_PX, 3), np.uint8)
    return [Tile(error, f"{error}", image) for error in errors]


def test_frames_measured_in_pieces_are_ranked_together():
    pieces = [{"a": tiles(range(k, 40, 3)), f"only {k}": tiles([k])} for k in range(3)]
    found = worst_frames.together(pieces)
    assert [tile.error for tile in found["a"]] == list(range(39, 39 - COUNT, -1))
    assert set(found) == {"a", "only 0", "only 1", "only 2"}


@pytest.fixture
def sets(tmp_path):
    """Label sets of a torso and a head, of which frame n of the prediction lacks 2 n columns of the head."""
    predicted, truth = (LabelSet.create(tmp_path / name, CAMERA, {}) for name in ("p", "t"))
    for n in range(FRAMES):
        parts = np.zeros(CAMERA.shape, np.uint8)
        parts[20:40, 10:40], parts[5:20, 10:40] = PART_ID["torso"], PART_ID["head"]
        frame = FrameLabels(f"{n:06d}", np.where(parts, 2000, 0).astype(np.uint16), parts, subject="anna")
        truth.write(frame)
        lost = parts.copy()
        lost[5:20, 10 : 10 + 2 * n] = PART_ID["torso"]
        predicted.write(replace(frame, parts=lost))
    return predicted, truth


def test_the_frames_with_the_lowest_recall_are_drawn(sets):
    found = worst_frames.of_labels(compare_sets(*sets, workers=1), *sets)
    assert len(found) == COUNT
    for n, tile in zip(range(FRAMES - 1, 0, -1), found, strict=False):
        recall = (1 + 1 - 2 * n / 30) / 2
        assert tile.error == pytest.approx(1 - recall) and f"{n:06d}" in tile.text
        assert tile.text.startswith(f"mean recall {recall:.2f}, anna") and tile.image.shape[1] == 3 * SIDE_PX
    head = (found[0].image == palette_rgb()[PART_ID["head"]]).all(axis=-1)
    true, predicted = head[:, SIDE_PX : 2 * SIDE_PX].sum(), head[:, 2 * SIDE_PX :].sum()
    assert predicted / true == pytest.approx(4 / 30, abs=0.02)
    assert worst_frames.of_joints(compare_sets(*sets, workers=1), *sets) == []


def test_a_judges_joint_is_drawn_at_its_place():
    parts = np.zeros((60, 80), np.uint8)
    parts[10:50, 20:60] = PART_ID["torso"]
    depth_mm = np.where(parts, 2000 + 10 * np.arange(60)[:, None], 0).astype(np.uint16)
    for at in ((40.0, 40.0), (24.0, 34.0)):
        image = worst_frames.of_real((depth_mm, parts), np.array([at]), 0.5, "x").image[:, :SIDE_PX]
        flat = worst_frames.of_real((depth_mm, parts), np.zeros((0, 2)), 0.5, "x").image[:, :SIDE_PX]
        rows, columns = np.nonzero((image != flat).any(axis=-1))
        side = 40 * (1 + 2 * worst_frames.MARGIN)
        expected = (np.array(at) - (40 - side / 2, 30 - side / 2)) * SIDE_PX / side
        assert np.hypot(columns.mean() - expected[0], rows.mean() - expected[1]) < 5


def test_a_sheet_of_noise_is_small_enough(tmp_path):
    noise = np.random.default_rng(0).normal(128, 30, (SIDE_PX, 3 * SIDE_PX, 3)).clip(0, 255).astype(np.uint8)
    (path,) = worst_frames.write_sheets({"noise": [Tile(1.0, "x", noise)] * COUNT}, tmp_path / "new")
    assert path.name == "worst-noise.webp" and path.stat().st_size <= MOST_BYTES
    assert cv2.imread(str(path)).shape[0] > 5 * SIDE_PX


@pytest.mark.parametrize("kind", ["real", "virtual"])
def test_pictures_of_real_people_never_lie_in_the_documentation(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(measuring, "IMAGES", tmp_path / "images")
    monkeypatch.setattr(measuring, "BESIDE", tmp_path / "beside")
    rows = {"all": {"a": Figure(1.0)}}
    one = Table("one", kind, "", "", (), {"a": ".0f"}, lambda seed: rows, sheets=lambda _: {"x": tiles([1])})
    measure(one, "e68d388aa001", "p", tmp_path)
    assert [path.parent.name for path in tmp_path.rglob("*.webp")] == [
        "beside" if kind == "real" else "images"
    ]


def test_the_documentation_shows_sheets_and_rows_that_there_are():
    kept = {table.name: load(table) for table in TABLES}
    for name, row in DIGEST_ROWS.values():
        assert kept[name] is not None and row in kept[name].rows
    assert len(DIGEST_ROWS) <= 5
    assert {path.stem.removeprefix("worst-") for path in IMAGES.glob("worst-*")} <= SHEETS.keys()
