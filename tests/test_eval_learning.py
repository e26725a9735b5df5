"""Learning from corrections: what teaches, that it helps on the next frames; a kill changes nothing."""

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from annotate.correction.correction import Correction  # noqa: E402
from annotate.correction.relabel import relabel  # noqa: E402
from annotate.correction.review_queue import teaching_order  # noqa: E402
from annotate.frame_labels import FrameLabels  # noqa: E402
from annotate.labelset.label_set import LabelSet  # noqa: E402
from annotate.parts import BACKGROUND  # noqa: E402
from annotate.segmentation.input_channels import CHANNELS, FELT, SEEN  # noqa: E402
from eval.fine_tuning import fine_tune as learning  # noqa: E402
from eval.fine_tuning import run as practice  # noqa: E402
from eval.fine_tuning.by_depth import DepthLearner, example_of  # noqa: E402
from eval.fine_tuning.run import Practice  # noqa: E402
from eval.fine_tuning.training_split import HELD_OUT, LEAST_FRAMES, divided, lessons  # noqa: E402
from eval.training.segmentation import train  # noqa: E402
from eval.training.segmentation.train import Stage  # noqa: E402
from sensors.errors import CloudError, ExistsError  # noqa: E402
from sensors.rig.camera import Intrinsics  # noqa: E402

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
    """Labels that call everybody a torso, with a piece of the seat."""
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
def taught(tmp_path) -> Path:
    """A set of which the first frames are corrected and accepted."""
    path = written(tmp_path / "labels")
    with Correction.open(path, "ann") as correction:
        for n, frame_id in enumerate(DONE):
            editor = correction.edit(frame_id)
            editor.replace("paint", truth(n))
            editor.judge("accept")
    return path


@pytest.fixture
def few_steps(monkeypatch) -> None:
    """Few small steps."""
    for name, small in (("STEPS_EACH", 6), ("SIDE", 32), ("RATE", 4e-3)):
        monkeypatch.setattr(practice, name, small)


def learner(path: Path) -> DepthLearner:
    return DepthLearner(LabelSet.open(path), None)


def test_a_lesson_shows_the_room_the_first_labels_and_calls_the_seat_background(taught):
    found = lessons(taught)
    assert [one.first.frame_id for one in found] == list(DONE)
    example = example_of(found[0].first, found[0].corrected.parts, LabelSet.open(taught).intrinsics)
    before = example.planes[CHANNELS.index("before")]
    assert set(np.unique(before)) == {BACKGROUND, 2} and set(np.unique(example.target)) == {BACKGROUND, 1, 2}
    assert (before > 0).sum() > (example.target > 0).sum()
    assert not (example.planes[0] & (SEEN | FELT)).any()
    assert example.pixel_m == pytest.approx(1.4 / 60)


def test_a_fourth_of_the_frames_is_held_out_and_one_of_three(taught):
    found = lessons(taught)
    for count in range(LEAST_FRAMES, len(found) + 1):
        school, held = divided(found[:count])
        assert len(held) == max(1, count // HELD_OUT)
        assert sorted(one.first.frame_id for one in (*school, *held)) == list(DONE[:count])


@pytest.mark.parametrize(
    ("places", "held"),
    [
        ((0, 1, 2, 3, 50), [50]),  # the one frame of another moment, not a neighbour of four
        ((0, 1, 2, 3, 4, 5, 200, 201), [200, 201]),  # the other moment whole, not each of its neighbours
        ((0, 30, 60, 90, 120, 150, 180, 210), [0, 30]),
        ((7, 8, 9), [7]),
    ],
)
def test_frames_are_measured_on_far_from_those_learnt(taught, places, held):
    frame = lessons(taught)[0]
    school, measured = divided([replace(frame, place=place) for place in places])
    assert [one.place for one in measured] == held
    assert [one.place for one in school] == [place for place in places if place not in held]


def test_another_training_does_not_go_on_from_a_checkpoint(taught):
    """Its first labels, its recording or its numbers are others."""
    found = lessons(taught)[0]
    example = example_of(found.first, found.corrected.parts, LabelSet.open(taught).intrinsics)
    planes = example.planes.copy()
    planes[CHANNELS.index("before")] = 0
    stage = Stage(0.01, 32, 6, 4e-3, 0.9)
    begun = Practice("start", spoilt=False)
    digests = {
        begun.digest([example], stage),
        begun.digest([example._replace(planes=planes)], stage),
        begun.digest([example._replace(meta=example.meta * 2)], stage),
        begun.digest([example], replace(stage, peak_rate=2e-3)),
        Practice("other", spoilt=False).digest([example], stage),
    }
    assert len(digests) == 5


def test_too_few_frames_are_refused_in_one_line(tmp_path):
    with pytest.raises(CloudError, match="accept at least 3"):
        lessons(written(tmp_path / "fresh"))
    with pytest.raises(CloudError, match="everybody"):
        lessons(written(tmp_path / "all", steps={"predict": {"everybody": True}}))


def test_learning_helps_on_frames_it_has_not_seen_and_changes_nothing_by_itself(taught, few_steps, tmp_path):
    before = {p: p.read_bytes() for p in sorted(taught.rglob("*")) if p.is_file()}
    done = learning.learn(taught, tmp_path / "model", learner(taught), silent)
    assert {p: p.read_bytes() for p in sorted(taught.rglob("*")) if p.is_file()} == before
    assert (done.frames, done.held_out) == (5, 1)
    assert done.better and done.before < 0.75 < done.after
    assert LabelSet.open(done.labels).frame_ids == list(IDS[5:])
    with Correction.open(taught, "ann") as correction:
        relabel(correction, LabelSet.open(done.labels))
        for n, frame_id in enumerate(IDS[5:], 5):
            parts = correction.frame(frame_id).parts
            assert (parts == truth(n)).mean() > (correction.begun(IDS[0]).parts == truth(0)).mean()


def test_a_killed_learning_goes_on_and_ends_with_the_same_network(taught, few_steps, tmp_path, monkeypatch):
    monkeypatch.setattr(practice, "STEPS_EACH", 1)
    monkeypatch.setattr(train, "SAVED_S", 0.0)
    monkeypatch.setattr(learning.Learnt, "better", True)
    done = learning.learn(taught, tmp_path / "model", learner(taught), silent)
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
        learning.learn(taught, tmp_path / "again", learner(taught), killed)
    again = learning.learn(taught, tmp_path / "again", learner(taught), silent)
    assert again.weights.read_bytes() == done.weights.read_bytes()
    assert not (tmp_path / "again" / "run").exists()


def test_another_folder_is_not_taken(taught, few_steps, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(ExistsError, match="not made by this command"):
        learning.learn(taught, tmp_path / "mine", learner(taught), silent)


def test_the_frame_that_teaches_most_is_unsure_and_far_from_what_is_done(tmp_path):
    path = written(tmp_path / "labels")
    with Correction.open(path, "ann") as correction:
        assert sorted(teaching_order(correction)) == list(IDS)
        assert teaching_order(correction)[0] == IDS[0]
        correction.edit(IDS[0]).judge("accept")
        last = teaching_order(correction)[0]
        assert last == min(IDS[4:], key=lambda i: correction.labels.notes(i)["confidence"])
        assert IDS[0] not in teaching_order(correction)
