"""Learnt labels replace untouched ones in one step, which is taken back whole."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from annotate.correction.audit import audit
from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel, take_back, untouched
from annotate.correction.replay import replayed
from annotate.frame_labels import FrameLabels
from annotate.labelset.journal import Journal, NotSavedError
from annotate.labelset.label_set import LabelSet, validate
from sensors.rig.camera import Intrinsics

H, W = 12, 16
CAMERA = Intrinsics(W, H, 20, 20, 8, 6)
IDS = tuple(f"{i:06}" for i in range(5))
ACCEPTED, UNDONE, FREE = IDS[0], IDS[1], IDS[2:]
SPOT = np.arange(3 * W, 3 * W + 3)


def written(path: Path, part: int, confidence: float) -> LabelSet:
    """A set whose frames are one part on the same ground, with one confidence."""
    labels = LabelSet.create(path, CAMERA, {"source": "test"})
    parts = np.zeros((H, W), np.uint8)
    parts[2:10, 2:8], parts[2:10, 8:14] = 2, part
    depth = np.full((H, W), 1500, np.uint16)
    sure = np.full((H, W), confidence, np.float32)
    for frame_id in IDS:
        labels.write(FrameLabels(frame_id, depth, parts, sure, notes={"confidence": confidence}))
    return labels


@pytest.fixture
def folder(tmp_path) -> Path:
    """A set of which one frame is accepted, and one was painted and undone."""
    path = written(tmp_path / "labels", 3, 0.6).path
    with Correction.open(path, "ann") as correction:
        correction.edit(ACCEPTED).judge("accept")
        editor = correction.edit(UNDONE)
        editor.paint(SPOT, 5)
        editor.undo()
        correction.edit(IDS[4])
    return path


@pytest.fixture
def learnt(tmp_path) -> tuple[LabelSet, LabelSet]:
    """Labels of two steps of learning."""
    return written(tmp_path / "first", 4, 0.8), written(tmp_path / "second", 7, 1.0)


def images(path: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted((path / "frames").glob("*.png"))}


def parts(path: Path) -> dict[str, int]:
    """The part of each frame's right half, as a reader of the set has it."""
    return {frame.frame_id: int(frame.parts[5, 10]) for frame in LabelSet.open(path)}


def test_only_untouched_frames_change_and_stay_automatic(folder, learnt):
    with Correction.open(folder, "ann") as correction:
        assert untouched(correction) == list(FREE)
        done = relabel(correction, learnt[0])
        assert (done.step, done.frames) == ("0001", 3)
        assert done.changed == pytest.approx(0.5)
        assert [correction.state(i) for i in FREE] == ["auto"] * 3
        assert untouched(correction) == list(FREE)
    assert parts(folder) == {ACCEPTED: 3, UNDONE: 3} | dict.fromkeys(FREE, 4)
    assert validate(LabelSet.open(folder)) == []
    frame = LabelSet.open(folder).read(FREE[0])
    assert (frame.status, frame.notes["confidence"]) == ("auto", 0.8)
    assert frame.confidence is not None and np.ptp(frame.confidence) == 0
    assert frame.confidence[0, 0] == pytest.approx(0.8, abs=1 / 255)


def test_steps_are_taken_back_one_by_one_to_the_first_bytes(folder, learnt):
    before = images(folder)
    with Correction.open(folder, "ann") as correction:
        for labels in learnt:
            relabel(correction, labels)
        assert parts(folder)[FREE[0]] == 7
        back = take_back(correction)
        assert back is not None and (back.step, back.frames) == ("0001", 3)
        assert correction.frame(FREE[0]).confidence[0, 0] == pytest.approx(0.8, abs=1 / 255)
        assert relabel(correction, learnt[1]).step == "0003"
    with Correction.open(folder, "bob") as correction:
        assert [take_back(correction).step for _ in range(2)] == ["0001", ""]
        assert take_back(correction) is None
    assert images(folder) == before
    assert LabelSet.open(folder).read(FREE[0]).notes["confidence"] == pytest.approx(0.6, abs=1 / 255)


def test_a_person_goes_on_from_learnt_labels_which_no_step_takes_back_then(folder, learnt):
    with Correction.open(folder, "ann") as correction:
        relabel(correction, learnt[0])
        editor = correction.edit(FREE[0])
        assert editor.undo() is None, "learning is not a stroke of the person"
        editor.paint(SPOT, 5)
        assert correction.state(FREE[0]) == "touched"
        correction.leave_all()
        take_back(correction)
        relabel(correction, learnt[1])
        editor = correction.edit(FREE[0])
        assert editor.undo() is not None
        assert editor.parts[5, 10] == 4
        correction.edit(FREE[1]).judge("accept")
    assert parts(folder) == {ACCEPTED: 3, UNDONE: 3, FREE[0]: 4, FREE[1]: 7, FREE[2]: 7}
    labels, journal = LabelSet.open(folder), Journal.of(folder)
    for frame in labels:
        np.testing.assert_array_equal(replayed(labels, journal, frame.frame_id).parts, frame.parts)
    found = audit(labels, journal)
    (ann,) = found.people
    assert [(frame.frame_id, frame.step) for frame in found.course] == [
        (ACCEPTED, ""),
        (UNDONE, ""),
        (FREE[0], "0001"),
        (FREE[1], "0002"),
    ]
    assert (ann.changed, ann.accepted_untouched) == (0, 1)


def test_frames_that_the_learnt_set_lacks_or_shows_otherwise_stay(folder, tmp_path):
    other = written(tmp_path / "other", 4, 0.8)
    deeper = other.read(FREE[0])
    other.write(FrameLabels(FREE[0], deeper.depth_mm + np.uint16(1), deeper.parts))
    (other.path / "frames" / f"{FREE[1]}.json").unlink()
    with Correction.open(folder, "ann") as correction:
        assert relabel(correction, other).frames == 1
    assert [parts(folder)[i] for i in FREE] == [3, 3, 4]


def test_a_full_disk_leaves_the_labels_before(folder, learnt, monkeypatch):
    before = images(folder)
    with Correction.open(folder, "ann") as correction:

        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as broken, pytest.raises(NotSavedError, match="nothing was changed"):
            broken.setattr(Path, "replace", full)
            relabel(correction, learnt[0])
        assert [int(correction.frame(i).parts[5, 10]) for i in FREE] == [3, 3, 3]
    assert images(folder) == before


@pytest.mark.parametrize("renames", range(0, 26, 3))
def test_killed_at_any_file_all_free_frames_are_before_or_all_after(folder, learnt, renames):
    child = os.fork()
    if not child:
        left, replace = renames, Path.replace

        def dying(self, target):
            nonlocal left
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return replace(self, target)

        Path.replace = dying
        relabel(Correction.open(folder, "ann"), learnt[0])
        os._exit(0)
    os.waitpid(child, 0)
    with Correction.open(folder, "bob") as correction:
        seen = {int(correction.frame(i).parts[5, 10]) for i in FREE}
        assert len(seen) == 1 and seen <= {3, 4}
        assert validate(correction.labels) == []
        while take_back(correction):
            pass
    assert parts(folder) == dict.fromkeys(IDS, 3)
