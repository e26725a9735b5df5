"""Intervals cover a known mean, for few people as for many, and are about people, not frames."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from eval.scores import confusion, intervals
from tools.measure.coverage import DESIGNS, Design, coverage, miou_coverage

ALIKE = Design(subjects=20, frames=4, level=(40.0, 10.0), scatter=2.0)
"""People alike, unlike frames: drawing frames again inside subjects would cover 99 %."""


@pytest.mark.parametrize(
    "design",
    [*(DESIGNS[n] for n in ("8 people", "8 people, most of them easy", "100 people", "one person")), ALIKE],
)
def test_the_interval_covers_a_known_mean(design: Design) -> None:
    assert 0.93 <= coverage(design, sets=400, resamples=200, seed=1) <= 0.97


def test_the_interval_of_a_mean_iou_covers_too() -> None:
    assert 0.93 <= miou_coverage(8, sets=400, resamples=200, seed=1) <= 0.97


def test_the_width_is_students() -> None:
    degrees = np.array([1, 2, 3.7, 29, 1e6])
    np.testing.assert_allclose(intervals.quantile(degrees), stats.t.ppf(0.975, degrees), rtol=1e-12)


def test_frames_of_one_subject_are_resampled_together() -> None:
    """Without spread inside a subject, the spread is the variance of subject means / S."""
    counts = np.repeat(np.arange(10), 20)[:, None]
    clusters = intervals.clusters_of([f"s{i}" for i in counts[:, 0]])
    sums = intervals.resampled_sums(intervals.cluster_sums(counts, clusters), resamples=20000)[:, 0] / 200
    assert sums.var() == pytest.approx(np.arange(10).var() / 10, rel=0.05)
    error = intervals.standard_error(sums, 10)
    assert error == pytest.approx(np.arange(10).std(ddof=1) / math.sqrt(10), rel=0.03)


def test_frames_of_a_lone_subject_are_drawn_one_by_one() -> None:
    assert intervals.clusters_of(["anna"] * 4).tolist() == [0, 1, 2, 3]
    assert intervals.clusters_of(["b", "a", "b"]).tolist() == [1, 0, 1]
    mixed = intervals.clusters_of(["unknown", "a", "unknown", "a"]).tolist()
    assert mixed[1] == mixed[3] and len({*mixed}) == 3


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 6), st.integers(1, 8), st.integers(0, 5))
def test_an_interval_is_reproducible_ordered_and_holds_its_estimate(
    people: int, frames: int, seed: int
) -> None:
    counts = np.random.default_rng(seed).integers(1, 50, (people * frames, 144))
    clusters = intervals.clusters_of([f"s{i % people}" for i in range(people * frames)])
    sums = intervals.cluster_sums(counts, clusters)

    def once() -> np.ndarray:
        resampled = confusion.recall(intervals.resampled_sums(sums, 200).reshape(-1, 12, 12))
        return intervals.interval(estimate, resampled, len(sums))

    estimate = confusion.recall(counts.sum(0).reshape(12, 12))
    low, high = once()
    np.testing.assert_array_equal(once(), [low, high])
    if len(sums) == 1:
        assert np.isnan(low).all() and np.isnan(high).all()
    else:
        assert ((low >= 0) & (low <= estimate) & (estimate <= high) & (high <= 1)).all()


def test_an_interval_of_nothing_is_nan_and_of_equal_people_is_the_rule_of_three() -> None:
    nothing = intervals.interval(np.full(2, np.nan), np.full((10, 2), np.nan), 5)
    assert np.isnan(nothing).all()
    resamples = np.stack([np.ones(10), np.zeros(10), np.full(10, 0.4)], axis=-1)
    same = intervals.interval(np.array([1.0, 0.0, 0.4]), resamples, 5)
    np.testing.assert_allclose(same, [[0.4, 0.0, 0.16], [1.0, 0.6, 0.76]])
    np.testing.assert_allclose(intervals.interval(np.ones(()), np.ones(10), 2), [0.0, 1.0])
    assert np.isnan(intervals.interval(np.ones(()), np.ones(10), 1)).all()


@pytest.mark.parametrize("people", [8, 32, 100])
def test_no_error_in_n_people_allows_an_error_in_three_of_n(people: int) -> None:
    """The bound holds the largest share of people that shows no error in 5 % of the samples."""
    counts = np.tile([20, 20], (4 * people, 1))
    clusters = intervals.clusters_of([f"s{i % people}" for i in range(4 * people)])
    value, (low, high) = intervals.frames_interval(counts, clusters, lambda c: c[..., 0] / c[..., 1])
    assert (value, high) == (1.0, 1.0) and low == pytest.approx(1 - 3 / people)
    assert low <= 0.05 ** (1 / people) <= low + 0.1


def test_resamples_that_lack_a_part_are_left_out() -> None:
    """A part that 4 of 8 people show has the interval of those 4."""
    rng = np.random.default_rng(0)
    resamples = rng.normal(0.8, 0.01, (2000, 2))
    resamples[:400, 1] = np.nan
    ends = intervals.interval(np.array([0.8, 0.8]), resamples, np.array([8, 4]))
    width = ends[1] - ends[0]
    assert width[1] / width[0] == pytest.approx(
        3.182 * math.sqrt(4 / 3) / (2.365 * math.sqrt(8 / 7)), rel=0.1
    )
    assert np.isnan(intervals.interval(np.array(0.8), resamples[:, 0], 1)).all()


@pytest.mark.parametrize(
    ("subjects", "said"),
    [
        (["unknown"] * 9, "subjects unknown: drawn"),
        (["unknown"] * 50 + ["a", "b", "c", "d", "e"], "in 50 of 55 frames"),
        (["anna"] * 9, "one subject"),
        (["a", "b"] * 4, "2 subjects"),
        (list("abcd"), ""),
    ],
)
def test_what_an_interval_cannot_say_is_said(subjects: list[str], said: str) -> None:
    note = intervals.note_on(subjects)
    assert said in note and bool(note) == bool(said)
