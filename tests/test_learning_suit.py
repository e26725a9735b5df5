"""Fine-tuning with a suit: it changes untouched frames only, and only where it is better."""

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
from eval.fine_tuning import by_suit, run, training_split  # noqa: E402
from eval.fine_tuning import fine_tune as tuning  # noqa: E402
from eval.fine_tuning.cross_validation import Gain  # noqa: E402
from eval.training.segmentation.network import (  # noqa: E402
    FULL_SUIT_NETWORK,
    export_suit_network,
    load_suit_network,
)
from sensors.errors import CloudError  # noqa: E402
from synth.rig.simulate import truth_path  # noqa: E402

DONE, LEFT = ("000000", "000001"), "000002"


@contextmanager
def silent(what, total):
    yield lambda n: None


def tuner(path: Path, session: Path, start: Path | None = None):
    return tuning.fine_tuner_of(LabelSet.open(path), session, start)


@pytest.fixture
def corrected(rig_session, rig_labels, tmp_path, monkeypatch) -> Path:
    """Labels of three frames, two corrected and accepted, each left out once; few small steps."""
    path = shutil.copytree(rig_labels.path, tmp_path / "labels")
    truth = LabelSet.open(truth_path(rig_session))
    with Correction.open(path, "ann") as correction:
        for frame_id in DONE:
            editor = correction.edit(frame_id)
            editor.replace("paint", truth.read(frame_id).parts)
            editor.judge("accept")
    monkeypatch.setattr(training_split, "LEAST_FRAMES", 2)
    for name, small in (("STEPS_EACH", 2), ("SIDE", 32)):
        monkeypatch.setattr(run, name, small)
    return path


def test_untouched_frames_get_the_same_labels_twice_and_after_an_interruption(
    corrected, rig_session, tmp_path, monkeypatch
):
    monkeypatch.setattr(Gain, "is_certain", True)
    before = tree(corrected)
    done = tuning.fine_tune(corrected, tmp_path / "model", tuner(corrected, rig_session), silent)
    assert tree(corrected) == before and done.measured_on == DONE
    assert LabelSet.open(done.labels).frame_ids == [LEFT]
    assert SuitNetwork(done.weights).sha256 != SuitNetwork(SHIPPED_SUIT_NETWORK).sha256

    def killed(*given):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(by_suit.SuitFineTuner, "labels", killed)
        tuning.fine_tune(corrected, tmp_path / "again", tuner(corrected, rig_session), silent)
    assert tree(corrected) == before
    steps = []

    @contextmanager
    def counted(what, total):
        yield lambda n: steps.append(what) if what == "learn, steps" else None

    again = tuning.fine_tune(corrected, tmp_path / "again", tuner(corrected, rig_session), counted)
    assert not steps, "the steps are not taken twice"
    assert again.weights.read_bytes() == done.weights.read_bytes()
    one, two = (LabelSet.open(found.labels).read(LEFT).parts for found in (done, again))
    np.testing.assert_array_equal(one, two)
    touched = {file: data for file, data in before.items() if any(i in str(file) for i in DONE)}
    with Correction.open(corrected, "ann") as correction:
        relabel(correction, LabelSet.open(done.labels))
        take_back(correction)
    assert touched.items() <= tree(corrected).items()
    labels = LabelSet.open(corrected)
    np.testing.assert_array_equal(labels.read(LEFT).parts, labels.read(LEFT, original=True).parts)


def test_a_network_without_a_certain_gain_is_not_kept(corrected, rig_session, tmp_path, monkeypatch):
    first = lambda self, held, weights: [[one.first.parts] * len(weights) for one in held]  # noqa: E731
    monkeypatch.setattr(by_suit.SuitFineTuner, "parts", first)
    done = tuning.fine_tune(corrected, tmp_path / "model", tuner(corrected, rig_session), silent)
    assert done.gain.before == done.gain.after and done.weights is done.labels is None
    assert [file.name for file in (tmp_path / "model").iterdir()] == [tuning.RECORD]


def test_recording_and_weights_must_be_those_of_the_labels(corrected, rig_session, tmp_path):
    with pytest.raises(CloudError, match="give its recording"):
        tuner(corrected, None)
    network = load_suit_network(FULL_SUIT_NETWORK)
    with torch.no_grad():
        network.leave.bias += 1
    export_suit_network(network, tmp_path / "other.onnx")
    with pytest.raises(CloudError, match="give its weights"):
        tuner(corrected, rig_session, tmp_path / "other.onnx")
    known = LabelSet.open(corrected)
    frame = known.read(DONE[0])
    frame.depth_mm[0, 0] += 1
    known.write(frame)
    with pytest.raises(CloudError, match="not the recording of"):
        tuning.fine_tune(corrected, tmp_path / "model", tuner(corrected, rig_session), silent)
