"""Gain of a fine-tuning on frames that it has not seen: each kind of corrected frames is left out in turn."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from annotate.array_types import Float64, Int64
from annotate.effort.agreement import Agreement
from annotate.effort.annotator import TOLERANCE_PX
from eval.fine_tuning.run import FineTuner
from eval.fine_tuning.training_split import CorrectedFrame, folds
from eval.scores.intervals import quantile
from eval.training.progress import Progress

SHARES = (1.0, 0.5)  # of the way from the first to the trained network, among which held-out frames choose
LEVEL = 0.9  # of the interval of the change
SURE = 0.9  # least probability of a gain: one in ten networks without a gain passes


@dataclass(frozen=True)
class Gain:
    """Agreement within 2 px with held-out frames, and its change by fine-tuning.

    before, after: means over the frames. low, high: 90 % interval of the mean change, sure: probability of a
    gain (Student's t over frames). share: of the way from the first to the trained network.
    """

    before: float
    after: float
    low: float
    high: float
    sure: float
    share: float

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> Self:
        """Return the gain of JSON values.

        Raises KeyError, TypeError, ValueError and OverflowError for values of something else.
        """
        found = cls(*(float(fields[name]) for name in cls.__dataclass_fields__))
        if not all(map(math.isfinite, asdict(found).values())):
            raise ValueError("a gain is not finite")
        return found

    @property
    def is_certain(self) -> bool:
        """Return True if a gain is probable enough to change labels."""
        return self.sure >= SURE

    @property
    def text(self) -> str:
        """Return the gain as text: agreement before and after, interval, probability."""
        change = f"{100 * self.low:.1f} to {100 * self.high:.1f} points"
        sure = f"{int(100 * self.sure)}% sure of a gain"
        return f"{self.before:.1%} right before, {self.after:.1%} after ({change}; {sure})"


def cross_validate(
    tuner: FineTuner,
    frames: Sequence[CorrectedFrame],
    rehearsed: Sequence[CorrectedFrame],
    run: Path,
    progress: Progress,
) -> Gain:
    """Return the gain on each frame by a network that was trained without frames of its kind.

    run: folder of checkpoints and trial networks.
    """
    fold_of = folds(frames)
    before, after = np.zeros(len(frames)), np.zeros((len(SHARES), len(frames)))
    for fold in range(fold_of.max() + 1):
        network = tuner.train(
            [f for f, n in zip(frames, fold_of, strict=True) if n != fold], rehearsed, run, progress
        )
        weights = [run / f"trial-{n}.onnx" for n in range(len(SHARES))]
        for share, path in zip(SHARES, weights, strict=True):
            tuner.save(network, share, path)
        held = np.flatnonzero(fold_of == fold).tolist()
        for n, predicted in zip(held, tuner.parts([frames[n] for n in held], weights), strict=True):
            frame = frames[n]
            truth = Agreement(frame.corrected.parts, frame.first.depth_mm > 0, TOLERANCE_PX)
            before[n], after[:, n] = truth.of(frame.first.parts), [truth.of(parts) for parts in predicted]
    return gain_of(before, after, fold_of)


def gain_of(before: Float64, after: Float64, fold_of: Int64) -> Gain:
    """Return the gain for agreements before (n,) and after (s, n), one row a share.

    The share of a frame is chosen by ``chosen_by_others``. The share of the final network is chosen by all.
    """
    change = after - before
    honest = change[chosen_by_others(change, fold_of), np.arange(len(before))]
    return gain(before, honest, SHARES[int(change.mean(axis=1).argmax())])


def chosen_by_others(change: Float64, fold_of: Int64) -> Int64:
    """Return the index (n,) of the share with the best mean of changes (s, n) in other folds than a frame's.

    A choice by the frame itself would flatter the share.
    """
    return np.array([change[:, fold_of != fold].mean(axis=1).argmax() for fold in fold_of], np.int64)


def gain(before: Float64, change: Float64, share: float) -> Gain:
    """Return the gain for agreements before (n,) and their changes (n,), n of 2 or more."""
    from scipy.special import stdtr

    mean = float(change.mean())
    error = float(change.std(ddof=1)) / np.sqrt(len(change))
    half = error * float(quantile(len(change) - 1, LEVEL))
    sure = float(stdtr(len(change) - 1, mean / error)) if error else float(mean > 0)
    return Gain(float(before.mean()), float(before.mean()) + mean, mean - half, mean + half, sure, share)
