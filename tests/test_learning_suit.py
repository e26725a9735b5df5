"""Learning with a suit: what it may change, and that it is kept only where it is better."""

import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from conftest import tree  # noqa: E402

from annotate.correction.correction import Correction  # noqa: E402
from annotate.correction.relabel import relabel, take_back  # noqa: E402
from annotate.labelset.label_set import LabelSet  # noqa: E402
from annotate.segmentation.suit_network import SHIPPED_SUIT_NETWORK, SuitNetwork  # noqa: E402
from eval.fine_tuning import by_suit  # noqa: E402
from eval.fine_tuning import fine_tune as learning  # noqa: E402
from eval.fine_tuning import run as practice  # noqa: E402
from eval.fine_tuning import training_split as lesson  # noqa: E402
from eval.training.segmentation.network import FULL_READER, export_reader, load_reader  # noqa: E402
from sensors.errors import CloudError  # noqa: E402
from synth.rig.simulate import truth_path  # noqa: E402

DONE, LEFT = ("000000", "000001"), "000002"


@contextmanager
def silent(what, total):
    yield lambda n: None


def learner(path: Path, session: Path, start: Path | None = None):
    return learning.learner_of(LabelSet.open(path), session, start)


@pytest.fixture
def taught(rig_session, rig_labels, tmp_path, monkeypatch) -> Path:
    """Labels of three frames, two corrected and accepted, of which one is held out; few small steps."""
    path = shutil.copytree(rig_labels.path, tmp_path / "labels")
    truth = LabelSet.open(truth_path(rig_session))
    with Correction.open(path, "ann") as correction:
        for frame_id in DONE:
            editor = correction.edit(frame_id)
            editor.replace("paint", truth.read(frame_id).parts)
            editor.judge("accept")
    monkeypatch.setattr(lesson, "LEAST_FRAMES", 2)
    monkeypatch.setattr(learning, "divided", lambda all_: (all_[:1], all_[1:]))
    for name, small in (("STEPS_EACH", 2), ("MORE", 0.5), ("SIDE", 32)):
        monkeypatch.setattr(practice, name, small)
    return path


def test_frames_left_are_read_again_the_same_way_twice_and_after_a_kill(
    taught, rig_session, tmp_path, monkeypatch
):
    monkeypatch.setattr(learning.Learnt, "better", True)
    before = tree(taught)
    done = learning.learn(taught, tmp_path / "model", learner(taught, rig_session), silent)
    assert tree(taught) == before and (done.frames, done.held_out) == (2, 1)
    assert LabelSet.open(done.labels).frame_ids == [LEFT]
    assert SuitNetwork(done.weights).sha256 != SuitNetwork(SHIPPED_SUIT_NETWORK).sha256

    def killed(*given):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(by_suit.SuitLearner, "parts", killed)
        learning.learn(taught, tmp_path / "again", learner(taught, rig_session), silent)
    assert tree(taught) == before
    steps = []

    @contextmanager
    def counted(what, total):
        yield lambda n: steps.append(what)

    again = learning.learn(taught, tmp_path / "again", learner(taught, rig_session), counted)
    assert steps.count("learn, steps") == 2, "the others are not taken twice"
    assert again.weights.read_bytes() == done.weights.read_bytes()
    np.testing.assert_array_equal(
        LabelSet.open(again.labels).read(LEFT).parts, LabelSet.open(done.labels).read(LEFT).parts
    )
    touched = {file: data for file, data in before.items() if any(i in str(file) for i in DONE)}
    with Correction.open(taught, "ann") as correction:
        relabel(correction, LabelSet.open(done.labels))
        take_back(correction)
    after = tree(taught)
    assert touched.items() <= after.items()
    parts = LabelSet.open(taught).read(LEFT).parts
    np.testing.assert_array_equal(parts, LabelSet.open(taught).read(LEFT, original=True).parts)


def test_what_is_no_better_on_the_frame_held_out_is_not_kept(taught, rig_session, tmp_path, monkeypatch):
    def first(self, held, weights):
        return [one.first.parts for one in held]

    monkeypatch.setattr(by_suit.SuitLearner, "parts", first)
    done = learning.learn(taught, tmp_path / "model", learner(taught, rig_session), silent)
    assert done.before == done.after and done.weights is done.labels is None
    assert [file.name for file in (tmp_path / "model").iterdir()] == [learning.RECORD]


def test_recording_and_weights_must_be_those_of_the_labels(taught, rig_session, tmp_path):
    with pytest.raises(CloudError, match="--session"):
        learner(taught, None)
    network = load_reader(FULL_READER)
    with torch.no_grad():
        network.leave.bias += 1
    export_reader(network, tmp_path / "other.onnx")
    with pytest.raises(CloudError, match="--weights"):
        learner(taught, rig_session, tmp_path / "other.onnx")
    known = LabelSet.open(taught)
    frame = known.read(DONE[0])
    frame.depth_mm[0, 0] += 1
    known.write(frame)
    with pytest.raises(CloudError, match="not the recording of"):
        learning.learn(taught, tmp_path / "model", learner(taught, rig_session), silent)
