"""Unsure pieces apart from the body: doubtful places, frames to review first (annotate/cloud/pieces.py)."""

import numpy as np
import pytest

from annotate.cloud.pieces import pieces_apart, unsure_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.doubtful_places import doubts
from annotate.frame_labels import FrameLabels
from annotate.label_recording import Run
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID
from annotate.segmentation.segment import UNSURE_ISLAND
from sensors.rig.camera import Intrinsics, rays

CAMERA = Intrinsics(80, 60, 80.0, 80.0, 39.5, 29.5)  # at 2 m a pixel is 25 mm wide
LEG = PART_ID["left_lower_leg"]


def seen(gap_px: int = 20, beyond_m: float = 0.0, side_px: int = 6) -> tuple[ThermalCloud, np.ndarray]:
    """Return a cloud with a body of columns 5 to 29 at 2 m, and parts with a square piece beside it."""
    parts, depth_m = np.zeros(CAMERA.shape, np.uint8), np.full(CAMERA.shape, 4.0)
    parts[5:55, 5:30], depth_m[5:55, 5:30] = PART_ID["torso"], 2.0
    piece = np.s_[20 : 20 + side_px, 30 + gap_px : 30 + gap_px + side_px]
    parts[piece], depth_m[piece] = LEG, 2.0 + beyond_m
    points = (rays(CAMERA) * depth_m[..., None]).astype(np.float32)
    rgb, unknown = np.zeros((*CAMERA.shape, 3), np.uint8), np.full(CAMERA.shape, np.nan, np.float32)
    seen_by_color = np.zeros(CAMERA.shape, np.bool_)
    depth_mm = (depth_m * 1000).astype(np.uint16)
    return ThermalCloud(CAMERA, depth_mm, points, rgb, seen_by_color, unknown), parts


def sure_of(parts: np.ndarray, of_leg: float) -> np.ndarray:
    return np.where(parts == LEG, of_leg, np.where(parts > 0, 0.95, 0)).astype(np.float32)


@pytest.mark.parametrize(
    ("where", "sure", "found"),
    [
        ({}, 0.7, 1),
        ({}, 0.9, 0),
        ({"gap_px": 1}, 0.7, 0),
        ({"gap_px": 0, "beyond_m": 0.5}, 0.7, 1),
        ({"side_px": 1}, 0.7, 0),
    ],
)
def test_an_island_is_apart_and_unsure_and_no_speck(where, sure, found):
    cloud, parts = seen(**where)
    islands = unsure_islands(cloud, parts > 0, sure_of(parts, sure))
    assert len(islands) == found
    for pixels in islands:
        np.testing.assert_array_equal(pixels, np.flatnonzero(parts == LEG))


def test_pieces_hold_the_mask_and_the_largest_is_first():
    cloud, parts = seen()
    ids = pieces_apart(parts > 0, cloud.points_m)
    np.testing.assert_array_equal(ids, np.select([parts == LEG, parts > 0], [2, 1], 0))
    assert not pieces_apart(np.zeros(CAMERA.shape, np.bool_), cloud.points_m).any()


def test_an_unsure_island_is_a_doubtful_place_until_it_is_corrected():
    cloud, parts = seen()
    frame = FrameLabels("a", cloud.depth_mm, parts, sure_of(parts, 0.7))
    (doubt,) = doubts(frame, parts, cloud=cloud)
    assert "36 pixels, apart from the body, confidence 0.70" in doubt.reason
    assert not doubts(frame, np.where(parts == LEG, 0, parts).astype(np.uint8), cloud=cloud)


def test_frames_with_an_unsure_island_are_reviewed_first(tmp_path):
    cloud, parts = seen()
    labels = LabelSet.create(tmp_path / "labels", CAMERA, {})
    for name, mean, remarks in (("a", 0.8, []), ("b", 0.97, [UNSURE_ISLAND]), ("c", 0.7, ["other"])):
        labels.write(FrameLabels(name, cloud.depth_mm, parts, notes={"confidence": mean, "notes": remarks}))
    assert Run(labels, ()).review_order() == ["b", "c", "a"]
