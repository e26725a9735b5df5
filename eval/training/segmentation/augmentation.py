"""Samples for training: an example rotated, scaled and degraded by faults that labelling may meet.

One generator draws all: the same seed gives the same sample. About 5 ms a sample. Constants are untuned.
"""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from annotate.array_types import Index, UInt8
from annotate.parts import PAPER
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from annotate.segmentation.input_channels import FELT, FIXED, SEEN, SUBJECT, VALID
from annotate.segmentation.suit_network import MULTIPLE, flipped, swap_classes
from eval.training.segmentation.examples import Example

FLAGS, BEFORE = FIXED.index("flags"), FIXED.index("before")
WARMTH = slice(FIXED.index("share"), FIXED.index("celsius") + 1)
COLORS = slice(FIXED.index("shade"), FIXED.index("room") + 1)
LIKE, LIKE_PARTS = slice(FIXED.index("skin"), None), slice(len(FIXED), None)
"""Places among the channels: flags, labels before, temperatures, colours, likelihoods of cloths and parts."""
ZOOM = 0.25  # largest log factor of the scale, as people and cameras differ
TURNED, TURN_RAD = 0.6, 0.14  # share of the samples that are turned, and the angle's deviation
WIDER = 0.06  # deviation of the log factor of the width
SHIFT = 6.0  # largest shift in samples
BESIDE = 0.3  # largest distance of a square's middle from its part, in sides


class Sample(NamedTuple):
    """Channels uint8 (n, h, w) and target uint8 (h, w) of pixels sampled from a frame; 255 = unknown."""

    planes: UInt8
    target: UInt8


@dataclass(frozen=True)
class Sampling:
    """Size and kind of training samples: squares of ``side`` samples (a multiple of 16), about ``sample_m``
    apart.

    by_part: centre squares equally often on each part; False = on the subject. degrade: apply faults to
    channels other than depth and place.
    """

    sample_m: float
    side: int
    by_part: bool = False
    degrade: bool = True


def draw_sample(example: Example, how: Sampling, rng: np.random.Generator, scheme: Scheme = PAPER) -> Sample:
    """Return a random square crop of an example as a training sample: planes (n, side, side), target
    (side, side).

    The crop is randomly shifted, scaled and rotated, mirrored with probability 0.5, and degraded where
    ``how`` demands it. scheme: of the example.
    """
    sample = take(example, *_places(example, how, rng, scheme))
    if how.degrade:
        degrade(sample.planes, rng, scheme)
    if rng.random() < 0.5:
        sample = flip(sample, scheme)
    return without_unknown(sample)


def sample_as_labelled(example: Example, sample_m: float) -> Sample:
    """Return a whole frame, sampled as in labelling; the sides are padded to multiples of 16."""
    step = max(1, round(sample_m / example.pixel_m))
    planes, target = example.planes[:, ::step, ::step], example.target[::step, ::step]
    more = [(0, -side % MULTIPLE) for side in target.shape]
    return without_unknown(Sample(np.pad(planes, ((0, 0), *more)), np.pad(target, more)))


def without_unknown(sample: Sample) -> Sample:
    """Return the sample with an undefined target at each pixel without depth."""
    there = (sample.planes[FLAGS] & VALID) > 0
    return Sample(sample.planes, np.where(there, sample.target, np.uint8(UNDEFINED)))


def flip(sample: Sample, scheme: Scheme = PAPER) -> Sample:
    """Return the mirror image of a sample, left and right exchanged."""
    return Sample(flipped(sample.planes, scheme), swap_classes(sample.target[:, ::-1], scheme))


def take(example: Example, rows: Index, columns: Index) -> Sample:
    """Return the pixels of an example at rows and columns (h, w); 0 outside the example."""
    height, width = example.target.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    flat = np.where(inside, rows * width + columns, 0)
    planes = example.planes.reshape(len(example.planes), -1)[:, flat] * inside
    return Sample(planes, example.target.ravel()[flat] * inside)


def _places(example: Example, how: Sampling, rng: np.random.Generator, scheme: Scheme) -> tuple[Index, Index]:
    """Return rows and columns (side, side) of the pixels to take, around the middle of the example.

    A square smaller than the example is placed near the subject or a part.
    """
    height, width = example.target.shape
    step = max(how.sample_m / example.pixel_m * np.exp(rng.uniform(-ZOOM, ZOOM)), 0.9)
    turn = rng.normal(0, TURN_RAD) if rng.random() < TURNED else 0.0
    wide = np.exp(rng.normal(0, WIDER))
    middle = np.array([height, width]) / 2
    if max(height, width) > how.side * step:
        parts = np.intersect1d(example.target, np.arange(1, len(scheme.class_ids)))
        own = np.argwhere(example.planes[FLAGS, ::8, ::8] & SUBJECT)
        if how.by_part and len(parts):
            own = np.argwhere(example.target == parts[rng.integers(len(parts))])
            middle = own[rng.integers(len(own))] + rng.uniform(-BESIDE, BESIDE, 2) * how.side * step
        elif len(own):
            middle = 0.5 * middle + 4 * own[rng.integers(len(own))]
    middle = middle + rng.uniform(-SHIFT, SHIFT, 2) * step
    along = (np.arange(how.side) - how.side / 2) * step
    y, x = np.meshgrid(along, along * wide, indexing="ij")
    c, s = np.cos(turn), np.sin(turn)
    rows, columns = middle[0] + c * y - s * x, middle[1] + s * y + c * x
    return np.floor(rows).astype(np.intp), np.floor(columns).astype(np.intp)


def degrade(planes: UInt8, rng: np.random.Generator, scheme: Scheme = PAPER) -> None:
    """Change channels (n, s, s) in place, as by faults of cameras, suits and earlier labels.

    The channels of depth and place stay.
    """
    _degrade_before(planes[BEFORE], rng, scheme)
    if rng.random() < 0.06:  # an illuminant that cannot be fitted
        planes[LIKE] = 0
    elif rng.random() < 0.04:  # no colour camera
        planes[COLORS], planes[LIKE] = 0, 0
        planes[FLAGS] &= np.uint8(255 ^ SEEN)
    else:
        _degrade_likeness(planes[LIKE], rng)
    if rng.random() < 0.07:  # a closed flag
        planes[FLAGS] &= np.uint8(255 ^ FELT)
    elif rng.random() < 0.3:  # a thermal camera calibrated amiss
        planes[WARMTH] = np.roll(planes[WARMTH], rng.integers(-2, 3, 2), (1, 2))
    if rng.random() < 0.1:  # an unreliable outline
        planes[FLAGS] &= np.uint8(255 ^ SUBJECT)


def _degrade_before(before: UInt8, rng: np.random.Generator, scheme: Scheme) -> None:
    """Degrade labels (s, s) of the previous frame in place: clear them, swap sides, or move them with
    errors.
    """
    kind = rng.random()
    if kind < 0.35:
        before[:] = BACKGROUND
    elif kind < 0.4:
        before[:] = swap_classes(before, scheme)
    elif kind < 0.8:
        before[:] = np.roll(before, rng.integers(-5, 6, 2), (0, 1))
        if rng.random() < 0.6:
            _mislabel(before, rng, scheme)


def _mislabel(before: UInt8, rng: np.random.Generator, scheme: Scheme) -> None:
    """Turn some parts into their neighbours, or into background, in a square of labels (s, s)."""
    table, touching = np.arange(256, dtype=np.uint8), _touching(scheme)
    for _ in range(rng.integers(1, 4) if touching else 0):
        part, other = touching[rng.integers(len(touching))]
        table[part] = BACKGROUND if rng.random() < 0.3 else other
    side = len(before)
    square = _square(side, int(rng.integers(side // 8, side // 2)), rng)
    before[square] = table[before[square]]


@cache
def _touching(scheme: Scheme) -> list[tuple[int, int]]:
    """Return the sorted pairs of classes of neighbours."""
    pairs = sorted(sorted(scheme.class_table[list(pair)].tolist()) for pair in scheme.neighbours)
    return [(one, other) for one, other in pairs]


def _degrade_likeness(like: UInt8, rng: np.random.Generator) -> None:
    """Change log likelihoods (n, s, s) in place as for faded, similar or hidden cloths; 0 (unmeasured)
    stays.
    """
    if rng.random() < 0.5:  # each cloth and all of them fit better or worse than measured
        off = rng.normal(0, 10, (len(like), 1, 1)) + rng.normal(0, 6)
        like[:] = np.where(like > 0, np.clip(like + off, 1, 255), 0).astype(np.uint8)
    if rng.random() < 0.25:  # two parts of one cloth
        parts = like[LIKE_PARTS.start - LIKE.start :]
        pair = rng.choice(len(parts), min(2, len(parts)), replace=False)
        parts[pair] = parts[pair].max(axis=0)
    if rng.random() < 0.2:  # a blanket or a shadow without the suit's colours
        side = like.shape[1]
        square = (slice(None), *_square(side, int(rng.integers(3, max(4, side // 8))), rng))
        like[square] = np.minimum(like[square], 1)


def _square(side: int, reach: int, rng: np.random.Generator) -> tuple[slice, slice]:
    """Return rows and columns within ``reach`` of a random place in an image of that side."""
    row, column = (int(at) for at in rng.integers(0, side, 2))
    return slice(max(row - reach, 0), row + reach), slice(max(column - reach, 0), column + reach)
