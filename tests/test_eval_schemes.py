"""Scores in any scheme: laws of conversion, person and things, and the paper's numbers as before."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from annotate.labelset.convert import convert
from annotate.labelset.label_set import LabelSet
from annotate.parts import PAPER
from annotate.scheme.merging import conversion_table, converts, finest_common
from annotate.scheme.scheme import BACKGROUND, Scheme, scheme_of
from annotate.scheme.scheme_file import SHIPPED, load_scheme
from eval.compare.common_scheme import converted, converted_counts
from eval.compare.compare import Comparison, compare_sets
from eval.compare.details import details
from eval.compare.difference import difference
from eval.compare.results import Result, load_result, save_result
from eval.report import numbers
from eval.report.frame_images import ERROR_KINDS, error_kind_ids
from eval.report.gather import Material, Sources, gather
from eval.report.page import render
from eval.scores import confusion
from eval.scores.counts import FrameCounts, count
from eval.scores.scores import FROM_CONFUSION, PART_SCORES, scores_of
from sensors.errors import FormatError
from tests.helpers.naive_scores import by_name
from tests.helpers.patches import pair, write_set
from tests.helpers.schemes import WARD

SCHEMES = [*map(load_scheme, SHIPPED), WARD]
HANDS, SIX = load_scheme("hands-and-feet"), load_scheme("six")
COARSER = [(a, b) for a in SCHEMES for b in SCHEMES if a != b and converts(a, b)]
COUNTS_OF_BEFORE = "c91ee135fad72e783de09815b23001e3be66336a55c75e6f48658cc7084a2da6"
SCORES_OF_BEFORE = "952db58a3a8b5e13435dd51ee028326f5c81a677e5674ecab28473287885bfa6"
RESULT_OF_BEFORE = Path(__file__).parent / "helpers" / "result_schema_7.npz"
by_pair = pytest.mark.parametrize(
    ("fine", "coarse"), COARSER, ids=lambda scheme: scheme.name if isinstance(scheme, Scheme) else None
)
by_scheme = pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)


def in_scheme(frame: FrameLabels, scheme: Scheme) -> FrameLabels:
    return converted(frame, scheme, conversion_table(frame.scheme, scheme))


def counts_of(frames: tuple[FrameLabels, FrameLabels]) -> FrameCounts:
    return count(frames[1], frames[0], 5.0)


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[LabelSet, LabelSet]]:
    """A prediction and its truth in each of four schemes, over the same depth images."""
    folder, found = tmp_path_factory.mktemp("sets"), {}
    for scheme in (PAPER, HANDS, SIX, WARD):
        pairs = [pair(seed, scheme) for seed in range(4)]
        found[scheme.name] = (
            write_set(folder / f"{scheme.name}-labels", [guess for guess, _ in pairs]),
            write_set(folder / f"{scheme.name}-truth", [truth for _, truth in pairs]),
        )
    return found


@pytest.fixture(scope="module")
def compared(sets: dict[str, tuple[LabelSet, LabelSet]]) -> dict[str, Comparison]:
    return {name: compare_sets(*both, workers=1) for name, both in sets.items()}


def test_the_paper_s_numbers_are_those_of_before_schemes(tmp_path: Path) -> None:
    """To the bit: counts, scores and groups; and the result that the version before wrote opens as it was."""
    pairs = [pair(seed) for seed in range(12)]
    both = [write_set(tmp_path / str(i), [one[i] for one in pairs]) for i in (0, 1)]
    found = compare_sets(*both, workers=1)
    assert hashlib.sha256(found.counts.flat.tobytes()).hexdigest() == COUNTS_OF_BEFORE
    scores = found.to_evaluation_json()
    del scores["ci95"], scores["scheme"]  # the first depends on the processor, the second is new
    assert hashlib.sha256(json.dumps(scores, sort_keys=True).encode()).hexdigest() == SCORES_OF_BEFORE
    before = load_result(RESULT_OF_BEFORE).comparison
    assert before.scheme == PAPER and before.digests == found.digests and before.traits == found.traits
    np.testing.assert_array_equal(before.counts.flat, found.counts.flat)
    assert before.to_evaluation_json() == found.to_evaluation_json()


@by_pair
def test_scores_in_a_coarser_scheme_are_those_of_labels_converted_first(fine: Scheme, coarse: Scheme) -> None:
    """And the person's IoU is the same in both."""
    frames = pair(3, fine)
    guess, truth = (in_scheme(frame, coarse) for frame in frames)
    first, then = counts_of(frames), counts_of((guess, truth))
    merged = converted_counts(first, coarse, conversion_table(fine, coarse))
    np.testing.assert_array_equal(merged.confusion, then.confusion)
    np.testing.assert_array_equal(merged.undefined, then.undefined)
    a, b = scores_of(merged), scores_of(then)
    for name in FROM_CONFUSION:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    assert scores_of(first)["person_iou"] == b["person_iou"] and 0.3 < b["person_iou"] < 1


def test_sets_are_compared_in_a_scheme_as_if_converted_first(tmp_path: Path, sets: dict) -> None:
    guess, truth = sets["ward"]
    first = compare_sets(guess, truth, workers=1, scheme=SIX)
    made = [
        convert(labels, SIX, tmp_path / labels.path.name, lambda n: None, overwrite=False)
        for labels in (guess, truth)
    ]
    then = compare_sets(*made, workers=1)
    np.testing.assert_array_equal(first.counts.flat, then.counts.flat)
    assert first.digests == then.digests and first.traits == then.traits and first.scheme == SIX
    mixed = compare_sets(guess, made[1], workers=1)
    assert mixed.scheme == SIX and mixed.digests == first.digests
    with pytest.raises(FormatError, match="lies in several parts of scheme 'hands-and-feet'"):
        compare_sets(guess, sets["six"][1], workers=1, scheme=HANDS)


@by_scheme
def test_swaps_are_0_without_twins_and_found_with_them(scheme: Scheme) -> None:
    truth = pair(5, scheme)[1]
    swapped = replace(truth, parts=scheme.swap_left_right(truth.parts))
    counts = count(truth, swapped, 5.0)
    rate, kinds = scores_of(counts)["left_right_swap_rate"], confusion.error_kinds(counts.confusion, scheme)
    wrong = np.count_nonzero(truth.parts != swapped.parts)
    assert kinds["left_right_swap"] == wrong and rate == (1.0 if scheme.twins else 0.0)
    assert bool(scheme.twins) == bool(wrong) == bool(confusion.flip_helps(counts.confusion, scheme))
    assert scores_of(counts)["miou_merged"] == 1.0
    if not scheme.twins:
        guess = counts_of(pair(5, scheme))
        assert scores_of(guess)["left_right_swap_rate"] == 0.0
        assert confusion.error_kinds(guess.confusion, scheme)["left_right_swap"] == 0


def test_a_thing_is_a_part_and_never_of_the_person() -> None:
    """Person scores stay where things become background; a thing's own recall and borders are scored."""
    frames = pair(20, WARD)
    gone = tuple(
        replace(frame, parts=np.where(WARD.is_thing[frame.parts], np.uint8(BACKGROUND), frame.parts))
        for frame in frames
    )
    with_things, without = scores_of(counts_of(frames)), scores_of(counts_of(gone))
    for name in ("person_iou", "mean_recall_person", "miou_person"):
        assert with_things[name] == without[name], name
    kinds, other = (confusion.error_kinds(counts_of(one).confusion, WARD) for one in (frames, gone))
    for name in ("missed_person", "invented_person"):
        assert kinds[name] == other[name] > 0
    guess, truth = frames[0].parts, frames[1].parts
    chair, defined = truth == 16, truth != 255
    assert with_things["recall"][16] == np.count_nonzero(chair & (guess == 16)) / chair.sum() < 1
    assert np.isnan(without["recall"][16]) and with_things["boundary_iou_by_part"][16] > 0
    body = WARD.on_body(truth)
    error = np.count_nonzero(body & (guess != truth)) / body.sum()
    assert confusion.error_rate_on_person(counts_of(frames).confusion, WARD) == pytest.approx(error)
    either = np.count_nonzero(defined & (body | WARD.on_body(guess)))
    assert with_things["person_iou"] == np.count_nonzero(body & WARD.on_body(guess)) / either


@by_scheme
def test_every_wrong_pixel_has_one_kind_and_its_colour(scheme: Scheme) -> None:
    guess, truth = pair(9, scheme)
    counts = counts_of((guess, truth)).confusion
    kinds = confusion.error_kinds(counts, scheme)
    assert sum(kinds.values()) == counts.sum() - np.trace(counts) and min(kinds.values()) >= 0
    drawn = np.bincount(error_kind_ids(truth.parts, guess.parts, scheme).ravel(), minlength=len(ERROR_KINDS))
    assert {name: drawn[list(ERROR_KINDS).index(name)] for name in kinds} == kinds


def test_ids_change_no_score() -> None:
    """The paper's parts with ids far apart: the same scores by part, and the same summary."""
    ids = np.full(256, 255, np.uint8)
    ids[:12] = [0, *range(9, 250, 22)][:12]
    apart = scheme_of("apart", [replace(part, id=int(ids[part.id])) for part in PAPER.parts])
    frames = pair(11)
    moved = tuple(replace(frame, parts=ids[frame.parts], scheme=apart) for frame in frames)
    near, far = scores_of(counts_of(frames)), scores_of(counts_of(moved))
    for name, value in near.items():
        own = ids[:12] if name in PART_SCORES or name == "error_by_distance_by_part" else ...
        np.testing.assert_allclose(value, far[name][own], rtol=0, atol=1e-12, err_msg=name)


def test_a_result_names_its_scheme_whole(compared: dict[str, Comparison], tmp_path: Path) -> None:
    for name, one in compared.items():
        save_result(tmp_path / name, Result("Network", one))
        again = load_result(tmp_path / name).comparison
        assert again.scheme == one.scheme and again.to_evaluation_json() == one.to_evaluation_json()
        shown = one.to_evaluation_json()
        parts = ["background", *(part.name for part in one.scheme.parts)]
        assert shown["scheme"] == name and shown["parts"] == parts == list(shown["pixels"])
        assert np.shape(shown["confusion"]) == (len(parts), len(parts)) and list(shown["iou"]) == parts[1:]
        assert {row["part"] for row in details(one)["suspicious"]} <= set(parts)


def test_results_of_two_schemes_differ_in_their_finest_common_one(
    sets: dict, compared: dict[str, Comparison]
) -> None:
    """The differences equal differences of evaluations in that scheme; scores of images are null."""
    common = finest_common(WARD, SIX).scheme
    found = difference(Result("ward", compared["ward"]), Result("six", compared["six"]))
    in_common = [compare_sets(*sets[name], workers=1, scheme=common) for name in ("ward", "six")]
    expected = difference(*(Result(c.scheme.name, c) for c in in_common))
    assert found.scheme == common and found.paired and found.wilcoxon_p == expected.wilcoxon_p
    for name, value in expected.scores.items():
        wanted = value if name in FROM_CONFUSION else np.full_like(value, np.nan)
        np.testing.assert_array_equal(found.scores[name], wanted, err_msg=name)
    np.testing.assert_array_equal(found.ci95["miou"], expected.ci95["miou"])
    shown = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert shown["scheme"] == "six" and shown["difference"]["boundary_f"] is None
    assert list(shown["difference"]["recall"]) == [part.name for part in SIX.parts]
    assert found.note.startswith("compared in scheme six: head, torso,")
    assert "4 of 4 frames have different truths" in found.note
    same = [compare_sets(*sets["ward"], workers=1, scheme=scheme) for scheme in (None, SIX)]
    nothing = difference(*(Result(c.scheme.name, c) for c in same))
    assert nothing.scores["miou"] == 0 and "different truths" not in nothing.note


def test_a_report_of_results_of_several_schemes(sets: dict, compared: dict[str, Comparison]) -> None:
    """Each in its own parts and colours; the paper's tables only beside the paper's scheme."""
    results = [
        Result(name, compared[name], {"predicted": str(sets[name][0].path), "truth": str(sets[name][1].path)})
        for name in ("hands-and-feet", "ward", "six")
    ]
    material = gather(Sources(results, each=1))
    page, texts = render(material), numbers.texts(material)
    assert "Paper" not in page + texts[".csv"] + texts[".tex"] and "paper" not in json.loads(texts[".json"])
    assert "over the parts of scheme hands-and-feet and ward and six." in page and "Wheelchair" in page
    assert "compared in scheme six: head, torso" in page and "Recall by part, scheme ward" in page
    assert "six,recall,upper_leg" in texts[".csv"] and "hands-and-feet,recall,left_hand" in texts[".csv"]
    assert "six,left_right_swap_rate" not in texts[".csv"]
    chair = np.array(next(part.rgb for part in WARD.parts if part.name == "wheelchair"))
    target = material.galleries["ward"][0].columns["Target labels"]
    assert (target == chair).all(axis=-1).any()
    both = Material((*material.results, Result("Paper's", compared["paper"])))
    assert "Paper, real" in numbers.texts(both)[".csv"] and "Recall by part, scheme paper" in render(both)


def test_many_parts_need_little_memory(compared: dict[str, Comparison], monkeypatch) -> None:
    """Resamples in blocks give the same intervals."""
    one = compared["ward"]
    monkeypatch.setattr("eval.scores.intervals.AT_ONCE", 300 * one.counts.flat.shape[-1])
    assert replace(one).to_evaluation_json() == one.to_evaluation_json()
    assert set(by_name(one.counts)) == set(by_name(compared["paper"].counts))
