"""What learns of people in a suit: the reader, which sees the recording too."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import UInt8
from annotate.cloud.fuse import Fuser
from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitDetection, SuitLabeller, calibrated, labels_of
from annotate.labelset.dataset import sha256
from annotate.labelset.label_set import LabelSet, as_read
from annotate.labelset.source_recording import find_session
from annotate.segmentation.suit_network import SuitNetwork, shipped_suit_network
from annotate.suit.palette import suit_from_toml
from eval.fine_tuning.run import Practice
from eval.fine_tuning.training_split import Taught
from eval.training.segmentation.examples import Example, example_in
from eval.training.segmentation.fit import Progress
from eval.training.segmentation.network import FULL_READER, export_reader, load_reader
from sensors.errors import CloudError
from sensors.importers.open_source import open_source


class SuitLearner:
    """The reader of suits as ``learn.Learner``.

    labels: read from a suit. session: their recording; None = the one beside them. start: weights (.onnx) to
    learn from; None = the shipped ones. Raises CloudError where the recording is missing or another one, or
    where the labels were made with other weights.
    """

    def __init__(self, labels: LabelSet, session: Path | None, start: Path | None) -> None:
        session, how = session or find_session(labels), suit_step(labels)
        if session is None:
            raise CloudError(f"{labels.path} was made with a suit; give its recording: --session RECORDING")
        self._labels, self._source = labels, open_source(session)
        self._suit = suit_from_toml(how["suit"], f"the suit in {labels.path}")
        self._window_c = tuple(how["window_c"]) if how.get("window_c") else None
        self._reader = SuitNetwork(start) if start else shipped_suit_network()
        self._network = load_reader(start or FULL_READER)
        if self._reader.sha256 != how.get("weights_sha256", shipped_suit_network().sha256):
            raise CloudError(
                f"{labels.path} was not labelled by {start or 'the shipped reader'}; give its weights with "
                "--weights"
            )
        self._practice = Practice(sha256(start or FULL_READER), spoilt=True)
        self._ids, self._examples = set(labels.frame_ids), dict[str, Example]()

    def learn(self, taught: Sequence[Taught], more: bool, run: Path, progress: Progress) -> None:
        """Steps on these frames; goes on with what ``run`` holds of the same training."""
        self._see(taught, progress)
        known = [self._examples[one.first.frame_id] for one in taught if one.first.frame_id in self._examples]
        if not known:
            raise CloudError(f"no accepted frame of {self._labels.path} shows a suit that can be read")
        self._network = self._practice.trained(self._network, known, more, run, progress)

    def save(self, path: Path) -> None:
        """Write the reader (.onnx); a training goes on from it, too."""
        export_reader(self._network, path)

    def parts(self, held: Sequence[Taught], weights: Path) -> list[UInt8]:
        """Parts (h, w) of frames by saved weights, after the first labels of the frames before."""
        labeller = SuitLabeller(self._suit, SuitNetwork(weights))
        seen = self._surveys([one.first.frame_id for one in held])
        return [labeller.label(survey, self._first_before(frame_id))[0].parts for frame_id, survey in seen]

    def step(self, weights: Path) -> dict[str, Any]:
        """Entry of a label set's manifest about saved weights."""
        return {"label": suit_step(self._labels) | {"weights_sha256": SuitNetwork(weights).sha256}}

    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        """Labels of the frames that nobody has worked on, by saved weights, each after the labels that the
        frame before has by now."""
        labeller = SuitLabeller(self._suit, SuitNetwork(weights))
        made: FrameLabels | None = None
        for frame_id, survey in self._surveys(untouched(correction)):
            earlier = self._before(frame_id)
            if made is None or made.frame_id != earlier:
                made = correction.frame(earlier) if earlier else None
            labelled = labels_of(frame_id, survey.cloud.depth_mm, *labeller.label(survey, made))
            made = as_read(labelled)
            yield labelled

    def _see(self, taught: Sequence[Taught], progress: Progress) -> None:
        """Make the examples of these frames that are not there yet, each after the first labels of the frame
        before: so it learns where these mislead."""
        new = {
            one.first.frame_id: one.corrected for one in taught if one.first.frame_id not in self._examples
        }
        if not new:
            return
        with progress("read the recording, frames", len(new)) as advance:
            for frame_id, survey in self._surveys(new):
                before = self._first_before(frame_id)
                example = example_in(survey, new[frame_id], before, self._suit, self._reader)
                if example is not None:
                    self._examples[frame_id] = example
                advance(1)

    def _first_before(self, frame_id: str) -> FrameLabels | None:
        """First labels of the frame before another, if it has any."""
        earlier = self._before(frame_id)
        if earlier is None:
            return None
        return self._labels.read(earlier, original=self._labels.has_original(earlier))

    def _before(self, frame_id: str) -> str | None:
        """Id of the frame just before another of the recording, if that has labels."""
        earlier = f"{max(int(frame_id) - 1, 0):06d}"
        return earlier if earlier in self._ids and earlier != frame_id else None

    def _surveys(self, wanted: Collection[str]) -> Iterator[tuple[str, SuitDetection]]:
        """Frames of the recording, by id, in its order. Raises CloudError where it is another one."""
        fuser, left = Fuser(self._source.calibration), set(wanted)
        labeller = SuitLabeller(self._suit, window_c=self._window_c)
        for frame in self._source:
            frame_id = f"{frame.index:06d}"
            if frame_id not in left:
                continue
            left.remove(frame_id)
            cloud = fuser.fuse_frame(calibrated(frame, fuser.calibration)[0])
            if not np.array_equal(cloud.depth_mm, self._labels.read(frame_id).depth_mm):
                break
            yield frame_id, labeller.detect(cloud)
            if not left:
                return
        raise CloudError(
            f"{self._source.name} is not the recording of {self._labels.path}; give it with --session"
        )


def suit_step(labels: LabelSet) -> dict[str, Any]:
    """How a label set was read from a suit, of its manifest; empty where it was not."""
    steps = labels.info.get("steps")
    step = steps.get("label") if isinstance(steps, dict) else None
    return step if isinstance(step, dict) and isinstance(step.get("suit"), str) else {}
