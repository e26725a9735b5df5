"""Log odds of a person by colour, estimated within a frame from its certain pixels. Constants are untuned."""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int32, UInt8

MOST_BY_COLOR = 2.5  # bound of the log odds of a colour, because a sofa may have a suit's colour
LEAST_FREQUENCY = 2e-4  # share of pixels added to every colour's
LEAST_LEARNT = 200  # pixels of person and of background below which no colours are learnt
SURE_ODDS = 1.5  # log odds from which a pixel counts as one of these
LAB_BITS = (5, 3, 3)  # of each Lab channel left out of a bin: 8 x 32 x 32 bins


def color_odds(lab: UInt8, odds: Float32, candidates: Bool, among: Bool) -> Float32:
    """Return log odds (h, w) of a person by colour; 0 without a colour.

    lab: uint8 (h, w, 3), as ``lab_of`` returns it. odds: (h, w), log odds of each pixel from other data;
    pixels far from 0 are certain. candidates: bool (h, w), other pixels are background. among: bool (h, w),
    pixels to estimate from.
    """
    seen = lab[..., 0] > 0
    bins = color_bins(lab)
    person = bins[among & seen & candidates & (odds > SURE_ODDS)]
    room = bins[among & seen & (~candidates | (odds < -SURE_ODDS))]
    if min(person.size, room.size) < LEAST_LEARNT:
        return np.zeros(odds.shape, np.float32)
    table = np.clip(np.log(frequencies(person) / frequencies(room)), -MOST_BY_COLOR, MOST_BY_COLOR)
    return np.where(seen, table[bins], np.float32(0)).astype(np.float32)


def lab_of(color_rgb: UInt8, color_valid: Bool) -> UInt8:
    """Return CIE Lab uint8 (h, w, 3) of sRGB colours; its first channel is 0 only without a colour."""
    lab = np.asarray(cv2.cvtColor(color_rgb, cv2.COLOR_RGB2Lab), np.uint8)
    lab[..., 0] = np.maximum(lab[..., 0], 1)
    lab[~color_valid] = 0
    return lab


def color_bins(lab: UInt8) -> Int32:
    """Return the bin (...), 0 to 8191, of each Lab colour uint8 (..., 3), as ``lab_of`` returns it."""
    lightness, a, b = (lab[..., i].astype(np.int32) >> bits for i, bits in enumerate(LAB_BITS))
    return np.asarray((lightness * 32 + a) * 32 + b, np.int32)


def frequencies(bins: Int32) -> Float32:
    """Return the share (8192,) of each bin among ``bins`` (n,), smoothed over hues, all above 0."""
    count = np.bincount(bins, minlength=8 * 32 * 32).astype(np.float32).reshape(8, 32, 32)
    smooth = np.stack([cv2.GaussianBlur(plane, (0, 0), 0.8) for plane in count])
    return np.asarray(smooth.ravel() / max(float(smooth.sum()), 1.0) + LEAST_FREQUENCY, np.float32)
