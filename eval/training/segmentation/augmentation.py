"""Samples for training: an example turned and scaled, and spoilt as labelling may meet it.

All is drawn from one generator: the same seed gives the same sample. About 5 ms a sample.
"""

from typing import NamedTuple

import numpy as np

from annotate.array_types import Index, UInt8
from annotate.parts import BACKGROUND, BODY_PARTS, NEIGHBOURS, UNDEFINED, swap_left_right
from annotate.segmentation.input_channels import CHANNELS, FELT, LIKELIHOODS, SEEN, SUBJECT, VALID
from annotate.segmentation.suit_network import MULTIPLE
from annotate.segmentation.suit_network import flipped as flipped_channels
from eval.training.segmentation.examples import Example

FLAGS, BEFORE = CHANNELS.index("flags"), CHANNELS.index("before")
WARMTH = slice(CHANNELS.index("share"), CHANNELS.index("celsius") + 1)
COLORS = slice(CHANNELS.index("shade"), CHANNELS.index("room") + 1)
LIKE, LIKE_PARTS = slice(-len(LIKELIHOODS), None), slice(-len(BODY_PARTS), None)
"""Places among the channels: flags, labels before, temperatures, colours, the likeness to every cloth and to
those of the parts."""
JOINED = [tuple(sorted(pair)) for pair in sorted(map(sorted, NEIGHBOURS))]
"""Parts that touch, which a reader takes for each other."""
ZOOM, TURNED, TURN_RAD, WIDER, SHIFT = 0.25, 0.6, 0.14, 0.06, 6.0
"""Largest log factor of the scale, as people and cameras differ; share of the samples that are turned and the
angle's deviation, as cameras hang askew; deviation of a log factor of the width, as people are thinner or
stouter; largest shift in samples, so that nothing depends on the grid. Chosen by eye."""
BESIDE = 0.3
"""Largest distance of a square's middle from the part it is about, in sides. Chosen by eye."""


class Sample(NamedTuple):
    """Channels uint8 (24, h, w) and target uint8 (h, w) of samples of a frame; 255 = not known."""

    planes: UInt8
    target: UInt8


def drawn(
    example: Example,
    sample_m: float,
    side: int,
    rng: np.random.Generator,
    *,
    by_part: bool = False,
    spoilt: bool = True,
) -> Sample:
    """A square of ``side`` samples about ``sample_m`` apart, turned, scaled, spoilt, in half of the draws
    mirrored. Where nothing is measured, nothing is known.

    by_part: whether each part that there is lies about its middle as often; else the subject does. spoilt:
    whether anything but depth and place may change.
    """
    rows, columns = _places(example, sample_m, side, by_part, rng)
    sample = taken(example, rows, columns)
    if spoilt:
        spoil(sample.planes, rng)
    if rng.random() < 0.5:
        sample = mirrored(sample)
    return known(sample)


def as_labelling(example: Example, sample_m: float) -> Sample:
    """The samples that labelling takes of a frame, the sides filled up to multiples of 16."""
    step = max(1, round(sample_m / example.pixel_m))
    planes, target = example.planes[:, ::step, ::step], example.target[::step, ::step]
    more = [(0, -side % MULTIPLE) for side in target.shape]
    return known(Sample(np.pad(planes, ((0, 0), *more)), np.pad(target, more)))


def known(sample: Sample) -> Sample:
    """The sample with its target undefined wherever there is no depth."""
    there = (sample.planes[FLAGS] & VALID) > 0
    return Sample(sample.planes, np.where(there, sample.target, np.uint8(UNDEFINED)))


def mirrored(sample: Sample) -> Sample:
    """The sample as a mirror shows it."""
    return Sample(flipped_channels(sample.planes), swap_left_right(sample.target[:, ::-1]))


def taken(example: Example, rows: Index, columns: Index) -> Sample:
    """Pixels of an example at rows and columns (h, w); 0 outside."""
    height, width = example.target.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    flat = np.where(inside, rows * width + columns, 0)
    planes = example.planes.reshape(len(CHANNELS), -1)[:, flat] * inside
    return Sample(planes, example.target.ravel()[flat] * inside)


def _places(
    example: Example, sample_m: float, side: int, by_part: bool, rng: np.random.Generator
) -> tuple[Index, Index]:
    """Rows and columns (side, side) of the pixels to take: about the middle, or towards some place on the
    subject or near one of a part, where the square is smaller than what is around them."""
    height, width = example.target.shape
    step = max(sample_m / example.pixel_m * np.exp(rng.uniform(-ZOOM, ZOOM)), 0.9)
    turn = rng.normal(0, TURN_RAD) if rng.random() < TURNED else 0.0
    wide = np.exp(rng.normal(0, WIDER))
    middle = np.array([height, width]) / 2
    if max(height, width) > side * step:
        parts = np.intersect1d(example.target, [part.id for part in BODY_PARTS])
        own = np.argwhere(example.planes[FLAGS, ::8, ::8] & SUBJECT)
        if by_part and len(parts):
            own = np.argwhere(example.target == parts[rng.integers(len(parts))])
            middle = own[rng.integers(len(own))] + rng.uniform(-BESIDE, BESIDE, 2) * side * step
        elif len(own):
            middle = 0.5 * middle + 4 * own[rng.integers(len(own))]
    middle = middle + rng.uniform(-SHIFT, SHIFT, 2) * step
    along = (np.arange(side) - side / 2) * step
    y, x = np.meshgrid(along, along * wide, indexing="ij")
    c, s = np.cos(turn), np.sin(turn)
    rows, columns = middle[0] + c * y - s * x, middle[1] + s * y + c * x
    return np.floor(rows).astype(np.intp), np.floor(columns).astype(np.intp)


def spoil(planes: UInt8, rng: np.random.Generator) -> None:
    """Change channels (24, s, s) in place as cameras, suits and earlier frames may; depth and place stay.

    All shares are chosen by eye.
    """
    _spoil_before(planes[BEFORE], rng)
    if rng.random() < 0.06:  # an unreadable light
        planes[LIKE] = 0
    elif rng.random() < 0.04:  # no colour camera
        planes[COLORS], planes[LIKE] = 0, 0
        planes[FLAGS] &= np.uint8(255 ^ SEEN)
    else:
        _spoil_likeness(planes[LIKE], rng)
    if rng.random() < 0.07:  # a closed flag
        planes[FLAGS] &= np.uint8(255 ^ FELT)
    elif rng.random() < 0.3:  # a thermal camera calibrated amiss
        planes[WARMTH] = np.roll(planes[WARMTH], rng.integers(-2, 3, 2), (1, 2))
    if rng.random() < 0.1:  # an outline that is not to be relied on
        planes[FLAGS] &= np.uint8(255 ^ SUBJECT)


def _spoil_before(before: UInt8, rng: np.random.Generator) -> None:
    """Labels (s, s) of the frame before: none, with the sides exchanged, or moved and partly wrong."""
    kind = rng.random()
    if kind < 0.35:
        before[:] = BACKGROUND
    elif kind < 0.4:
        before[:] = swap_left_right(before)
    elif kind < 0.8:
        before[:] = np.roll(before, rng.integers(-5, 6, 2), (0, 1))
        if rng.random() < 0.6:
            _misname(before, rng)


def _misname(before: UInt8, rng: np.random.Generator) -> None:
    """Name some parts as their neighbours, or not at all, in a square of labels (s, s)."""
    table = np.arange(256, dtype=np.uint8)
    for _ in range(rng.integers(1, 4)):
        part, other = JOINED[rng.integers(len(JOINED))]
        table[part] = BACKGROUND if rng.random() < 0.3 else other
    side = len(before)
    square = _square(side, int(rng.integers(side // 8, side // 2)), rng)
    before[square] = table[before[square]]


def _spoil_likeness(like: UInt8, rng: np.random.Generator) -> None:
    """Log likelihoods (13, s, s): cloths faded or unlike the palette, alike, or hidden; 0 stays unread."""
    if rng.random() < 0.5:  # each cloth and all of them fit better or worse than measured
        off = rng.normal(0, 10, (len(like), 1, 1)) + rng.normal(0, 6)
        like[:] = np.where(like > 0, np.clip(like + off, 1, 255), 0).astype(np.uint8)
    if rng.random() < 0.25:  # two parts of one cloth
        parts = like[LIKE_PARTS]
        pair = rng.choice(len(parts), 2, replace=False)
        parts[pair] = parts[pair].max(axis=0)
    if rng.random() < 0.2:  # a blanket or a shadow, where nothing is the suit's colour
        side = like.shape[1]
        square = (slice(None), *_square(side, int(rng.integers(3, max(4, side // 8))), rng))
        like[square] = np.minimum(like[square], 1)


def _square(side: int, reach: int, rng: np.random.Generator) -> tuple[slice, slice]:
    """Rows and columns within ``reach`` of a place drawn in an image of that side."""
    row, column = (int(at) for at in rng.integers(0, side, 2))
    return slice(max(row - reach, 0), row + reach), slice(max(column - reach, 0), column + reach)
