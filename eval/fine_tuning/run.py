"""Fine-tuning of a segmentation network on corrected frames, with a suit or without."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from copy import deepcopy
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
from eval.fine_tuning.weights_between import between
from eval.training.progress import Progress
from eval.training.segmentation.augmentation import Sampling
from eval.training.segmentation.examples import Example
from eval.training.segmentation.network import (
    SuitNet,
    expanded_suit_network,
    export_suit_network,
    load_suit_network,
)
from eval.training.segmentation.train import Stage, SuitTraining, by_steps, train_stage
from sensors.errors import CloudError

STEPS_EACH, MOST_STEPS = (
    25,
    200,
)  # steps a corrected frame, and at most; best of 60, 100, 200 on 8 and 20 frames (65002)
SIDE = 112  # samples along a drawn square, 1.3 m; untuned
RATE, AVERAGED = 2e-3, 0.9  # peak of the learning rate (better than 1e-3, seed 61001), decay of the average
SEED = 0  # of the samples; the same corrections give the same network


class FineTuner(ABC):
    """Segmentation network that is fine-tuned on corrections of the labels that it predicted.

    start: weights (.onnx) in full precision; the network gets the classes of the labels' scheme, things
    included. degrade: as in ``Sampling``. Raises FormatError if ``start`` holds no weights of a suit network.
    """

    start_network: SuitNet

    def __init__(self, labels: LabelSet, start: Path, *, degrade: bool) -> None:
        self._labels = labels
        self.start_network = expanded_suit_network(load_suit_network(start), labels.scheme)
        self._start, self._degrade = sha256(start), degrade

    @abstractmethod
    def examples(self, frames: Sequence[CorrectedFrame], progress: Progress) -> list[Example]:
        """Return the training examples of frames."""

    @abstractmethod
    def parts(self, frames: Sequence[CorrectedFrame], weights: Sequence[Path]) -> Iterator[list[UInt8]]:
        """Yield the parts (h, w) of each frame as each of the saved weights predicts them."""

    @abstractmethod
    def step(self, weights: Path) -> dict[str, Any]:
        """Return the label set's manifest entry that names the saved weights."""

    @abstractmethod
    def labels(self, correction: Correction, weights: Path) -> Iterator[FrameLabels]:
        """Yield labels of the untouched frames, predicted with saved weights."""

    def train(
        self,
        frames: Sequence[CorrectedFrame],
        rehearsed: Sequence[CorrectedFrame],
        run: Path,
        progress: Progress,
    ) -> SuitNet:
        """Return the first network, trained on corrected and rehearsed frames in equal shares.

        run: folder of checkpoints, to resume from. Raises CloudError where no corrected frame is usable.
        """
        torch.set_num_threads(1)
        taught = self.examples(frames, progress)
        if not taught:
            raise CloudError(
                f"accepted frames of {self._labels.path} show no readable person or suit; accept frames that "
                "show it in even light"
            )
        kept = self.examples(rehearsed, progress) if rehearsed else []
        examples = taught * max(1, round(len(kept) / len(taught))) + kept
        steps = min(STEPS_EACH * len(taught), MOST_STEPS)
        # By part: feet below a blanket are few pixels, far from the rest, and most often wrong.
        sampling = Sampling(SAMPLE_M, SIDE, by_part=True, degrade=self._degrade)
        stage = Stage(sampling, steps, RATE, AVERAGED, statistics=False)
        checkpoint = run / f"{digest_of(self._start, examples, stage)}.safetensors"
        with progress("learn, steps", steps) as advance:
            training = SuitTraining(examples, stage, SEED, self._labels.scheme)
            return train_stage(deepcopy(self.start_network), training, checkpoint, by_steps(advance))

    def save(self, network: SuitNet, share: float, path: Path) -> None:
        """Write the network at a share of the way from the first to a trained one (.onnx).

        A training can start from the file.
        """
        export_suit_network(between(self.start_network, network, share), path)


def digest_of(start: str, examples: Sequence[Example], stage: Stage) -> str:
    """Return the shortened SHA-256 of all inputs of a training: start, examples and stage."""
    digest = hashlib.sha256(f"{start} {stage} {SEED}".encode())
    for example in examples:
        for array in example:
            digest.update(f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
