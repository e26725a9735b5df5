"""Selections: shapes on a view and pieces of the surface take the pixels that they show."""

import numpy as np
import pytest

from annotate.correction import select
from annotate.correction.edit import Editor
from annotate.correction.select import edit_supervoxels
from annotate.frame_labels import FrameLabels
from annotate.gui.state.drawing import Drawing
from annotate.labelset.stroke import Gesture
from sensors.rig.camera import Intrinsics

H, W = 9, 13


def view_of(points_m: np.ndarray, size_px: tuple[int, int] = (200, 150)) -> select.ScreenPoints:
    """A pinhole view of points (n, 3)."""
    xy = 100 * points_m[:, :2] / points_m[:, 2:] + np.array([100, 75])
    return select.ScreenPoints(xy.astype(np.float32), points_m[:, 2].astype(np.float32), size_px)


def scattered(n: int = 3000, seed: int = 0) -> select.ScreenPoints:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-20, 220, (n, 2)).astype(np.float32)
    xy[:50] = np.nan
    return select.ScreenPoints(xy, np.full(n, 2, np.float32), (200, 150))


def rectangle(view: select.ScreenPoints, corner_px, opposite_px, through: bool = False) -> np.ndarray:
    return Drawing("rectangle", corner_px, through=through, points_px=[corner_px, opposite_px]).pixels(view)


@pytest.mark.parametrize("shape", ["brush", "lasso"])
def test_a_shape_takes_the_points_within_it(shape):
    view, angle = scattered(), np.linspace(0, 2 * np.pi, 200, endpoint=False)
    start, end = np.array([30.0, 20.0]), np.array([150.0, 110.0])
    if shape == "brush":
        along = np.clip((view.xy_px - start) @ (end - start) / np.square(end - start).sum(), 0, 1)
        away = np.linalg.norm(view.xy_px - start - along[:, None] * (end - start), axis=1) - 15
        pixels = select.brush(view, np.stack([start, end]), 15.0, through=True)
    else:
        away = np.linalg.norm(view.xy_px - np.array([100, 75]), axis=1) - 50
        corners = np.stack([100 + 50 * np.cos(angle), 75 + 50 * np.sin(angle)], axis=1)
        pixels = select.polygon(view, corners, through=True)
    found = np.zeros(len(away), np.bool_)
    found[pixels] = True
    with np.errstate(invalid="ignore"):
        on_screen = (view.xy_px >= 0).all(axis=1) & (view.xy_px < view.size_px).all(axis=1)
    # The screen's pixels decide: a point is certain farther than a pixel's diagonal from the rim.
    assert found[on_screen & (away < -2)].all() and not found[~on_screen | (away > 2)].any()


def test_a_rectangle_on_the_depth_pane_takes_its_pixels():
    view = select.ScreenPoints.of_image(np.full((H, W), 1000, np.uint16), 4.0)
    found = rectangle(view, (8.5, 12.5), (23.5, 4.5))
    expected = np.zeros((H, W), np.bool_)
    expected[1:3, 2:6] = True
    np.testing.assert_array_equal(found, np.flatnonzero(expected))
    assert select.nearest(view, (4 * 5 + 2, 4 * 3 + 2)) == 3 * W + 5
    beyond = np.array([[-1e9, -1e9], [1e9, -1e9], [0, 1e9]])
    np.testing.assert_array_equal(select.polygon(view, beyond), np.arange(H * W))


def test_points_behind_are_chosen_only_through():
    v, u = np.mgrid[0:1:40j, 0:1:50j]
    front = np.stack([u.ravel() - 0.5, v.ravel() - 0.5, np.full(u.size, 1.0)], axis=1)
    back = front * 1.5
    hidden = np.arange(u.size, 2 * u.size)
    view = view_of(np.concatenate([front, back]))
    all_of_it = (0.0, 0.0), (200.0, 150.0)
    found = rectangle(view, *all_of_it)
    assert set(found) >= set(range(u.size)) and not set(found) & set(hidden)
    np.testing.assert_array_equal(rectangle(view, *all_of_it, through=True), np.arange(2 * u.size))
    assert select.nearest(view, (100, 75)) < u.size
    assert select.nearest(view, (2, 2)) is None


def test_a_click_takes_a_piece_and_the_next_one_what_it_touches():
    piece = np.full((20, 40), -1, np.int32)
    piece[:, :10], piece[:, 10:20], piece[:, 20:30] = 0, 1, 2
    parts = np.full((20, 40), 2, np.uint8)
    parts[:10, 10:20] = 3
    depth = np.full((20, 40), 1000, np.uint16)
    depth[:, 20:] = 1500
    first = select.supervoxel(piece, parts, 15 * 40 + 12)
    expected = np.zeros((20, 40), np.bool_)
    expected[10:, 10:20] = True
    np.testing.assert_array_equal(first, np.flatnonzero(expected))
    # Again: the piece beside it with the same part; not deeper pixels, not the other part.
    expected[:, :10] = True
    np.testing.assert_array_equal(select.grow(piece, parts, depth, first), np.flatnonzero(expected))
    assert not len(select.supervoxel(piece, parts, 39))
    assert not len(select.grow(piece, parts, depth, np.empty(0, np.int64)))


def test_one_click_mends_one_patch():
    camera = Intrinsics(160, 120, 360, 360, 79.5, 59.5)
    v, u = np.mgrid[:120, :160]
    depth = np.where((abs(u - 80) < 30) & (abs(v - 60) < 45), 1500, 2500).astype(np.uint16)
    depth += np.random.default_rng(0).integers(0, 6, depth.shape, np.uint16)
    depth[::7, ::5] = 0
    truth = np.where((depth > 0) & (depth < 2000), np.where(v < 60, 2, 7), 0).astype(np.uint8)
    parts = truth.copy()
    parts[(truth == 2) & (v > 45) & (u > 90)] = 7
    colors = np.where((truth == 2)[..., None], [200, 30, 30], [30, 30, 200]).astype(np.uint8)
    pieces = edit_supervoxels(FrameLabels("f", depth, parts), camera, colors)
    assert (pieces[truth > 0] >= 0).all() and (pieces[(depth == 0) | (depth > 2000)] == -1).all()
    editor, wrong, clicks = Editor(FrameLabels("f", depth, parts), "ann"), parts != truth, 0
    for piece in np.unique(pieces[wrong]):
        inside = (pieces == piece) & (parts == 7)
        if wrong[inside].mean() > 0.5:
            at = int(np.flatnonzero(inside)[0])
            editor.paint(select.supervoxel(pieces, editor.parts, at), 2, Gesture("supervoxel", 1))
            clicks += 1
    # The rest are pixels on the border that share a voxel of 12 mm.
    assert (editor.parts != truth).sum() < 0.15 * wrong.sum() and clicks <= wrong.sum() / 15
    assert (edit_supervoxels(FrameLabels("f", depth, np.zeros_like(parts)), camera) == -1).all()
