"""Strokes and verdicts are one history: undo and redo walk it as they would walk a list of states."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.correction.correction import Correction
from annotate.correction.edit import Editor
from annotate.correction.replay import rejected_by, rejection, state_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import Stroke, from_line, to_line
from sensors.rig.camera import Intrinsics

SHAPE = (2, 4)
FRAME = FrameLabels("f", np.full(SHAPE, 1500, np.uint16), np.zeros(SHAPE, np.uint8))
AFTER = {"accept": "accepted", "reject": "rejected", "agree": "reviewed"}
BASES = {"auto": "auto", "corrected": "accepted", "reviewed": "reviewed", "truth": "reviewed"}
actions = st.lists(
    st.one_of(
        st.tuples(st.just("paint"), st.integers(0, 7), st.integers(0, 11)),
        st.tuples(st.sampled_from(["accept", "reject", "agree"])),
        st.tuples(st.sampled_from(["undo", "redo", "undo", "redo", "leave"])),
    ),
    max_size=25,
)


def judged(state: str, verdict: str) -> str:
    """The state after a verdict: agreeing with a rejection leaves it."""
    return "rejected" if verdict == "agree" and state == "rejected" else AFTER[verdict]


def done(editor: Editor, name: str, *arguments: int) -> bool:
    """Do an action; returns whether it had an effect."""
    if name in AFTER:
        return editor.judge(name, "blurred") is not None
    if name == "paint":
        return editor.paint(np.array(arguments[:1]), arguments[1]) is not None
    return getattr(editor, name)() is not None


@given(work=actions, saved=st.sampled_from(sorted(BASES)))
@settings(max_examples=300)
def test_any_work_is_a_walk_on_a_list_of_states(work, saved):
    entries: list[Stroke] = []
    editor = Editor(FRAME, "ann", entries.append)
    states, at, painted = [(FRAME.parts.copy(), BASES[saved])], 0, False
    for name, *arguments in work:
        had_effect = done(editor, name, *arguments)
        if name == "undo":
            assert had_effect == (at > 0)
            at = max(0, at - 1)
        elif name == "redo":
            assert had_effect == (at + 1 < len(states))
            at = min(len(states) - 1, at + 1)
        elif had_effect and name != "leave":
            parts, state = states[at]
            state = judged(state, name) if name in AFTER else "touched"
            states[at + 1 :] = [(editor.parts.copy(), state)]
            at, painted = at + 1, painted or name == "paint"
        parts, state = states[at]
        np.testing.assert_array_equal(editor.parts, parts)
        # A worked frame is never automatic again: learning leaves it alone.
        wanted = "touched" if state == "auto" and painted else state
        assert state_of([from_line(to_line(entry)) for entry in entries], saved) == wanted


def test_a_journal_of_before_in_which_a_stroke_came_back_after_a_verdict_is_read(tmp_path):
    """Earlier versions let a redo pass a verdict: the frame is as it was left, in progress."""
    labels = LabelSet.create(tmp_path / "labels", Intrinsics(4, 2, 3.0, 3.0, 2.0, 1.0), {})
    labels.write(FRAME)
    labels.keep_original("f")
    runs, none = np.array([[0, 2, 0, 1]], np.int64), np.empty((0, 4), np.int64)
    undone = Stroke("f", "undo", np.array([[0, 2, 1, 0]], np.int64))
    work = [Stroke("f", "paint", runs, 1), undone, Stroke("f", "accept", none), Stroke("f", "redo", runs, 1)]
    (labels.path / "journal.jsonl").write_bytes(b"".join(map(to_line, work)))
    with Correction.open(labels.path, "ann") as correction:
        editor = correction.edit("f")
        assert correction.state("f") == "touched" and editor.parts.flat[0] == 1
        editor.undo()
        assert correction.state("f") == "accepted" and editor.parts.flat[0] == 0


def test_who_agrees_with_a_rejection_leaves_it_and_its_reason():
    entries: list[Stroke] = []
    Editor(FRAME, "ann", entries.append).judge("reject", "blurred")
    reviewer = Editor(FRAME, "ben", entries.append)
    reviewer.judge("agree")
    assert state_of(entries) == "rejected" and rejection(entries) == "blurred"
    assert rejected_by(entries).who == "ann"
    reviewer.undo()
    assert state_of(entries) == "rejected"


@pytest.mark.parametrize("saved", ["corrected", "reviewed", "truth"])
def test_taking_everything_back_gives_the_status_from_before(tmp_path, saved):
    labels = LabelSet.create(tmp_path / "labels", Intrinsics(4, 2, 3.0, 3.0, 2.0, 1.0), {})
    labels.write(FrameLabels("f", FRAME.depth_mm, FRAME.parts, status=saved))
    for work in (lambda editor: (editor.judge("reject", "blurred"), editor.undo()), lambda editor: None):
        with Correction.open(labels.path, "ann") as correction:
            work(correction.edit("f"))
            assert correction.state("f") == BASES[saved]
