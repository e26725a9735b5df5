"""Every score agrees with a slow reference to 1e-12, whatever is absent or undefined."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from annotate.frame_labels import FrameLabels
from annotate.parts import N_CLASSES, PAPER, UNDEFINED
from eval.scores import confusion
from eval.scores.counts import FrameCounts, count, shapes
from eval.scores.reliability import reliability_curve
from eval.scores.scores import PART_SCORES, scores_of
from tests.helpers.naive_scores import Frame, by_name, scores

PART_IDS = st.sampled_from([0, 0, 1, 2, 3, 4, 9, UNDEFINED])  # most classes absent, as in real frames


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Label maps of patches: where each pixel were its own, every one would be border."""
    shape = draw(hnp.array_shapes(min_dims=2, max_dims=2, max_side=4))
    patch = draw(st.tuples(st.integers(1, 5), st.integers(1, 4)))
    maps = [
        np.kron(draw(hnp.arrays(np.uint8, shape, elements=PART_IDS)), np.ones(patch, np.uint8)) for _ in "tp"
    ]
    levels = hnp.arrays(np.uint8, maps[0].shape, elements=st.integers(0, 255))
    confidence = draw(st.none() | levels.map(lambda level: level.astype(np.float32) / np.float32(255)))
    return Frame(maps[0], maps[1].astype(np.uint8), confidence, draw(st.sampled_from([math.nan, 3.3, 7.1])))


def labelled(parts: np.ndarray, confidence: np.ndarray | None = None) -> FrameLabels:
    return FrameLabels("f", np.full(parts.shape, 1500, np.uint16), parts, confidence)


def counted(frame: Frame) -> FrameCounts:
    return count(labelled(frame.truth), labelled(frame.predicted, frame.confidence), frame.mm_per_px)


def stack(frames: list[FrameCounts]) -> FrameCounts:
    return FrameCounts(np.stack([frame.flat for frame in frames]), PAPER)


@settings(deadline=None)
@given(st.lists(frames(), min_size=1, max_size=3))
def test_every_score_agrees_with_a_slow_reference(drawn: list[Frame]) -> None:
    """Of the sum of the frames, and of each frame of an array with a leading axis."""
    counts = FrameCounts(np.stack([counted(frame).flat for frame in drawn]), PAPER)
    together, summed = scores_of(counts), scores_of(counts.total())
    for frames_of, found in (
        (drawn, summed),
        *(([f], {n: v[i] for n, v in together.items()}) for i, f in enumerate(drawn)),
    ):
        expected = scores(frames_of)
        assert set(found) == set(expected)
        for name, value in expected.items():
            np.testing.assert_allclose(found[name], value, rtol=0, atol=1e-12, err_msg=name)
    assert all(together[name].shape == (len(drawn), 12) for name in PART_SCORES)


def test_a_perfect_prediction_scores_one_everywhere() -> None:
    truth = np.kron(np.arange(12, dtype=np.uint8).reshape(3, 4), np.ones((9, 9), np.uint8))
    found = scores_of(count(labelled(truth), labelled(truth, np.ones(truth.shape, np.float32)), 5.0))
    for name, value in found.items():
        wanted = 0.0 if name.startswith(("error", "ece", "left_right")) else 1.0
        np.testing.assert_array_equal(value[~np.isnan(value)], wanted, err_msg=name)
        assert not np.isnan(value).all(), name


def test_a_person_in_the_corner_and_nobody_at_all() -> None:
    """The box that is looked at never cuts off what counts."""
    truth = np.zeros((20, 30), np.uint8)
    truth[:3, :3] = 1
    guess = np.zeros_like(truth)
    guess[-2:, -2:] = 2
    found = scores_of(count(labelled(truth), labelled(guess), 5.0))
    assert found["mean_recall"] == found["boundary_f"] == 0.0 and found["error_rate_near"] == 1.0
    one = np.zeros((9, 9), np.uint8)
    one[4, 4] = 1
    alone = count(labelled(one), labelled(one), 5.0)
    assert alone.near.sum() == sum(math.hypot(v, u) < 3 for v in range(-4, 5) for u in range(-4, 5)) == 25
    nobody = count(labelled(np.zeros_like(truth)), labelled(np.zeros_like(truth)), math.nan)
    assert nobody.confusion[0, 0] == truth.size and np.isnan(scores_of(nobody)["mean_recall"])
    assert all(getattr(nobody, name).shape == shape for name, shape in shapes(N_CLASSES).items())


def test_reliability_tells_over_from_under_confidence() -> None:
    """Half of the pixels are right, told with confidence 0.8: too sure by 0.3."""
    truth = np.ones((20, 20), np.uint8)
    guess = np.where(np.arange(20) < 10, 1, 2).astype(np.uint8) * np.ones((20, 1), np.uint8)
    frame = labelled(guess, np.full(truth.shape, 0.8, np.float32))
    counts = count(labelled(truth), frame, math.nan)
    curve = reliability_curve(counts.reliability.sum(0))
    (filled,) = np.flatnonzero(curve.pixels)
    assert curve.pixels[filled] == 400 and curve.accuracy[filled] == 0.5
    assert curve.confidence[filled] == pytest.approx(0.8) and filled == 12
    assert scores_of(counts)["ece"] == pytest.approx(0.3)
    assert counts.label_quality[1].tolist() == [200 * 204 + 200 * 51, 400]


def test_maps_of_two_sizes_and_counts_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(4, 4\) but the prediction is \(4, 5\)"):
        count(labelled(np.ones((4, 4), np.uint8)), labelled(np.ones((4, 5), np.uint8)), 1.0)
    counts = counted(Frame(np.ones((4, 4), np.uint8), np.ones((4, 4), np.uint8), None, 1.0))
    with pytest.raises(ValueError, match="near is"):
        FrameCounts.of(PAPER, **by_name(counts) | {"near": counts.near[:3]})


def test_the_worst_frames_count_for_themselves() -> None:
    """With 40 frames the worst two of them are the worst case."""
    matrices = np.zeros((40, 12, 12), np.int64)
    matrices[:, 1, 1] = 100
    matrices[:2, 1, 1], matrices[:2, 1, 0] = 20, 80
    assert confusion.mean_ious(matrices)["worst"] == pytest.approx(0.2)
