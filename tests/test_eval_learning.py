"""Fine-tuning on corrections helps on the next frames; an interruption changes nothing."""

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from conftest import tree

from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel
from annotate.correction.review_queue import teaching_order
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import BACKGROUND
from annotate.segmentation.input_channels import CHANNELS, FELT, SEEN
from eval.fine_tuning import fine_tune as tuning
from eval.fine_tuning import run
from eval.fine_tuning.by_depth import DepthFineTuner, depth_example
from eval.fine_tuning.training_split import HELD_OUT, LEAST_FRAMES, corrected_frames, split_frames
from eval.training.segmentation import train
from eval.training.segmentation.augmentation import Sampling
from eval.training.segmentation.train import Stage
from sensors.errors import CloudError, ExistsError
from sensors.rig.camera import Intrinsics

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
        labels.write(FrameLabels(frame_id, depth, first, confidence, notes={"confidence": 0.5 + 0.01 * n}))
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
    for count in range(LEAST_FRAMES, len(found) + 1):
        trained, held = split_frames(found[:count])
        assert len(held) == max(1, count // HELD_OUT)
        assert sorted(frame.first.frame_id for frame in (*trained, *held)) == list(DONE[:count])


@pytest.mark.parametrize(
    ("places", "held"),
    [
        ((0, 1, 2, 3, 50), [50]),  # the one frame of another moment, not a neighbour of four
        ((0, 1, 2, 3, 4, 5, 200, 201), [200, 201]),  # the other moment whole, not each of its neighbours
        ((0, 30, 60, 90, 120, 150, 180, 210), [0, 30]),
        ((7, 8, 9), [7]),
    ],
)
def test_frames_are_measured_on_far_from_those_trained_on(corrected, places, held):
    frame = corrected_frames(corrected)[0]
    trained, measured = split_frames([replace(frame, place=place) for place in places])
    assert [one.place for one in measured] == held
    assert [one.place for one in trained] == [place for place in places if place not in held]


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
    assert (done.frames, done.held_out) == (5, 1)
    assert done.better and done.before < 0.75 < done.after
    assert LabelSet.open(done.labels).frame_ids == list(IDS[5:])
    with Correction.open(corrected, "ann") as correction:
        relabel(correction, LabelSet.open(done.labels))
        for n, frame_id in enumerate(IDS[5:], 5):
            parts = correction.frame(frame_id).parts
            assert (parts == truth(n)).mean() > (first == truth(0)).mean()


def test_an_interrupted_run_ends_with_the_same_network(corrected, few_steps, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "STEPS_EACH", 1)
    monkeypatch.setattr(train, "CHECKPOINT_S", 0.0)
    monkeypatch.setattr(tuning.FineTuned, "better", True)
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


def test_the_frame_that_teaches_most_is_unsure_and_far_from_finished_frames(tmp_path):
    path = written(tmp_path / "labels")
    with Correction.open(path, "ann") as correction:
        assert sorted(teaching_order(correction)) == list(IDS)
        assert teaching_order(correction)[0] == IDS[0]
        correction.edit(IDS[0]).judge("accept")
        order = teaching_order(correction)
        assert order[0] == min(IDS[4:], key=lambda i: correction.labels.notes(i)["confidence"])
        assert IDS[0] not in order
