"""The audit counts each person's work as it stands in the end."""

from pathlib import Path

import numpy as np
import pytest

from annotate.correction.audit import audit
from annotate.correction.correction import Correction
from annotate.labelset.journal import JOURNAL, Journal
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import Gesture
from tests.helpers.correctable import FRAMES, Clock, W, correctable


@pytest.fixture
def folder(tmp_path) -> Path:
    return correctable(tmp_path / "labels")


def audited(folder: Path) -> Path:
    """Ann paints and accepts one frame and accepts another as it is; Bob mends the first."""
    clock = Clock()
    with Correction.open(folder, "ann", clock=clock) as correction:
        editor = correction.edit(FRAMES[0])
        clock.now += 10
        editor.paint(np.arange(2 * W + 2, 2 * W + 8), 7, Gesture("lasso", points=9))
        clock.now += 3
        editor.undo()
        editor.redo()
        editor.judge("accept")
        editor = correction.edit(FRAMES[1])
        clock.now += 5
        editor.judge("accept")
    with Correction.open(folder, "[b]bob", clock=clock) as correction:
        editor = correction.edit(FRAMES[0])
        clock.now += 4
        editor.paint(np.arange(2 * W + 2, 2 * W + 4), 2)
        editor.paint(np.arange(2 * W + 4, 2 * W + 5), 8)
        editor.judge("reject", "the hip is a guess")
    return folder


def test_the_audit_counts_what_stands_in_the_end(folder):
    found = audit(LabelSet.open(audited(folder)), Journal.of(folder))
    ann, bob = found.people
    assert found.rejected == {FRAMES[0]: "the hip is a guess"}
    assert (ann.who, ann.frames, ann.accepted, ann.accepted_untouched) == ("ann", 2, 2, 0.5)
    assert (ann.seconds_median, ann.seconds_p90, ann.strokes, ann.undos) == (9, 12.2, 1, 1)
    assert ann.seconds == {"painting": 13, "looking": 5}
    # Six torso pixels became hip; two of them are torso again, one went on by Bob's hand.
    assert ann.changed == round(3 / (2 * 96), 6)
    assert (ann.parts["hip"].gained_px, ann.parts["torso"].lost_px) == (3, 3)
    assert (ann.parts["hip"].strokes, ann.parts["hip"].seconds) == (1, 10)
    assert (bob.who, bob.frames, bob.strokes, bob.accepted_untouched) == ("[b]bob", 1, 2, 0)
    assert bob.changed == round(1 / 96, 6)
    assert bob.parts["left_upper_leg"].gained_px == 1


def test_info_shows_the_audit_and_names_a_corrupt_journal(folder, annotate_cloud):
    assert "audit" not in annotate_cloud("info", folder, "--json").result
    audited(folder)
    result = annotate_cloud("info", folder, "--json").result
    assert [person["who"] for person in result["audit"]["people"]] == ["ann", "[b]bob"]
    assert result["audit"]["people"][0]["parts"]["hip"]["gained_px"] == 3
    shown = annotate_cloud("info", folder).out
    for text in ("ann", "[b]bob", "left_upper_leg", f"rejected {FRAMES[0]}: the hip is a guess", "50%"):
        assert text in shown
    (folder / JOURNAL).write_bytes(b"[1]\n")
    done = annotate_cloud("info", folder)
    assert (done.code, done.out) == (1, "") and "journal.jsonl line 1" in done.err
