"""What a colour says of whom a pixel belongs to, learnt within a frame from those that are sure. Log odds."""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int32, UInt8

MOST_BY_COLOR = 2.5
"""The most that a colour can be worth: a sofa may have a suit's colour somewhere."""
LEAST_SHARE = 2e-4
"""Share of pixels that every colour is taken to have: one in five thousand, unseen or not."""
LEAST_TAUGHT = 200
"""Pixels of either from which colours can be learnt."""
SURE_ODDS = 1.5
"""Log odds from which on a pixel teaches what person and background look like."""
LAB_BITS = (5, 3, 3)
"""Bits of each Lab channel that a colour's bin leaves out: 8 x 32 x 32 bins."""


def color_odds(lab: UInt8, odds: Float32, candidates: Bool, among: Bool) -> Float32:
    """Log odds (h, w) of colour, learnt from the pixels that ``odds`` (h, w) are sure of.

    lab: uint8 (h, w, 3) as ``lab_of`` gives it. candidates: what is off them is background for sure.
    among: bool (h, w), where to learn. 0 without colour.
    """
    seen = lab[..., 0] > 0
    bins = color_bins(lab)
    person = bins[among & seen & candidates & (odds > SURE_ODDS)]
    room = bins[among & seen & (~candidates | (odds < -SURE_ODDS))]
    if min(person.size, room.size) < LEAST_TAUGHT:
        return np.zeros(odds.shape, np.float32)
    table = np.clip(np.log(frequencies(person) / frequencies(room)), -MOST_BY_COLOR, MOST_BY_COLOR)
    return np.where(seen, table[bins], np.float32(0)).astype(np.float32)


def lab_of(color_rgb: UInt8, color_valid: Bool) -> UInt8:
    """CIE Lab, 8 bit (h, w, 3); the first channel is at least 1 where there is a colour, 0 where not."""
    lab = cv2.cvtColor(color_rgb, cv2.COLOR_RGB2Lab).astype(np.uint8)
    lab[..., 0] = np.maximum(lab[..., 0], 1)
    lab[~color_valid] = 0
    return lab


def color_bins(lab: UInt8) -> Int32:
    """Which of 8192 bins each colour (..., 3) of ``lab_of`` is in."""
    l_bits, a_bits, b_bits = LAB_BITS
    bins = (lab[..., 0].astype(np.int32) >> l_bits) * 1024 + (lab[..., 1].astype(np.int32) >> a_bits) * 32
    return np.asarray(bins + (lab[..., 2] >> b_bits), np.int32)


def frequencies(bins: Int32) -> Float32:
    """Share (8192,) of each bin, smoothed over neighbouring hues, all a little more than zero."""
    count = np.bincount(bins, minlength=8 * 32 * 32).astype(np.float32).reshape(8, 32, 32)
    smooth = np.stack([cv2.GaussianBlur(plane, (0, 0), 0.8) for plane in count])
    return np.asarray(smooth.ravel() / max(float(smooth.sum()), 1.0) + LEAST_SHARE, np.float32)
