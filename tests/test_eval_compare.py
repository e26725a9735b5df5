"""Comparisons of label sets and datasets, groups of frames, and results on disk."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import N_CLASSES, PAPER, PART_ID, UNDEFINED
from eval.compare import pairs
from eval.compare.compare import Comparison, compare_sets
from eval.compare.details import details, suspicious
from eval.scores import counts, intervals
from eval.scores.counts import FrameCounts, shapes
from eval.scores.scores import PART_SCORES
from eval.scores.traits import groups, traits_of
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from tests.helpers.naive_scores import by_name
from tests.helpers.shards import write_dataset

CAMERA = Intrinsics(width=30, height=24, fx=300.0, fy=300.0, cx=14.5, cy=11.5)
PEOPLE = ("anna", "ben", "cem")


def truth_frame(i: int) -> FrameLabels:
    """A block of 2 x 3 parts before a wall with a hole, 1.5 m away and more."""
    parts = np.zeros(CAMERA.shape, np.uint8)
    parts[4:16, 6 : 24 - i % 3] = np.kron([[1, 2, 3], [4, 5, 9]], np.ones((6, 6)))[:, : 18 - i % 3]
    parts[14:16, 6:8] = 0
    parts[0, :4] = UNDEFINED
    depth = np.where(parts > 0, 1500 + 100 * i, 3000).astype(np.uint16)
    depth[10, 6:8] = 0
    notes = {"activity": ("reading", "resting")[i % 2], "hard": ["dim light"] if i == 1 else []}
    return FrameLabels(f"{i:06d}", depth, parts, None, "truth", PEOPLE[i % 3], notes)


def guess_frame(i: int, better: bool = False) -> FrameLabels:
    """The truth with a frame's own strip of errors, doubted where it is wrong."""
    truth = truth_frame(i)
    parts = truth.parts.copy()
    parts[4 : 6 + i % 2 + (not better), 6:20] = 7
    confidence = np.where(parts == 7, 0.4, 1.0).astype(np.float32) * (parts > 0)
    return replace(truth, parts=parts, confidence=confidence, status="auto")


def label_set(path: Path, frames: list[FrameLabels]) -> LabelSet:
    labels = LabelSet.create(path, CAMERA, {})
    for frame in frames:
        labels.write(frame)
    return labels


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> tuple[LabelSet, LabelSet]:
    folder = tmp_path_factory.mktemp("sets")
    guesses = label_set(folder / "guess", [guess_frame(i) for i in range(6)])
    return guesses, label_set(folder / "truth", [truth_frame(i) for i in range(6)])


@pytest.fixture(scope="module")
def compared(sets: tuple[LabelSet, LabelSet]) -> Comparison:
    return compare_sets(*sets)


def same_counts(a: Comparison, b: Comparison) -> bool:
    return a.frame_ids == b.frame_ids and all(
        np.array_equal(getattr(a.counts, name), getattr(b.counts, name)) for name in shapes(N_CLASSES)
    )


def test_label_sets_and_datasets_serve_on_either_side(
    tmp_path: Path, sets: tuple[LabelSet, LabelSet], compared: Comparison
) -> None:
    """Even where the shards hold the frames in another order."""
    frames = [truth_frame(i) for i in range(6)]
    ordered = write_dataset(tmp_path / "ordered", frames, 4)
    turned = write_dataset(tmp_path / "turned", frames[::-1], 2)
    assert compare_sets(turned, ordered).scores["miou"] == 1.0
    mixed = compare_sets(sets[0], ordered)
    assert mixed.hashes == compared.hashes
    np.testing.assert_array_equal(mixed.counts.confusion, compared.counts.confusion)
    assert compare_sets(turned, sets[1]).scores["mean_recall"] == 1.0


def test_worker_processes_count_the_same(
    tmp_path: Path, compared: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = [guess_frame(i) for i in range(6)]
    guesses = write_dataset(tmp_path / "guess", frames, 6)
    truth = write_dataset(tmp_path / "truth", [truth_frame(i) for i in range(6)], 2)
    alone, done = compare_sets(guesses, truth, workers=1), []
    monkeypatch.setattr(pairs, "CHUNK", 2)
    both = compare_sets(guesses, truth, done.append, workers=2)
    assert same_counts(alone, both) and alone.traits == both.traits and done == [1] * 6
    np.testing.assert_array_equal(both.matrices, compared.matrices)


def test_blocks_change_no_number(compared: Comparison, monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts summed block by block, of several people and of one: the same JSON."""
    one = replace(compared, subjects=("anna",) * 6)
    whole = [(c.to_evaluation_json(), details(c)) for c in (compared, one)]
    monkeypatch.setattr(counts, "BLOCK", 2)
    monkeypatch.setattr(intervals, "AT_ONCE", 2000)
    again = [replace(c) for c in (compared, one)]
    assert [(c.to_evaluation_json(), details(c)) for c in again] == whole


def test_sets_that_differ_are_refused(tmp_path: Path, sets: tuple[LabelSet, LabelSet]) -> None:
    guesses, truth = sets
    moved = [replace(guess_frame(i), depth_mm=guess_frame(i).depth_mm + np.uint16(i)) for i in range(6)]
    few = [guess_frame(i) for i in range(5)]
    small = LabelSet.create(tmp_path / "small", Intrinsics(10, 8, 100, 100, 4.5, 3.5), {})
    for i in range(6):
        small.write(FrameLabels(f"{i:06d}", np.ones((8, 10), np.uint16), np.ones((8, 10), np.uint8)))
    frames = [truth_frame(i) for i in range(6)]
    for predicted, of, message in (
        (label_set(tmp_path / "session", moved), truth, r"frame 000001 .*\(720 of 720 pixels"),
        (label_set(tmp_path / "few", few), truth, "1 of the 6.* 000005; predict"),
        (guesses, LabelSet.create(tmp_path / "none", CAMERA, {}), "none"),
        (small, truth, r"frame 000000 is \(8, 10\) in the prediction but \(24, 30\)"),
        (guesses, write_dataset(tmp_path / "twice", [*frames, frames[0]], 4), "'000000' twice"),
    ):
        with pytest.raises(CloudError, match=message):
            compare_sets(predicted, of)
    assert compare_sets(guesses, label_set(tmp_path / "one", [truth_frame(0)])).extra_frames == 5


def test_a_broken_shard_is_refused(tmp_path: Path, sets: tuple[LabelSet, LabelSet]) -> None:
    broken = write_dataset(tmp_path / "broken", [truth_frame(i) for i in range(6)], 3)
    shard = tmp_path / "broken" / "shard-000003.tar"
    whole = shard.read_bytes()
    for kept in (700, 3000, 5000):
        shard.write_bytes(whole[:kept])
        with pytest.raises(CloudError, match=r"shard-000003|lacks"):
            compare_sets(broken, sets[1])


def test_intervals_of_one_person_are_null(tmp_path: Path) -> None:
    one = label_set(tmp_path / "one", [truth_frame(0)]), label_set(tmp_path / "guess", [guess_frame(0)])
    comparison = compare_sets(one[1], one[0])
    assert "one subject" in comparison.ci_note and np.isnan(comparison.ci95["mean_recall"]).all()
    json.dumps(comparison.to_evaluation_json(), allow_nan=False)


def test_a_part_that_one_person_shows_has_no_interval(compared: Comparison) -> None:
    matrices = compared.matrices.copy()
    matrices[np.array(compared.subjects) != "anna", 1] = 0
    matrices[np.array(compared.subjects) != "anna", :, 1] = 0
    alone = replace(
        compared, counts=FrameCounts.of(PAPER, **by_name(compared.counts) | {"confusion": matrices})
    )
    assert not np.isnan(alone.scores["recall"][1]) and np.isnan(alone.ci95["recall"][:, 1]).all()
    assert not np.isnan(alone.ci95["recall"][:, 2]).any() and alone.behind["recall"][1] == 1


def test_the_evaluation_holds_every_score_with_its_interval(compared: Comparison) -> None:
    full = json.loads(json.dumps(compared.to_evaluation_json(), allow_nan=False))
    assert set(full["ci95"]) == set(compared.scores) <= set(full)
    for name in PART_SCORES:
        assert set(full[name]) == set(PART_ID) - {"background"}
    for name in ("mean_recall", "miou", "boundary_iou"):
        low, high = full["ci95"][name]
        assert low <= full[name] <= high
    assert full["joints"] is None and full["frames_showing"]["head"] == 6
    assert full["pixels"]["head"] == compared.confusion[1].sum()
    assert full["error_by_distance"]["0 px"] == pytest.approx(compared.scores["error_by_distance"][0])


def test_groups_split_the_frames_and_their_counts_add_up(compared: Comparison) -> None:
    kinds = groups(compared.subjects, compared.traits)
    assert set(kinds) == {"subject", "activity", "posture", "distance", "invalid depth", "status", "hard"}
    assert set(kinds["subject"]) == set(PEOPLE) and set(kinds["activity"]) == {"reading", "resting"}
    assert list(kinds["distance"]) == ["1.5 to 2 m", "2 to 2.5 m"]
    assert {k: len(v) for k, v in kinds["hard"].items()} == {"dim light": 1, "nothing named": 5}
    for found in kinds.values():
        assert sorted(np.concatenate(list(found.values()))) == list(range(6))
        parts = [compared.only(frames) for frames in found.values()]
        np.testing.assert_array_equal(sum(part.confusion for part in parts), compared.confusion)
    with pytest.raises(CloudError, match="no frame"):
        compared.only(np.zeros(0, np.int64))
    assert details(compared)["by"]["subject"]["anna"]["frames"] == 2


def test_traits_are_measured_on_the_person(compared: Comparison) -> None:
    traits = compared.traits[3]
    assert traits.distance_m == pytest.approx(1.8) and traits.mm_per_px == pytest.approx(1800 / 300)
    assert traits.invalid_share == pytest.approx(2 / (12 * 18)) and traits.predicted_status == "auto"
    alone = replace(truth_frame(0), depth_mm=np.where(truth_frame(0).parts > 0, 1500, 0).astype(np.uint16))
    assert math.isnan(traits_of(alone, alone, CAMERA).invalid_share)
    empty = replace(alone, parts=np.zeros_like(alone.parts))
    assert math.isnan(traits_of(empty, empty, CAMERA).distance_m)


@pytest.mark.parametrize(
    ("notes", "view", "hard"),
    [
        ({"activity": 5, "hard": "everything", "camera": [1], "occluders": "many", "cut": None}, "", ()),
        ({"activity": "x" * 10_000, "hard": [1, {}], "camera": {"azimuth_deg": float("inf")}}, "", ()),
        ({"occluders": True, "cut": float("nan"), "camera": {"azimuth_deg": 10**400}}, "", ()),
        (
            {"camera": {"azimuth_deg": -170.0}, "occluders": 1, "cut": 0.2},
            "back or head",
            ("things in front", "incomplete extraction"),
        ),
    ],
)
def test_traits_come_from_valid_notes_only(notes: dict, view: str, hard: tuple[str, ...]) -> None:
    frame = replace(truth_frame(0), notes=notes)
    traits = traits_of(frame, frame, CAMERA)
    assert traits.hard == hard and traits.view == view and len(traits.activity) <= 100


def test_a_wrong_label_is_the_first_suspect(tmp_path: Path) -> None:
    """A confident network and a truth with one wrong segment."""
    painted = truth_frame(2)
    wrong = painted.parts.copy()
    wrong[4:10, 6:12] = 11
    sure = [
        replace(truth_frame(i), confidence=np.full(CAMERA.shape, 0.9, np.float32), status="auto")
        for i in range(4)
    ]
    truth = [replace(painted, parts=wrong) if i == 2 else truth_frame(i) for i in range(4)]
    comparison = compare_sets(label_set(tmp_path / "sure", sure), label_set(tmp_path / "truth", truth))
    first, second = suspicious(comparison, worst=2)
    assert (first.frame_id, first.part.id, first.pixels) == ("000002", 11, 36)
    assert first.quality == pytest.approx(0.1, abs=0.01) and second.quality > 0.85
    assert not suspicious(compare_sets(*[label_set(tmp_path / n, truth) for n in "ab"]))
