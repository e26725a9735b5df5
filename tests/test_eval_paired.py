"""Differences of results: paired and unpaired, with intervals that cover."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import wilcoxon

from annotate.parts import PAPER
from eval.compare.compare import Comparison
from eval.compare.difference import difference
from eval.compare.pairs import Digests
from eval.compare.results import Result
from eval.scores import confusion
from eval.scores.counts import FrameCounts, shapes
from eval.scores.traits import Traits
from tests.helpers.naive_scores import by_name
from tools.measure.coverage import paired_coverage, unpaired_coverage

FRAMES = 5
PIXELS = 1000


def result(title: str, rates: np.ndarray, seed: int = 0, session: str = "a") -> Result:
    """Frames of people whose parts are recalled at their own rates; missed pixels are background."""
    rng = np.random.default_rng(seed)
    n = len(rates) * FRAMES
    hits = rng.binomial(PIXELS, np.repeat(rates, FRAMES)[:, None], (n, 12))
    counts = {name: np.zeros((n, *shape), np.int64) for name, shape in shapes(PAPER.n_classes).items()}
    parts = np.arange(1, 12)
    counts["confusion"][:, parts, parts] = hits[:, parts]
    counts["confusion"][:, parts, 0] = PIXELS - hits[:, parts]
    frame_ids = tuple(f"{i:06d}" for i in range(n))
    comparison = Comparison(
        frame_ids=frame_ids,
        subjects=tuple(f"s{i // FRAMES}" for i in range(n)),
        traits=(Traits(),) * n,
        digests=tuple(Digests(f"{session}{i}", f"t{i}", f"p{title}{i}") for i in frame_ids),
        counts=FrameCounts.of(PAPER, **counts),
    )
    return Result(title, comparison)


LEVELS = np.linspace(0.55, 0.95, 8)


def test_a_result_against_itself_is_nothing() -> None:
    same = difference(result("A", LEVELS), result("A", LEVELS))
    assert same.paired and same.wilcoxon_p == {"mean_recall": 1.0, "miou": 1.0} and same.note == ""
    for name, value in same.scores.items():
        np.testing.assert_array_equal(value[~np.isnan(value)], 0.0, err_msg=name)
    np.testing.assert_array_equal(same.ci95["mean_recall"], 0.0)


def test_a_minus_b_is_minus_b_minus_a() -> None:
    a, b = result("A", LEVELS), result("B", LEVELS - 0.01, seed=1)
    there, back = difference(a, b), difference(b, a)
    for name in there.scores:
        np.testing.assert_array_equal(there.scores[name], -back.scores[name])
        np.testing.assert_allclose(there.ci95[name], -back.ci95[name][::-1], atol=1e-12)
    assert there.wilcoxon_p == back.wilcoxon_p


def test_pairing_sees_a_small_gain_that_people_s_differences_would_hide() -> None:
    a, b = result("A", LEVELS + 0.01), result("B", LEVELS, seed=1)
    paired = difference(a, b)
    assert paired.ci95["mean_recall"][0] > 0 and paired.wilcoxon_p["mean_recall"] < 0.05
    apart = difference(a, result("B", LEVELS, seed=1, session="b"))
    assert not apart.paired and apart.ci95["mean_recall"][0] < 0 < apart.ci95["mean_recall"][1]
    assert apart.scores["mean_recall"] == paired.scores["mean_recall"]
    assert "no frame in common" in apart.note and apart.wilcoxon_p == {"mean_recall": None, "miou": None}


def test_only_shared_frames_are_compared_in_any_order_and_with_any_names() -> None:
    a, b = result("A", LEVELS), result("B", LEVELS - 0.05, seed=1)
    names = tuple("zyxwvuts"[int(name[1:])] for name in b.comparison.subjects)
    b = Result("B", replace(b.comparison, subjects=names))
    order = np.random.default_rng(0).permutation(40)[:30]
    some = difference(a, Result("B", b.comparison.only(order)))
    again = difference(Result("A", a.comparison.only(np.sort(order))), Result("B", b.comparison.only(order)))
    assert some.paired and some.frames == (30, 30) and "10 frames of A and 0 of B" in some.note
    for name in some.scores:
        np.testing.assert_array_equal(some.scores[name], again.scores[name])
        np.testing.assert_array_equal(some.ci95[name], again.ci95[name])


def test_wilcoxon_is_scipy_s_on_the_subjects_means() -> None:
    a, b = result("A", LEVELS), result("B", LEVELS + np.linspace(-0.02, 0.04, 8), seed=1)
    by_subject = [
        confusion.miou(r.comparison.matrices.reshape(8, FRAMES, 12, 12).sum(axis=1)) for r in (a, b)
    ]
    assert difference(a, b).wilcoxon_p["miou"] == pytest.approx(wilcoxon(*by_subject).pvalue)
    few = [Result(r.title, r.comparison.only(np.arange(5 * FRAMES))) for r in (a, b)]
    assert difference(*few).wilcoxon_p == {"mean_recall": None, "miou": None}


def test_another_truth_of_the_same_frames_is_said() -> None:
    """A network against automatic and against corrected labels."""
    a = result("Automatic", LEVELS)
    digests = tuple(d._replace(truth="corrected") for d in a.comparison.digests)
    b = Result("Corrected", replace(a.comparison, digests=digests))
    found = difference(a, b)
    assert found.paired and found.note == "40 of 40 frames have different truths in A and B"


def test_a_part_that_one_side_lacks_is_null_in_the_json() -> None:
    a, b = result("A", LEVELS), result("B", LEVELS, session="b")
    matrices = b.comparison.matrices.copy()
    matrices[:, 1] = matrices[:, :, 1] = 0
    lacking = FrameCounts.of(PAPER, **by_name(b.comparison.counts) | {"confusion": matrices})
    b = Result("B", replace(b.comparison, counts=lacking))
    shown = json.loads(json.dumps(difference(a, b).to_json(), allow_nan=False))
    assert shown["difference"]["recall"]["head"] is None and shown["ci95"]["recall"]["head"] == [None, None]
    assert isinstance(shown["difference"]["recall"]["torso"], float)


def test_with_one_person_it_is_said_whose_frames_they_are() -> None:
    a, b = result("A", LEVELS[:1]), result("B", LEVELS[:1] - 0.1, seed=1)
    found = difference(a, b)
    assert "one subject" in found.note and found.ci95["miou"][0] > 0 and found.subjects == (1, 1)
    one = [Result(r.title, r.comparison.only(np.array([0]))) for r in (a, b)]
    assert np.isnan(difference(*one).ci95["miou"]).all()


@pytest.mark.parametrize(
    ("coverage", "subjects"),
    [(paired_coverage, 4), (paired_coverage, 8), (unpaired_coverage, (8, 8)), (unpaired_coverage, (30, 8))],
)
def test_the_interval_of_a_difference_covers(coverage, subjects) -> None:
    assert 0.93 <= coverage(subjects, sets=400, resamples=200, seed=1) <= 0.97
