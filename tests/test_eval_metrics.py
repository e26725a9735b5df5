"""Laws of confusion matrices and borders: a slow reference, closed forms, symmetries."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.ndimage import distance_transform_edt

from annotate.parts import LEFT_RIGHT, N_CLASSES, PAPER, UNDEFINED, on_body, swap_left_right
from eval.compare import paper_results as paper
from eval.scores import boundary, confusion, kernels
from tests.helpers.naive_scores import BODY, Frame, ious, mean, pixels_of

LABELS = st.sampled_from([0, 1, 2, 3, 4, 9, UNDEFINED])  # most classes absent, as in real frames
PAIR = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9).flatmap(
    lambda shape: st.tuples(*[hnp.arrays(np.uint8, shape, elements=LABELS)] * 2)
)


def body(seed: int = 0, size: int = 48) -> np.ndarray:
    """A label map with every part in blobs on background."""
    rng = np.random.default_rng(seed)
    seeds = rng.integers(0, size, (N_CLASSES * 2, 2))
    v, u = np.mgrid[:size, :size]
    nearest = ((v[..., None] - seeds[:, 0]) ** 2 + (u[..., None] - seeds[:, 1]) ** 2).argmin(-1)
    return (nearest % N_CLASSES).astype(np.uint8)


@given(st.lists(PAIR, min_size=1, max_size=5))
def test_mean_ious_agree_with_a_slow_reference(pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    table = [ious(pixels_of(Frame(*pair, None, math.nan)), BODY) for pair in pairs]
    result = confusion.mean_ious(np.stack([confusion.confusion_matrix(*pair, PAPER) for pair in pairs]))
    by_frame = [mean(row) for row in table]
    np.testing.assert_allclose(result["over_images"], mean(by_frame), atol=1e-12)
    by_part = [mean(list(column)) for column in zip(*table, strict=True)]
    np.testing.assert_allclose(result["over_parts"], mean(by_part), atol=1e-12)
    present = [v for v in by_frame if not math.isnan(v)]
    np.testing.assert_allclose(result["worst"], min(present) if present else math.nan, atol=1e-12)


@given(PAIR)
def test_every_pixel_is_counted_and_every_wrong_one_has_one_kind(pair: tuple[np.ndarray, np.ndarray]) -> None:
    matrix, (ignored, unnamed, everything) = confusion.counted(*pair, PAPER)
    assert matrix.sum() + ignored == everything == pair[0].size
    undefined = pair[0] == UNDEFINED, pair[1] == UNDEFINED
    assert (ignored, unnamed) == (undefined[0].sum(), (undefined[1] & ~undefined[0]).sum())
    kinds = confusion.error_kinds(matrix, PAPER)
    assert sum(kinds.values()) == matrix.sum() - np.trace(matrix) and min(kinds.values()) >= 0


def test_a_left_right_swap_is_caught() -> None:
    truth = body()
    matrix = confusion.confusion_matrix(truth, swap_left_right(truth), PAPER)
    assert confusion.left_right_swap_rate(matrix, PAPER) == 1.0
    assert confusion.error_kinds(matrix, PAPER)["left_right_swap"] == matrix.sum() - np.trace(matrix)
    assert confusion.flip_helps(matrix, PAPER)
    assert not confusion.flip_helps(confusion.confusion_matrix(truth, truth, PAPER), PAPER)
    np.testing.assert_array_equal(confusion.iou(confusion.merge_left_right(matrix, PAPER)), 1.0)
    assert confusion.person_iou(matrix, PAPER) == 1.0


def test_merging_twins_is_the_confusion_of_merged_labels() -> None:
    truth, predicted = body(1), body(2)
    to_left = np.arange(256, dtype=np.uint8)
    for left, right in LEFT_RIGHT:
        to_left[right] = left
    merged = confusion.confusion_matrix(to_left[truth], to_left[predicted], PAPER)
    kept = np.unique(to_left[:N_CLASSES])
    expected = merged[np.ix_(kept, kept)]
    np.testing.assert_array_equal(
        confusion.merge_left_right(confusion.confusion_matrix(truth, predicted, PAPER), PAPER), expected
    )


def test_absent_and_undefined_are_neither_right_nor_wrong() -> None:
    truth = np.array([[1, 1, 2, UNDEFINED]], np.uint8)
    predicted = np.array([[1, UNDEFINED, 2, 3]], np.uint8)
    matrix, undefined = confusion.counted(truth, predicted, PAPER)
    np.testing.assert_array_equal(confusion.recall(matrix)[1:3], [0.5, 1.0])
    assert np.isnan(confusion.iou(matrix)[3:]).all()
    assert confusion.mean_recall(matrix) == 0.75
    np.testing.assert_array_equal(undefined, [1, 1, 4])
    assert np.isnan(confusion.mean_recall(np.zeros((12, 12), np.int64)))


def test_wrong_maps_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(2, 2\)"):
        confusion.confusion_matrix(np.zeros((2, 2), np.uint8), np.zeros((2, 3), np.uint8), PAPER)
    with pytest.raises(ValueError, match="label 12"):
        confusion.confusion_matrix(np.zeros((1, 1), np.uint8), np.full((1, 1), 12, np.uint8), PAPER)


def test_the_paper_tables_are_the_paper_s() -> None:
    assert paper.SYNTHETIC.mean_recall == pytest.approx(0.8636, abs=5e-5)
    assert paper.REAL.mean_recall == pytest.approx(0.7318, abs=5e-5)
    for table in (paper.SYNTHETIC.table, paper.REAL.table):
        np.testing.assert_allclose(table.sum(1), 1.0, atol=0.021)
        assert table[0, 0] == 1.0
    assert paper.REAL.table[1, 2] == 0.22 and paper.REAL.table[7, 2] == 0.25  # quoted in section 4.2.2


def f_of(truth: np.ndarray, predicted: np.ndarray, tolerance: float) -> float:
    borders = kernels.borders(truth), kernels.borders(predicted)
    return float(boundary.boundary_f(boundary.boundary_counts(*borders, [tolerance])[0]))


def test_boundary_f_knows_how_far_a_border_moved() -> None:
    truth = np.zeros((30, 40), np.uint8)
    truth[5:25, 5:35] = 2
    moved = np.roll(truth, 2, axis=1)
    assert f_of(truth, moved, 2.0) == 1.0 and f_of(truth, moved, 1.0) < 0.8
    assert f_of(body(), body(), 0.0) == 1.0
    assert np.isnan(boundary.boundary_f(np.zeros(4, np.int64)))
    assert boundary.boundary_f(np.array([0, 9, 0, 0])) == 0.0


def away_from(labels: np.ndarray, reach: float = 100.0, around: float = 100.0) -> np.ndarray:
    return kernels.distances(labels, kernels.borders(labels), reach, around)


def test_boundary_iou_sees_a_shift_that_plain_iou_forgives() -> None:
    """A square of 60 pixels, moved by 1: of a band 2 wide half stays along the two sides that moved."""
    truth = np.zeros((100, 100), np.uint8)
    truth[20:80, 20:80] = 1
    moved = np.roll(truth, 1, axis=1)
    away = away_from(truth), away_from(moved)
    hit, either = boundary.band_counts(truth, moved, away, [2.0], N_CLASSES)[0, 1]
    band = 60 * 60 - 56 * 56
    kept = 2 * 2 * 59 + 2 * 56 * 1  # rows above and below without a column; one of two columns beside
    assert [hit, either] == [kept, 2 * band - kept]
    assert hit / either < 0.65 < confusion.iou(confusion.confusion_matrix(truth, moved, PAPER))[1]


def test_errors_by_distance_agree_with_scipy() -> None:
    truth, predicted = body(3), body(4)
    away = distance_transform_edt(kernels.borders(truth) == 0)
    counts = kernels.errors(
        truth, predicted, away_from(truth), np.array(boundary.DISTANCE_EDGES_PX, np.float32), N_CLASSES
    )
    edges = (0.0, *boundary.DISTANCE_EDGES_PX, np.inf)
    for i, (low, high) in enumerate(itertools.pairwise(edges)):
        for part in range(1, N_CLASSES):
            inside = (truth == part) & (away >= low) & (away < high)
            assert counts[part, i].tolist() == [(inside & (truth != predicted)).sum(), inside.sum()]
    assert not counts[0].any()


@given(PAIR, st.floats(0, 12), st.floats(0, 12))
def test_distances_agree_with_scipy(pair: tuple[np.ndarray, np.ndarray], reach: float, around: float) -> None:
    border = kernels.borders(pair[0])
    away = distance_transform_edt(border == 0) if border.any() else np.full(border.shape, np.inf)
    most = np.where(on_body(pair[0]), reach, around)
    expected = np.where(away <= most, away, np.inf).astype(np.float32)
    np.testing.assert_array_equal(away_from(pair[0], reach, around), expected)
