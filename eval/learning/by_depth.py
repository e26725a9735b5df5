"""What learns of people without a suit: the network that sees their depth alone."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Float32, UInt8, UInt16
from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.crop import network_crop, normalize, person_of
from annotate.frame_labels import FrameLabels
from annotate.label_source import notes_of
from annotate.parts import BACKGROUND
from annotate.reader.segmentation import Segmentation
from eval.learning.lesson import Taught
from eval.network.checkpoint import load_weights, save_weights
from eval.network.networks import export_onnx
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.steady import steady
from eval.training.augment import Augmentation
from eval.training.crops import DEPTH_STEPS, Crops
from eval.training.plan import ModernRecipe, Plan
from eval.training.processes import ALONE
from eval.training.reader.fit import Progress
from eval.training.train import Watch, train
from eval.training.whole import nothing_known
from sensors.errors import ExistsError

STEPS, MORE_STEPS = 120, 60
"""Steps on the frames that are not held out, and then on all of them: two minutes of one core. Chosen by
eye."""
BATCH = 4
"""Crops of a step. Chosen by eye."""
RECIPE = ModernRecipe(batch=BATCH, peak_rate=1e-3, averaged=0.9, coarse=0.0, statistics=False)
"""A third of a training's rate, and normalisation as it came: a few frames of one person are no statistics.
Chosen by eye."""
HOW = Augmentation(occluders=False, cuts=False, borders=False, extras=False)
"""What may happen to a frame: what hides the person and what is taken along is this room's own."""
CHECKPOINT_S = 20.0
"""Seconds of work that a kill loses at most. Chosen by eye."""


class DepthLearner:
    """The network for depth images as ``learn.Learner``; start: weights (.safetensors) to learn from.

    Raises FormatError where they are no network's.
    """

    def __init__(self, start: Path | None) -> None:
        network, self._config = load_weights(start or SHIPPED_WEIGHTS.with_suffix(".safetensors"))
        self._network = network.float()

    def learn(self, taught: Sequence[Taught], more: bool, run: Path, progress: Progress) -> None:
        """Steps on these frames; goes on with what ``run`` holds of the same training."""
        images, run = BATCH * (MORE_STEPS if more else STEPS), run / ("all" if more else "some")
        crops, plan = crops_of(taught, images), Plan(self._config, RECIPE, HOW, epochs=1)
        with progress("learn, images", images) as advance:
            watch = Watch(advance, checkpoint_s=CHECKPOINT_S)
            fit = partial(train, crops, None, run, plan, ALONE, watch, self._network)
            try:
                self._network = fit()[0]
            except ExistsError:
                # Of other corrections than there are now.
                shutil.rmtree(run)
                self._network = fit()[0]

    def save(self, path: Path) -> None:
        """Write the network (.onnx), and beside it the weights that a training goes on from."""
        save_weights(path.with_suffix(".safetensors"), self._network, self._config)
        export_onnx(self._network, path)

    def parts(self, held: Sequence[Taught], weights: Path) -> list[UInt8]:
        """Parts (h, w) of frames by saved weights."""
        judge = OnnxNetwork(weights)
        return [segmented(judge, one.first).parts for one in held]

    def step(self, weights: Path) -> dict[str, Any]:
        """Entry of a label set's manifest about saved weights."""
        return {"predict": {"weights": OnnxNetwork(weights).sha256}}

    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        """Labels of the frames that nobody has worked on, by saved weights."""
        network, labels = OnnxNetwork(weights), correction.labels
        before: FrameLabels | None = None
        for frame_id in untouched(correction):
            first = labels.read(frame_id, original=labels.has_original(frame_id))
            found = steady(segmented(network, first), before)
            notes = notes_of(found)
            before = replace(first, parts=found.parts, confidence=found.confidence, notes=notes, persons=None)
            yield before


def segmented(network: OnnxNetwork, first: FrameLabels) -> Segmentation:
    """A frame by the network: first, its first labels, say where the person was extracted."""
    mask = person_of(first.parts)
    found, body = network.segment(first.depth_mm, mask), network.without_things(first.depth_mm, mask)
    parts = np.where(body, found.parts, np.uint8(BACKGROUND))
    return replace(found, parts=parts, confidence=np.where(body, found.confidence, np.float32(0)))


def crop_of(taught: Taught) -> tuple[UInt16, UInt8, Float32]:
    """As ``Crops`` takes it. What the extraction took along shows, and is background in the parts."""
    mask = person_of(taught.first.parts) & (taught.first.depth_mm > 0)
    square = network_crop(mask)
    depth = normalize(square.cut(taught.first.depth_mm, 0), square.cut(mask, False))
    parts = square.cut(taught.corrected.parts, BACKGROUND)
    return np.rint(depth * DEPTH_STEPS).astype(np.uint16), parts, nothing_known()


def crops_of(taught: Sequence[Taught], images: int) -> Crops:
    """That many crops; no frame appears more than once more often than another."""
    once = [crop_of(one) for one in taught]

    def again() -> Iterator[tuple[UInt16, UInt8, Float32]]:
        for n in range(images):
            yield once[n % len(once)]

    return Crops.of(again())
