"""Practice: how a reader learns from corrected frames, with a suit or without."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from annotate.segmentation.segment import SAMPLE_M
from eval.training.segmentation.examples import Example
from eval.training.segmentation.fit import Progress, shown
from eval.training.segmentation.network import ReaderNet
from eval.training.segmentation.train import Stage, trained

STEPS_EACH, MOST_STEPS, MORE = 25, 200, 0.3
"""Steps of eight samples for each frame that is not held out, and at most; share of them that follows on
all frames. Of 60, 100 and 200 steps the second was best on four evenly spread frames of a virtual person
without a suit (seed 65002), the last on eight and twenty: half a minute of one core."""
SIDE = 112
"""Samples along the side of a drawn image, 1.3 m. Untuned."""
RATE, AVERAGED = 2e-3, 0.9
"""Highest learning rate, and decay of the weights' average. Of 0.001 and 0.002 the last is better on 18
frames of a virtual person of whom eight others were taught (seed 61001); the average is untuned."""
SEED = 0
"""Of the samples drawn: the same corrections teach the same."""


@dataclass(frozen=True)
class Practice:
    """A learning's training. start: digest of the weights it begins with. spoilt: as of ``Stage``."""

    start: str
    spoilt: bool

    def trained(
        self,
        network: ReaderNet,
        known: Sequence[Example],
        more: bool,
        run: Path,
        progress: Progress,
    ) -> ReaderNet:
        """A network after some more steps on examples of taught frames; goes on with what ``run`` holds."""
        torch.set_num_threads(1)
        # By part: feet below a blanket are few pixels, far from the rest, and what most is wrong with.
        steps = round(min(STEPS_EACH * len(known), MOST_STEPS) * (MORE if more else 1))
        stage = Stage(
            SAMPLE_M, SIDE, steps, RATE, AVERAGED, statistics=False, by_part=True, spoilt=self.spoilt
        )
        checkpoint = run / self.digest(known, stage) / f"{'all' if more else 'some'}.safetensors"
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        with progress("learn, steps", stage.steps) as advance:
            return trained(network, known, stage, checkpoint, SEED, shown(advance))

    def digest(self, known: Sequence[Example], stage: Stage) -> str:
        """Return the SHA-256 of all that decides a training, shortened: a folder's name.

        That is the weights at first, the examples (their images, first labels and corrections), and the
        numbers of the stage.
        """
        digest = hashlib.sha256(f"{self.start} {stage} {SEED}".encode())
        for example in known:
            for array in (example.planes, example.target, example.meta):
                digest.update(f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:16]
