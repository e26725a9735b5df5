"""Labels that a person corrected in another program count as accepted where the user states so."""

from dataclasses import replace

import pytest

from annotate.correction.correction import Correction
from annotate.exchange.companion import COMPANION
from annotate.exchange.formats import export_labels
from annotate.labelset.label_set import LabelSet
from eval.fine_tuning.adaptation.labelled_people import taught_frames
from tests.helpers.label_sets import make


@pytest.fixture
def exported(rig_labels, tmp_path):
    """Return a function that exports the first frames with some statuses, with or without our companion."""

    def export(format_, statuses, ours):
        frames = [replace(frame, status=one) for frame, one in zip(rig_labels, statuses, strict=False)]
        labels = make(tmp_path / "set", rig_labels.intrinsics, frames)
        export_labels(labels, tmp_path / "theirs", format_, lambda _: None)
        if not ours:
            (tmp_path / "theirs" / COMPANION).unlink()
        return tmp_path / "theirs"

    return export


@pytest.mark.parametrize("format_", ["cvat", "coco", "pairs"])
def test_labels_of_other_programs_count_as_their_user_states(annotate_cloud, exported, tmp_path, format_):
    theirs = exported(format_, ["auto", "auto"], ours=False)
    assert annotate_cloud("import", theirs, tmp_path / "plain").code == 0
    assert annotate_cloud("import", theirs, tmp_path / "trusted", "--by-hand").code == 0
    states = [annotate_cloud("info", tmp_path / name, "--json").result for name in ("plain", "trusted")]
    assert [one["states"] for one in states] == [{"automatic": 2}, {"accepted": 2}]
    assert states[1]["steps"]["import"]["labels"] == "imported by hand"
    assert len(taught_frames(tmp_path / "trusted").sure) == 2
    with Correction.open(tmp_path / "trusted") as correction:
        assert {correction.state(frame_id) for frame_id in correction.labels.frame_ids} == {"accepted"}


def test_other_states_of_an_export_stay(annotate_cloud, exported, tmp_path):
    theirs = exported("cvat", ["auto", "reviewed", "truth"], ours=True)
    assert annotate_cloud("import", theirs, tmp_path / "back", "--by-hand").code == 0
    assert [frame.status for frame in LabelSet.open(tmp_path / "back")] == ["corrected", "reviewed", "truth"]


def test_a_recording_has_no_labels_by_hand(annotate_cloud, rig_session, tmp_path):
    done = annotate_cloud("import", rig_session, tmp_path / "x.mcap", "--by-hand")
    assert done.code == 2 and "are for labels" in done.err
