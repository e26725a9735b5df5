"""A correction session loses nothing: not on kill -9, not on a full disk, not over a corrupt file."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import largest_file
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from annotate.correction.correction import Correction, RestorableError
from annotate.correction.replay import replayed
from annotate.labelset.claim import ClaimedError
from annotate.labelset.journal import JOURNAL, Journal, NotSavedError
from annotate.labelset.label_set import LabelSet, validate
from annotate.labelset.stroke import Stroke, to_line
from sensors.errors import CloudError, FormatError
from tests.helpers.correctable import FRAMES, Clock, H, W, correctable

law = settings(deadline=None, max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def folder(tmp_path) -> Path:
    return correctable(tmp_path / "labels")


def dab(k: int) -> np.ndarray:
    """Three pixels with depth."""
    return W + 7 * k % (H * W - W - 3) + np.arange(3)


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def killed(folder: Path, strokes: int = 5) -> np.ndarray:
    """Strokes on the first frame by a session that never came to saving; the labels it saw."""
    correction = Correction.open(folder, "ann")
    editor = correction.edit(FRAMES[0])
    for k in range(strokes):
        editor.paint(dab(k), 1 + k % 11)
    correction.abandon()
    return editor.parts


def worked(folder: Path) -> np.ndarray:
    """The first frame corrected and accepted in good order."""
    with Correction.open(folder, "ann") as correction:
        editor = correction.edit(FRAMES[0])
        editor.paint(dab(1), 5)
        editor.swap_left_right()
        editor.judge("accept")
    return editor.parts


# Going on


def test_a_killed_session_goes_on_at_the_last_stroke_with_its_whole_history(folder):
    automatic = LabelSet.open(folder).read(FRAMES[0]).parts
    result = killed(folder)
    np.testing.assert_array_equal(LabelSet.open(folder).read(FRAMES[0]).parts, automatic)
    assert "open the set once with fix" in validate(LabelSet.open(folder))[0]
    with Correction.open(folder, "bob") as correction:
        # Readers of the labels alone, for training or export, have all strokes from here on.
        np.testing.assert_array_equal(correction.labels.read(FRAMES[0]).parts, result)
        editor, undone = correction.edit(FRAMES[0]), 0
        while editor.undo():
            undone += 1
        np.testing.assert_array_equal(editor.parts, automatic)
    assert undone == 5
    with Correction.open(folder, "bob") as correction:
        editor = correction.edit(FRAMES[0])
        while editor.redo():
            pass
    np.testing.assert_array_equal(LabelSet.open(folder).read(FRAMES[0]).parts, result)


def test_a_saved_frame_says_what_was_done_and_by_whom(folder):
    clock, before = Clock(), files(folder)
    with Correction.open(folder, "ann", clock=clock) as correction:
        editor = correction.edit(FRAMES[1])
        for operation in (
            lambda: editor.paint(dab(0), 5),
            editor.undo,
            editor.redo,
            lambda: editor.judge("accept"),
        ):
            clock.now += 2
            operation()
    frame = LabelSet.open(folder).read(FRAMES[1])
    assert (frame.status, frame.subject) == ("corrected", "s")
    assert frame.notes == {
        "confidence": 0.5,
        "who": "ann",
        "when": "1970-01-01T00:00:08.000+00:00",
        "active_seconds": 8.0,
        "strokes": 1,
        "undos": 1,
        "operations": {"paint": 1, "undo": 1, "redo": 1, "accept": 1},
        "accepted": True,
        "rejected": None,
        "journal": 4,
    }
    after = files(folder)
    touched = {f"frames/{FRAMES[1]}.parts.png", f"frames/{FRAMES[1]}.json"}
    new = {JOURNAL, f"original/{FRAMES[1]}.parts.png", f"original/{FRAMES[1]}.json"}
    assert {name for name in after if after[name] != before.get(name)} == touched | new
    for name in touched:
        assert after[name.replace("frames", "original")] == before[name]
    assert validate(LabelSet.open(folder)) == []


def test_looking_alone_changes_nothing_and_its_time_is_kept(folder):
    before, clock = files(folder), Clock()
    with Correction.open(folder, "ann", clock=clock) as correction:
        for frame_id in FRAMES:
            correction.edit(frame_id)
            correction.save(frame_id)
    assert files(folder) == before
    with Correction.open(folder, "ann", clock=clock) as correction:
        editor = correction.edit(FRAMES[0])
        clock.now += 5
        editor.time.mark("navigating")
    frame = LabelSet.open(folder).read(FRAMES[0])
    assert (frame.status, frame.notes["active_seconds"], frame.notes["strokes"]) == ("auto", 5, 0)


def test_frames_are_saved_on_a_verdict_and_on_leaving(folder):
    labels = LabelSet.open(folder)
    with Correction.open(folder, "ann") as correction:
        editor = correction.edit(FRAMES[0])
        for operation, saved in (
            (lambda: editor.paint(dab(0), 5), None),
            (lambda: editor.judge("accept"), 2),
            (editor.undo, 3),
            (editor.undo, 3),
            (lambda: correction.edit(FRAMES[1]), 4),
        ):
            operation()
            assert labels.notes(FRAMES[0]).get("journal") == saved


def test_a_save_cut_off_between_its_two_files_does_no_harm(folder):
    killed(folder, 3)
    stale = files(folder)[f"frames/{FRAMES[0]}.json"]
    with Correction.open(folder, "ann") as correction:
        editor = correction.edit(FRAMES[0])
        editor.undo()
        editor.paint(dab(9), 9)
    (folder / "frames" / f"{FRAMES[0]}.json").write_bytes(stale)
    with Correction.open(folder, "ann") as correction:
        np.testing.assert_array_equal(correction.frame(FRAMES[0]).parts, editor.parts)


@given(cut=st.floats(0, 1))
@law
def test_recorded_work_gives_the_same_labels_again_up_to_any_stroke(folder, cut):
    again = folder.with_name("again")
    for path in (again, folder.with_name("work")):
        shutil.rmtree(path, ignore_errors=True)
    mine = Path(shutil.copytree(folder, folder.with_name("work")))
    shutil.copytree(folder, again)
    seen = []
    with Correction.open(mine, "simulated") as correction:
        for frame_id in FRAMES[:2]:
            editor = correction.edit(frame_id)
            for k in range(4):
                editor.paint(dab(k), 4 + k)
                seen.append((frame_id, editor.parts.copy()))
    np.testing.assert_array_equal(
        [replayed(LabelSet.open(again), Journal.of(mine), frame_id).parts for frame_id in FRAMES],
        [frame.parts for frame in LabelSet.open(mine)],
    )
    lines = (mine / JOURNAL).read_bytes().splitlines(keepends=True)
    kept = round(cut * len(lines))
    (again / JOURNAL).write_bytes(b"".join(lines[:kept]))
    with Correction.open(again, read_only=True) as correction:
        if kept:
            frame_id, parts = seen[kept - 1]
            np.testing.assert_array_equal(correction.frame(frame_id).parts, parts)


def test_states(folder):
    with Correction.open(folder, "ann") as correction:
        editor, other = correction.edit(FRAMES[0]), FRAMES[1]
        for operation, state, status in (
            (lambda: None, "auto", "auto"),
            (lambda: editor.paint(dab(0), 9), "touched", "corrected"),
            (lambda: editor.judge("accept"), "accepted", "corrected"),
            (lambda: editor.judge("agree"), "reviewed", "reviewed"),
            (editor.undo, "accepted", "corrected"),
            (editor.undo, "touched", "corrected"),
            (editor.undo, "touched", "corrected"),
            (lambda: editor.judge("reject", "the arms\nare swapped"), "rejected", "corrected"),
        ):
            operation()
            correction.save(FRAMES[0])
            assert (correction.state(FRAMES[0]), correction.labels.status(FRAMES[0])) == (state, status)
        assert correction.labels.notes(FRAMES[0])["rejected"] == "the arms are swapped"
        for operation, state, status, reason in (
            (lambda: correction.edit(other).judge("reject", "blurred"), "rejected", "auto", "blurred"),
            (lambda: correction.edit(other).judge("accept"), "accepted", "corrected", None),
            (lambda: correction.edit(other).undo(), "rejected", "auto", "blurred"),
            (lambda: correction.edit(other).undo(), "auto", "auto", None),
        ):
            operation()
            assert (correction.state(other), correction.labels.status(other)) == (state, status)
            assert correction.labels.notes(other)["rejected"] == reason


# One at a time


def test_a_second_window_is_refused_but_may_look(folder):
    with Correction.open(folder, "ann") as correction:
        correction.edit(FRAMES[0]).paint(dab(0), 9)
        with pytest.raises(ClaimedError, match="ann@"):
            Correction.open(folder, "bob")
        before = files(folder)
        with Correction.open(folder, "bob", read_only=True) as looking:
            np.testing.assert_array_equal(looking.frame(FRAMES[0]).parts, correction.frame(FRAMES[0]).parts)
            for refused in (looking.edit, looking.restore):
                with pytest.raises(CloudError, match="read-only"):
                    refused(FRAMES[0])
        assert files(folder) == before
    Correction.open(folder, "bob").close()


def test_a_set_that_cannot_be_opened_is_not_claimed(folder):
    (folder / JOURNAL).write_bytes(b"nonsense\n")
    with pytest.raises(FormatError, match="line 1") as refusal:
        Correction.open(folder)
    assert validate(LabelSet.open(folder)) == [str(refusal.value)]
    assert not (folder / "claim.json").exists()


# Full disks


def test_a_full_disk_loses_no_stroke(folder):
    correction = Correction.open(folder, "ann")
    editor = correction.edit(FRAMES[0])
    editor.paint(dab(0), 9)
    before = files(folder)
    with largest_file(10):
        for k in (1, 2):
            with pytest.raises(NotSavedError, match="free some space"):
                editor.paint(dab(k), 9)
        other = correction.edit(FRAMES[1])
        for refused in (lambda: other.paint(dab(3), 9), lambda: other.judge("accept"), correction.close):
            with pytest.raises(NotSavedError):
                refused()
        # Two strokes, then, on another frame that has no original yet, a stroke and a verdict.
        assert correction.unsaved == 4
        assert files(folder) == before
        np.testing.assert_array_equal(correction.frame(FRAMES[0]).parts, editor.parts)
    editor.undo()
    assert correction.unsaved == 0
    correction.close()
    with Correction.open(folder, read_only=True) as again:
        for frame_id, ours in ((FRAMES[0], editor), (FRAMES[1], other)):
            np.testing.assert_array_equal(again.labels.read(frame_id).parts, ours.parts)
        assert again.state(FRAMES[1]) == "accepted"


# Corrupt files


@pytest.mark.parametrize("suffix", ["parts.png", "json"])
@pytest.mark.parametrize("spoil", ["empty", "cut"])
def test_a_corrupt_frame_blocks_opening_and_is_rebuilt(folder, suffix, spoil):
    parts, before = worked(folder), files(folder)
    path = folder / "frames" / f"{FRAMES[0]}.{suffix}"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] if spoil == "cut" else b"")
    with Correction.open(folder, "bob") as correction:
        spoilt = files(folder)
        with pytest.raises(RestorableError, match=rf"{path.name}.*rebuild it from original"):
            correction.edit(FRAMES[0])
        assert files(folder) == spoilt
        np.testing.assert_array_equal(correction.restore(FRAMES[0]).parts, parts)
        np.testing.assert_array_equal(correction.edit(FRAMES[0]).parts, parts)
    assert files(folder) == before


def test_what_was_never_corrected_or_has_no_depth_cannot_be_rebuilt(folder):
    worked(folder)
    for frame_id, suffix in ((FRAMES[1], "parts.png"), (FRAMES[0], "depth.png")):
        (folder / "frames" / f"{frame_id}.{suffix}").write_bytes(b"")
        with Correction.open(folder, "bob") as correction:
            with pytest.raises(FormatError, match="restore it from a copy") as refusal:
                correction.edit(frame_id)
            assert not isinstance(refusal.value, RestorableError)
            with pytest.raises(FormatError):
                correction.restore(frame_id)


def test_labels_are_not_thrown_away_for_a_journal_that_lost_lines(folder):
    worked(folder)
    (folder / JOURNAL).write_bytes((folder / JOURNAL).read_bytes().splitlines(keepends=True)[0])
    before = files(folder)
    with Correction.open(folder, "bob") as correction:
        for refused in (correction.frame, correction.edit, correction.restore):
            with pytest.raises(FormatError, match=r"holds 1 entries .* 3 are applied; restore it"):
                refused(FRAMES[0])
    assert files(folder) == before


def test_a_copy_without_its_history_begins_anew(folder):
    parts = worked(folder)
    (folder / JOURNAL).unlink()
    shutil.rmtree(folder / "original")
    correction = Correction.open(folder, "bob")
    editor = correction.edit(FRAMES[0])
    np.testing.assert_array_equal(editor.parts, parts)
    assert editor.undo() is None and editor.paint(dab(5), 11)
    correction.abandon()
    with Correction.open(folder, "bob") as correction:
        correction.edit(FRAMES[0]).undo()
        np.testing.assert_array_equal(correction.edit(FRAMES[0]).parts, parts)


@pytest.mark.parametrize(
    ("runs", "says"), [([[H * W, 1, 0, 1]], "reaches pixel"), ([[0, 2, 0, 1]], "without depth")]
)
def test_a_journal_of_another_set_is_refused(folder, runs, says):
    hostile = Stroke(FRAMES[0], "paint", np.array(runs, np.int64), 1)
    (folder / JOURNAL).write_bytes(to_line(hostile))
    with Correction.open(folder, "bob") as correction, pytest.raises(FormatError, match=says):
        correction.edit(FRAMES[0])
    other = Stroke(FRAMES[0], "paint", np.array([[3 * W, 1, 8, 9]], np.int64), 1)
    (folder / JOURNAL).write_bytes(to_line(other))
    with pytest.raises(FormatError, match="do not fit"):
        replayed(LabelSet.open(folder), Journal.of(folder), FRAMES[0])


def test_what_killed_processes_left_is_swept(folder):
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        gone.wait()
    litter = folder / "frames" / f".{FRAMES[0]}.parts.png.{gone.pid}.partial"
    alive = folder / "frames" / f".{FRAMES[0]}.parts.png.1.partial"
    for path in (litter, alive):
        path.write_bytes(b"x")
    Correction.open(folder).close()
    assert (litter.exists(), alive.exists()) == (False, True)
