"""Logistic regressions of the labelling engine: confidence of a label, odds that a patch is the person's."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.engine import Steps
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.person.clothed_mask import PatchClues, touching_odds
from annotate.segmentation.confidence import features
from annotate.segmentation.segment import chosen_parts
from eval.training.engine_data import Observed

EVERY, PIXELS_PER_WITNESS = 5, 20.0
"""Confidence is fitted to every fifth pixel; neighbours are right or wrong together, so that twenty of these
count as one observation. Chosen by eye."""
MOST_PIXELS, PATCH_PIXELS = 600, 100.0
"""A patch counts for its pixels, at most 600, a hundred of them one observation; chosen by eye."""
BESIDE = 0.5
"""Log odds added for patches off the mask: the recall of a leg suffers more than anything gains. Chosen by
eye."""
RIDGE, STEPS = 1.0, 40
"""Ridge on the weights of standardised columns, and the most steps of Newton's method; chosen by eye."""


def logistic(columns: Float64, share: Float64, weight: Float64) -> Float64:
    """Weights (k + 1,), the last the intercept, of columns (n, k) for the log odds of shares (n,).

    weight: (n,), independent observations that each row counts for. Newton's method with a ridge.
    """
    spread = np.append(columns.std(axis=0) + 1e-9, 1)
    scaled = np.column_stack([columns, np.ones(len(columns))]) / spread
    ridge = np.diag([RIDGE] * columns.shape[1] + [1e-6])
    found = np.zeros(len(spread))
    for _ in range(STEPS):
        chance = 1 / (1 + np.exp(-np.clip(scaled @ found, -30, 30)))
        curve = (scaled * (weight * chance * (1 - chance))[:, None]).T @ scaled
        step = np.linalg.solve(curve + ridge, scaled.T @ (weight * (share - chance)) - ridge @ found)
        found += step
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(found / spread)


def judged(frame: Observed) -> tuple[Float32, Bool]:
    """Features (n, k) of every fifth label of a frame, and which are right (n,).

    Only where labels and truth name a class.
    """
    reading, labels = frame.found.reading, frame.found.parts
    assert reading is not None
    found = features(frame.cloud, chosen_parts(frame.cloud, reading, Steps()), reading)
    counted = ((frame.truth != UNDEFINED) & (labels != UNDEFINED))[reading.mask]
    right = (frame.truth == labels)[reading.mask]
    return found[counted][::EVERY].astype(np.float32), right[counted][::EVERY]


def fit_confidence(frames: Sequence[tuple[Float32, Bool]]) -> Float64:
    """Weights (20,) of confidence's features and, last, the intercept. frames: of `judged`."""
    found, right = (np.concatenate(column).astype(np.float64) for column in zip(*frames, strict=True))
    return logistic(found, right, np.full(len(right), 1 / PIXELS_PER_WITNESS))


class KnownPatches(NamedTuple):
    """Clues of a frame's R patches; pixels (R,) of each whose class is known, and the person's share (R,)."""

    clues: PatchClues
    pixels: Float64
    share: Float64


def known_patches(clues: PatchClues, truth: UInt8) -> KnownPatches:
    """What is true of a frame's patches; truth: parts (h, w)."""
    parts, count = truth[clues.compared], len(clues.in_mask)
    known = parts != UNDEFINED
    pixels = np.bincount(clues.patch, known, count)
    person = np.bincount(clues.patch, known & (parts != BACKGROUND), count)
    return KnownPatches(clues, pixels.astype(np.float64), person / np.maximum(pixels, 1))


def fit_clothed(frames: Sequence[KnownPatches]) -> tuple[Float64, Float64]:
    """Weights (2, 7) of the clues for patches in the mask and off it, and (2,) of a patch's own log odds and
    those of what touches it."""
    rows = ((f.clues.columns, f.clues.in_mask, f.share, f.pixels) for f in frames)
    columns, in_mask, share, pixels = (np.concatenate(column) for column in zip(*rows, strict=True))
    weight = np.minimum(pixels, MOST_PIXELS) / PATCH_PIXELS
    clothed = np.stack([logistic(columns[m, :-1], share[m], weight[m]) for m in (in_mask, ~in_mask)])
    own, around = [], []
    for frame in frames:
        odds = (frame.clues.columns * clothed[np.where(frame.clues.in_mask, 0, 1)]).sum(axis=1)
        own.append(odds)
        around.append(touching_odds(frame.clues.patches, odds))
    touch = logistic(np.column_stack([np.concatenate(own), np.concatenate(around)]), share, weight)
    clothed[1, -1] += BESIDE
    return clothed, touch[:2]
