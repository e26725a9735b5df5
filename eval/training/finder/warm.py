"""Warmth of training images: random for rooms without measured warmth, and degraded as by cameras.

Warmth is 0 at the room's temperature, 1 at a person's, NaN = unmeasured. Constants are untuned.
"""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, UInt8, UInt16

HIDDEN_STEP = 1.15  # depth behind a silhouette over that in front, from which a thermal camera misses pixels
UNFELT = 0.22  # share of images without temperatures: a closed flag, or no thermal camera


def random_warmth(depth_mm: UInt16, persons: UInt8, rng: np.random.Generator) -> Float32:
    """Return random warmth (h, w): unevenly warm people and warm places, blurred, NaN beside silhouettes."""
    shape = depth_mm.shape
    room = 0.12 * _uneven(shape, 24, rng) + np.float32(rng.normal(0, 0.05))
    for _ in range(rng.integers(0, 4)):
        row, column = (int(rng.integers(side)) for side in shape)
        height, width = rng.integers(4, 40, 2)
        room[row : row + height, column : column + width] += np.float32(rng.uniform(0.2, 1.6))
    person = 1 + rng.normal(0, 0.12) - rng.uniform(0, 0.3) + 0.3 * _uneven(shape, 10, rng)
    sharp = np.where(persons > 0, np.maximum(person, 0.1), room).astype(np.float32)
    felt = cv2.GaussianBlur(sharp, (0, 0), rng.uniform(0.4, 2.2))
    noise = rng.normal(0, rng.uniform(0.01, 0.06), shape)
    return np.where(_hidden(depth_mm, rng), np.nan, felt + noise).astype(np.float32)


def _hidden(depth_mm: UInt16, rng: np.random.Generator) -> Bool:
    """Return a mask (h, w) of strips beside silhouettes, on one side, up to five pixels wide."""
    hidden, width = np.zeros(depth_mm.shape, np.bool_), int(rng.integers(6))
    if width:
        left, right = depth_mm[:, :-width].astype(np.float32), depth_mm[:, width:]
        if rng.random() < 0.5:
            hidden[:, width:] = (right > left * HIDDEN_STEP) & (left > 0)
        else:
            hidden[:, :-width] = (left > right * HIDDEN_STEP) & (right > 0)
    return hidden


def degraded_warmth(warmth: Float32, rng: np.random.Generator) -> Float32:
    """Return warmth (h, w) scaled, uneven, moved, blurred or in part NaN; in some images all NaN."""
    felt = warmth.copy()
    if rng.random() < UNFELT:
        return np.full_like(felt, np.nan)
    if rng.random() < 0.5:
        felt = felt * np.float32(np.exp(rng.normal(0, 0.12))) + np.float32(rng.normal(0, 0.08))
    if rng.random() < 0.3:
        felt += np.float32(0.1) * _uneven(felt.shape, 20, rng)
    if rng.random() < 0.3:
        felt = np.roll(felt, rng.integers(-2, 3, 2), (0, 1))
    if rng.random() < 0.1:
        row, column = (int(rng.integers(side)) for side in felt.shape)
        felt[row : row + 60, column : column + 60] = np.nan
    if rng.random() < 0.15:
        soft = cv2.GaussianBlur(np.nan_to_num(felt), (0, 0), rng.uniform(0.5, 1.5))
        felt = np.where(np.isfinite(felt), soft, np.float32(np.nan))
    return felt


def _uneven(shape: tuple[int, ...], size_px: int, rng: np.random.Generator) -> Float32:
    """Return smooth noise (h, w) of standard deviation 1 with bumps of about ``size_px`` pixels."""
    height, width = shape
    coarse = rng.normal(0, 1, (max(2, height // size_px), max(2, width // size_px))).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
