"""Fine-tuning of the refinement network on depth and first labels, without a suit (docs/adr/0025)."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.segmentation.suit_network import SuitNetwork
from eval.fine_tuning.run import FineTuner
from eval.fine_tuning.training_split import CorrectedFrame
from eval.network.refine import camera_in, depth_view, refine
from eval.training.progress import Progress
from eval.training.segmentation.examples import Example
from eval.training.segmentation.network import FULL_REFINEMENT_NETWORK
from sensors.rig.camera import Intrinsics


class DepthFineTuner(FineTuner):
    """Fine-tuning of the refinement network. start: weights (.onnx); None = the shipped weights."""

    def __init__(self, labels: LabelSet, start: Path | None) -> None:
        super().__init__(labels, start or FULL_REFINEMENT_NETWORK, degrade=False)

    def examples(self, frames: Sequence[CorrectedFrame], progress: Progress) -> list[Example]:
        found = (depth_example(f.first, f.corrected, camera_in(self._labels, f.first)) for f in frames)
        return [example for example in found if example]

    def parts(self, frames: Sequence[CorrectedFrame], weights: Sequence[Path]) -> Iterator[list[UInt8]]:
        networks = [SuitNetwork(path) for path in weights]
        for frame in frames:
            camera = camera_in(self._labels, frame.first)
            yield [refine(camera, frame.first, network).parts for network in networks]

    def step(self, weights: Path) -> dict[str, Any]:
        return {"predict": {"readers": [SuitNetwork(weights).sha256]}}

    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        network, labels = SuitNetwork(weights), correction.labels
        for frame_id in untouched(correction):
            first = labels.read(frame_id, original=labels.has_original(frame_id))
            yield refine(camera_in(self._labels, first), first, network)


def depth_example(first: FrameLabels, truth: FrameLabels, camera: Intrinsics) -> Example | None:
    """Return a training example: input of ``refine``, target the classes of the true parts; None without a
    person.

    Raises FormatError where the first labels do not convert to the truth's scheme.
    """
    found = depth_view(first, camera, scheme=truth.scheme)
    if found is None:
        return None
    cloud, view = found
    meta = np.array([cloud.camera.fx, cloud.camera.fx / view.pixels_per_m])
    return Example(view.planes, truth.scheme.class_table[truth.parts[view.where]], meta)
