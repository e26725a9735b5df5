"""Fine-tuning of the suit network on corrected labels and the recording from which the labels were made."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import UInt8
from annotate.cloud.fuse import Fuser
from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitDetection, SuitLabeller, calibrated
from annotate.labelset.label_set import LabelSet, as_read
from annotate.labelset.source_recording import find_session
from annotate.segmentation.labels_of_frame import labels_of
from annotate.segmentation.suit_network import SuitNetwork, shipped_suit_network
from annotate.suit.palette import suit_from_toml
from eval.fine_tuning.run import FineTuner
from eval.fine_tuning.training_split import CorrectedFrame
from eval.training.progress import Progress
from eval.training.segmentation.examples import Example, detected_example
from eval.training.segmentation.network import FULL_SUIT_NETWORK
from sensors.errors import CloudError, Setting
from sensors.importers.open_source import open_source


class SuitFineTuner(FineTuner):
    """Fine-tuning of the suit network.

    session: recording that was labelled; None = the one beside the labels. start: weights (.onnx); None = the
    shipped ones. Raises CloudError where the recording is missing or was not the labelled one, or where the
    labels were made with other weights.
    """

    def __init__(self, labels: LabelSet, session: Path | None, start: Path | None) -> None:
        session, how = session or find_session(labels), suit_step(labels)
        if session is None:
            raise CloudError(f"{labels.path} was made with a suit; give its recording", Setting.SESSION)
        super().__init__(labels, start or FULL_SUIT_NETWORK, degrade=True)
        self._source, self._suit = (
            open_source(session),
            suit_from_toml(how["suit"], f"the suit in {labels.path}"),
        )
        self._window_c = tuple(how["window_c"]) if how.get("window_c") else None
        self._first_network = SuitNetwork(start) if start else shipped_suit_network()
        if self._first_network.sha256 != how.get("weights_sha256", shipped_suit_network().sha256):
            raise CloudError(
                f"{labels.path} was not labelled by {start or 'the shipped network'}; give its weights",
                Setting.WEIGHTS,
            )
        self._ids, self._examples = set(labels.frame_ids), dict[str, Example]()

    def examples(self, frames: Sequence[CorrectedFrame], progress: Progress) -> list[Example]:
        """Return the training examples of frames; each input contains the previous frame's first labels."""
        ids = {frame.first.frame_id: frame.corrected for frame in frames}
        if new := ids.keys() - self._examples.keys():
            with progress("read the recording, frames", len(new)) as advance:
                for frame_id, detection in self._detections(new):
                    before = self._first_before(frame_id)
                    example = detected_example(
                        detection, ids[frame_id], before, self._suit, self._first_network
                    )
                    if example is not None:
                        self._examples[frame_id] = example
                    advance(1)
        return [self._examples[frame_id] for frame_id in ids if frame_id in self._examples]

    def parts(self, frames: Sequence[CorrectedFrame], weights: Sequence[Path]) -> Iterator[list[UInt8]]:
        labellers = [SuitLabeller(self._suit, SuitNetwork(path)) for path in weights]
        for frame_id, found in self._detections([frame.first.frame_id for frame in frames]):
            before = self._first_before(frame_id)
            yield [labeller.label(found, before)[0].parts for labeller in labellers]

    def step(self, weights: Path) -> dict[str, Any]:
        return {"label": suit_step(self._labels) | {"weights_sha256": SuitNetwork(weights).sha256}}

    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        """Yield new labels of untouched frames; each input contains the previous frame's current labels."""
        labeller = SuitLabeller(self._suit, SuitNetwork(weights))
        made: FrameLabels | None = None
        for frame_id, detection in self._detections(untouched(correction)):
            earlier = self._before(frame_id)
            if made is None or made.frame_id != earlier:
                made = correction.frame(earlier) if earlier else None
            labelled = labels_of(frame_id, detection.cloud.depth_mm, *labeller.label(detection, made))
            made = as_read(labelled)
            yield labelled

    def _first_before(self, frame_id: str) -> FrameLabels | None:
        """Return the first labels of the frame before ``frame_id``, if any."""
        earlier = self._before(frame_id)
        if earlier is None:
            return None
        return self._labels.read(earlier, original=self._labels.has_original(earlier))

    def _before(self, frame_id: str) -> str | None:
        """Return the id of the recording's frame just before ``frame_id``, if that frame has labels."""
        earlier = f"{max(int(frame_id) - 1, 0):06d}"
        return earlier if earlier in self._ids and earlier != frame_id else None

    def _detections(self, wanted: Collection[str]) -> Iterator[tuple[str, SuitDetection]]:
        """Yield id and suit detection of each wanted frame, in the recording's order.

        Raises CloudError if the labels were made on another recording.
        """
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
            f"{self._source.name} is not the recording of {self._labels.path}; give the right one",
            Setting.SESSION,
        )


def suit_step(labels: LabelSet) -> dict[str, Any]:
    """Return the manifest entry about the suit of a label set; empty without a suit."""
    steps = labels.info.get("steps")
    step = steps.get("label") if isinstance(steps, dict) else None
    return step if isinstance(step, dict) and isinstance(step.get("suit"), str) else {}
