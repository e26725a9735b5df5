"""Fine-tuning on corrections helps on the next frames; an interruption changes nothing."""

from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from conftest import assert_refused, tree

from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel
from annotate.correction.teaching_order import teaching_order
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.segmentation.input_channels import CHANNELS, FELT, SEEN
from eval.fine_tuning import cross_validation, run, training_split
from eval.fine_tuning import fine_tune as tuning
from eval.fine_tuning.by_depth import DepthFineTuner, depth_example
from eval.fine_tuning.cross_validation import SHARES, Gain, gain_of
from eval.fine_tuning.rehearsal import rehearsed_frames
from eval.fine_tuning.training_split import FOLDS, corrected_frames, folds
from eval.training.segmentation import train
from eval.training.segmentation.augmentation import Sampling
from eval.training.segmentation.network import load_suit_network
from eval.training.segmentation.train import Stage
from sensors.errors import CloudError, ExistsError
from sensors.rig.camera import Intrinsics
from tests.helpers import witnessed_sets
from tests.helpers.schemes import WARD

SIDE, IDS = 48, tuple(f"{i:06}" for i in range(8))
DONE = IDS[:5]


@contextmanager
def silent(what, total):
    yield lambda n: None


def truth(n: int) -> np.ndarray:
    """A head over a torso; frames differ in their place."""
    parts = np.zeros((SIDE, SIDE), np.uint8)
    parts[8:20, 16 + n : 28 + n], parts[20:40, 12 + n : 32 + n] = 1, 2
    return parts


def written(path: Path, **info) -> Path:
    """Write labels that are all torso, with a piece of the seat."""
    labels = LabelSet.create(path, Intrinsics(SIDE, SIDE, 60, 60, 24, 24), {"source": "test", **info})
    for n, frame_id in enumerate(IDS):
        true = truth(n)
        depth = np.where(true == 1, np.uint16(900), np.uint16(1400))
        depth[40:44] = 1800
        first = np.where(true > 0, np.uint8(2), np.uint8(0))
        first[40:44, 12 + n : 32 + n] = 2
        confidence = np.full((SIDE, SIDE), 0.5 + 0.01 * n, np.float32)
        notes = {"confidence": 0.5 + 0.01 * n}
        labels.write(FrameLabels(frame_id, depth, first, confidence, notes=notes, scheme=labels.scheme))
    return path


@pytest.fixture
def corrected(tmp_path) -> Path:
    """A set whose first frames are corrected and accepted."""
    path = written(tmp_path / "labels")
    with Correction.open(path, "ann") as correction:
        for n, frame_id in enumerate(DONE):
            editor = correction.edit(frame_id)
            editor.replace("paint", truth(n))
            editor.judge("accept")
    return path


@pytest.fixture
def few_steps(monkeypatch) -> None:
    for name, small in (("STEPS_EACH", 6), ("SIDE", 32), ("RATE", 4e-3)):
        monkeypatch.setattr(run, name, small)


def tuner(path: Path) -> DepthFineTuner:
    return DepthFineTuner(LabelSet.open(path), None)


def test_an_example_has_the_room_the_first_labels_and_the_seat_as_background(corrected):
    found = corrected_frames(corrected)
    assert [frame.first.frame_id for frame in found] == list(DONE)
    example = depth_example(found[0].first, found[0].corrected, LabelSet.open(corrected).intrinsics)
    before = example.planes[CHANNELS.index("before")]
    assert set(np.unique(before)) == {BACKGROUND, 2} and set(np.unique(example.target)) == {BACKGROUND, 1, 2}
    assert (before > 0).sum() > (example.target > 0).sum()
    assert not (example.planes[0] & (SEEN | FELT)).any()
    assert example.pixel_m == pytest.approx(1.4 / 60)


def room(far_mm: int, row: int) -> np.ndarray:
    """Return depth of a wall with a person in front, in one row of the image."""
    depth = np.full((SIDE, SIDE), far_mm, np.uint16)
    depth[row : row + 20, 10:20] = 1200
    return depth


def test_a_fold_is_one_kind_of_frames_whenever_they_were_taken(corrected):
    """Frames alternate between three rooms and one more posture; neighbours in time never share a fold."""
    frame, kinds = corrected_frames(corrected)[0], ((2000, 2), (3000, 2), (4000, 2), (2000, 26))
    frames = [
        replace(frame, place=n, first=replace(frame.first, depth_mm=room(*kinds[n % 4]))) for n in range(12)
    ]
    fold_of = folds(frames)
    assert len(set(fold_of[:FOLDS])) == FOLDS == 4
    np.testing.assert_array_equal(fold_of, np.tile(fold_of[:4], 3))
    assert sorted(set(folds(frames[:3]))) == [0, 1, 2]


def test_the_gain_is_of_shares_that_other_folds_choose():
    """By hand: a share that is good by chance in one fold only, and equal gains."""
    before, steady = np.array([0.9, 0.9, 0.8, 0.8]), np.array([0.02, 0.03, 0.02, 0.03])
    lucky = np.array([0.2, -0.01, -0.01, -0.01])
    found = gain_of(before, before + np.stack([lucky, steady]), np.arange(4))
    # Frame 0 makes the first share best for the other frames; without frame 0 the second share is best.
    assert found.share == SHARES[0]
    assert found.after - found.before == pytest.approx(np.mean([0.02, -0.01, -0.01, -0.01]))
    assert not found.is_certain
    even = gain_of(before, before + np.stack([steady, steady]), np.arange(4))
    half = 2.3534 * np.std(steady, ddof=1) / 2
    assert (even.low, even.high) == pytest.approx((0.025 - half, 0.025 + half), abs=1e-5)
    assert even.is_certain and even.sure == pytest.approx(0.9984, abs=1e-4)


def test_the_interval_covers_the_mean_change():
    rng, hit = np.random.default_rng(0), 0
    for _ in range(400):
        found = gain_of(np.full(5, 0.9), 0.9 + rng.normal(0.01, 0.02, (1, 5)).repeat(2, 0), np.arange(5))
        hit += found.low < 0.01 < found.high
    assert 0.86 < hit / 400 < 0.94


def test_a_set_without_untouched_frames_has_none_to_rehearse(tmp_path):
    path = witnessed_sets.written(tmp_path / "labels", witnessed_sets.COLOUR)
    for frame_id in LabelSet.open(path).frame_ids:
        witnessed_sets.judged(path, frame_id, "accept")
    assert rehearsed_frames(path) == []


def test_a_network_is_not_written_into_its_label_set(annotate_cloud, tmp_path):
    path = witnessed_sets.written(tmp_path / "labels", witnessed_sets.COLOUR)
    before = tree(path)
    for verb in ("learn", "adapt"):
        refused = annotate_cloud(verb, path, "--out", path / "model")
        assert_refused(refused, f"{path / 'model'} is inside the input {path}; choose another folder")
    assert tree(path) == before


def test_rehearsed_frames_are_untouched_and_keep_sure_parts_only(corrected):
    with Correction.open(corrected) as correction:
        labels = correction.labels
        sure = labels.read(IDS[6])
        sure.confidence[:24] = 0.95
        labels.write(sure)
    (found,) = rehearsed_frames(corrected)
    assert found.first.frame_id == IDS[6] and found.place == 6
    body = sure.parts > 0
    np.testing.assert_array_equal(found.corrected.parts[:24], sure.parts[:24])
    assert (found.corrected.parts[24:][body[24:]] == UNDEFINED).all()
    assert (found.corrected.parts[~body] == BACKGROUND).all()


def test_in_a_scheme_with_things_no_background_is_rehearsed_because_undrawn_things_lie_in_it(tmp_path):
    path = written(tmp_path / "labels", **scheme_note(WARD))
    for frame_id in DONE:
        witnessed_sets.judged(path, frame_id, "accept")
    with Correction.open(path) as correction:
        sure = correction.labels.read(IDS[6])
        sure.confidence[:] = 0.95
        correction.labels.write(sure)
    (found,) = rehearsed_frames(path)
    body = sure.parts > 0
    np.testing.assert_array_equal(found.corrected.parts[body], sure.parts[body])
    assert (found.corrected.parts[~body] == UNDEFINED).all()


def test_a_network_part_of_the_way_lies_between_start_and_end(corrected, tmp_path):
    tuning_ = tuner(corrected)
    moved = deepcopy(tuning_.start_network)
    with torch.no_grad():
        moved.leave.bias += 1
    for share in (0.0, 0.25, 1.0):
        tuning_.save(moved, share, tmp_path / "w.onnx")
        off = load_suit_network(tmp_path / "w.onnx").leave.bias - tuning_.start_network.leave.bias
        torch.testing.assert_close(off, torch.full_like(off, share))


def test_another_training_does_not_resume_from_a_checkpoint(corrected):
    """Its first labels, its recording or its numbers are others."""
    found = corrected_frames(corrected)[0]
    example = depth_example(found.first, found.corrected, LabelSet.open(corrected).intrinsics)
    planes = example.planes.copy()
    planes[CHANNELS.index("before")] = 0
    stage = Stage(Sampling(0.01, 32), 6, 4e-3, 0.9)
    digests = {
        run.digest_of("start", [example], stage),
        run.digest_of("start", [example._replace(planes=planes)], stage),
        run.digest_of("start", [example._replace(meta=example.meta * 2)], stage),
        run.digest_of("start", [example], replace(stage, peak_rate=2e-3)),
        run.digest_of("other", [example], stage),
    }
    assert len(digests) == 5


def test_too_few_frames_and_other_folders_are_refused(corrected, tmp_path):
    with pytest.raises(CloudError, match="accept at least 3"):
        corrected_frames(written(tmp_path / "fresh"))
    with pytest.raises(CloudError, match="everybody"):
        corrected_frames(written(tmp_path / "all", steps={"predict": {"everybody": True}}))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(ExistsError, match="choose another folder"):
        tuning.fine_tune(corrected, tmp_path / "mine", tuner(corrected), silent)


def test_fine_tuning_helps_on_other_frames_and_changes_no_label_by_itself(corrected, few_steps, tmp_path):
    before, first = tree(corrected), LabelSet.open(corrected).read(IDS[0], original=True).parts
    done = tuning.fine_tune(corrected, tmp_path / "model", tuner(corrected), silent)
    assert tree(corrected) == before
    assert done.measured_on == DONE
    assert done.gain.is_certain and done.gain.before < 0.75 < done.gain.after
    assert LabelSet.open(done.labels).frame_ids == list(IDS[5:])
    with Correction.open(corrected, "ann") as correction:
        relabel(correction, LabelSet.open(done.labels))
        for n, frame_id in enumerate(IDS[5:], 5):
            parts = correction.frame(frame_id).parts
            assert (parts == truth(n)).mean() > (first == truth(0)).mean()


def test_an_interrupted_run_ends_with_the_same_network(corrected, few_steps, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "STEPS_EACH", 1)
    monkeypatch.setattr(train, "CHECKPOINT_S", 0.0)
    monkeypatch.setattr(Gain, "is_certain", True)
    monkeypatch.setattr(training_split, "FOLDS", 2)
    monkeypatch.setattr(cross_validation, "SHARES", (1.0,))
    done = tuning.fine_tune(corrected, tmp_path / "model", tuner(corrected), silent)
    seen = 0

    @contextmanager
    def killed(what, total):
        def advance(n):
            nonlocal seen
            seen += n
            if seen > 3:
                raise KeyboardInterrupt

        yield advance

    with pytest.raises(KeyboardInterrupt):
        tuning.fine_tune(corrected, tmp_path / "again", tuner(corrected), killed)
    again = tuning.fine_tune(corrected, tmp_path / "again", tuner(corrected), silent)
    assert again.weights.read_bytes() == done.weights.read_bytes()
    assert not (tmp_path / "again" / "run").exists()


def test_the_frames_that_teach_most_are_of_all_kinds_and_the_unsure_ones_among_these(tmp_path):
    """Eight frames of three rooms, in any order: three corrections cover all rooms, least sure first."""
    path, rooms = written(tmp_path / "labels"), (2000, 2000, 3000, 2000, 2000, 4000, 3000, 2000)
    labels = LabelSet.open(path)
    for frame_id, far_mm in zip(IDS, rooms, strict=True):
        labels.write(replace(labels.read(frame_id), depth_mm=room(far_mm, 2)))
    with Correction.open(path, "ann") as correction:
        order = teaching_order(correction)
        assert sorted(order) == list(IDS) and order[0] == IDS[0]
        assert order[:3] == [IDS[0], IDS[2], IDS[5]]
        correction.edit(IDS[5]).judge("accept")
        assert teaching_order(correction)[:2] == [IDS[0], IDS[2]]
