"""What learns of people without a suit: the reader, which sees depth and the first labels (docs/adr/0025)."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import sha256
from annotate.labelset.label_set import LabelSet
from annotate.segmentation.suit_network import SuitNetwork
from eval.fine_tuning.run import Practice
from eval.fine_tuning.training_split import Taught
from eval.network.refine import camera_in, depth_view, read_again
from eval.training.segmentation.examples import Example
from eval.training.segmentation.fit import Progress
from eval.training.segmentation.network import FULL_AGAIN, export_reader, load_reader
from sensors.rig.camera import Intrinsics


class DepthLearner:
    """The reader as ``learn.Learner`` for labels of a network.

    labels: of people without a suit. start: weights (.onnx) to learn from; None = the shipped ones. Raises
    FormatError where they are no reader's.
    """

    def __init__(self, labels: LabelSet, start: Path | None) -> None:
        start = start or FULL_AGAIN
        self._labels, self._network = labels, load_reader(start)
        self._practice = Practice(sha256(start), spoilt=False)

    def learn(self, taught: Sequence[Taught], more: bool, run: Path, progress: Progress) -> None:
        """Steps on these frames; goes on with what ``run`` holds of the same training."""
        known = [
            example
            for one in taught
            if (example := example_of(one.first, one.corrected.parts, camera_in(self._labels, one.first)))
        ]
        self._network = self._practice.trained(self._network, known, more, run, progress)

    def save(self, path: Path) -> None:
        """Write the reader (.onnx); a training goes on from it, too."""
        export_reader(self._network, path)

    def parts(self, held: Sequence[Taught], weights: Path) -> list[UInt8]:
        """Parts (h, w) of frames by saved weights."""
        reader = SuitNetwork(weights)
        return [self._again(one.first, reader).parts for one in held]

    def step(self, weights: Path) -> dict[str, Any]:
        """Entry of a label set's manifest about saved weights."""
        return {"predict": {"readers": [SuitNetwork(weights).sha256]}}

    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        """Labels of the frames that nobody has worked on, by saved weights."""
        reader, labels = SuitNetwork(weights), correction.labels
        for frame_id in untouched(correction):
            yield self._again(labels.read(frame_id, original=labels.has_original(frame_id)), reader)

    def _again(self, first: FrameLabels, reader: SuitNetwork) -> FrameLabels:
        return read_again(camera_in(self._labels, first), first, reader)


def example_of(first: FrameLabels, parts: UInt8, camera: Intrinsics) -> Example | None:
    """Example of a frame with true parts (h, w), as ``read_again`` sees it; None where that shows nobody."""
    seen = depth_view(first, camera)
    if seen is None:
        return None
    cloud, view = seen
    meta = np.array([cloud.camera.fx, cloud.camera.fx / view.pixels_per_m])
    return Example(view.planes, parts[view.where].copy(), meta)
