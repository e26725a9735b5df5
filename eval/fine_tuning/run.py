"""Fine-tuning of a segmentation network on corrected frames, with a suit or without."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import sha256
from annotate.labelset.label_set import LabelSet
from annotate.segmentation.segment import SAMPLE_M
from eval.fine_tuning.training_split import CorrectedFrame
from eval.training.segmentation.augmentation import Sampling
from eval.training.segmentation.examples import Example
from eval.training.segmentation.network import (
    expanded_suit_network,
    export_suit_network,
    load_suit_network,
)
from eval.training.segmentation.train import Progress, Stage, SuitTraining, by_steps, train_stage

STEPS_EACH, MOST_STEPS = (
    25,
    200,
)  # steps a frame, and at most; best of 60, 100, 200 on 8 and 20 frames (65002)
MORE = 0.3  # share of the steps that follow on all frames
SIDE = 112  # samples along a drawn square, 1.3 m; untuned
RATE, AVERAGED = 2e-3, 0.9  # peak of the learning rate (better than 1e-3, seed 61001), decay of the average
SEED = 0  # of the samples; the same corrections give the same network


class FineTuner(ABC):
    """Segmentation network that is fine-tuned on corrections of the labels that it predicted.

    start: weights (.onnx) in full precision; the network gets the classes of the labels' scheme, things
    included. degrade: as in ``Sampling``. Raises FormatError if ``start`` holds no weights of a suit network.
    """

    def __init__(self, labels: LabelSet, start: Path, *, degrade: bool) -> None:
        self._labels = labels
        self._network = expanded_suit_network(load_suit_network(start), labels.scheme)
        self._start, self._degrade = sha256(start), degrade

    @abstractmethod
    def examples(self, frames: Sequence[CorrectedFrame], progress: Progress) -> list[Example]:
        """Return the training examples of corrected frames."""

    @abstractmethod
    def parts(self, frames: Sequence[CorrectedFrame], weights: Path) -> list[UInt8]:
        """Return parts (h, w) of frames, predicted with saved weights, in place of the first labels."""

    @abstractmethod
    def step(self, weights: Path) -> dict[str, Any]:
        """Return the label set's manifest entry that names the saved weights."""

    @abstractmethod
    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        """Yield labels of the untouched frames, predicted with saved weights."""

    def train(self, frames: Sequence[CorrectedFrame], more: bool, run: Path, progress: Progress) -> None:
        """Train on corrected frames.

        more: True for the shorter training on all frames, which continues the training on some. run: folder
        of checkpoints, to resume from.
        """
        torch.set_num_threads(1)
        examples = self.examples(frames, progress)
        steps = round(min(STEPS_EACH * len(examples), MOST_STEPS) * (MORE if more else 1))
        # By part: feet below a blanket are few pixels, far from the rest, and most often wrong.
        sampling = Sampling(SAMPLE_M, SIDE, by_part=True, degrade=self._degrade)
        stage = Stage(sampling, steps, RATE, AVERAGED, statistics=False)
        name = f"{'all' if more else 'some'}.safetensors"
        checkpoint = run / digest_of(self._start, examples, stage) / name
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        with progress("learn, steps", steps) as advance:
            training = SuitTraining(examples, stage, SEED, self._labels.scheme)
            self._network = train_stage(self._network, training, checkpoint, by_steps(advance))

    def save(self, path: Path) -> None:
        """Write the network (.onnx); a training can start from the file."""
        export_suit_network(self._network, path)


def digest_of(start: str, examples: Sequence[Example], stage: Stage) -> str:
    """Return the shortened SHA-256 of all inputs of a training: start, examples and stage."""
    digest = hashlib.sha256(f"{start} {stage} {SEED}".encode())
    for example in examples:
        for array in example:
            digest.update(f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
