"""Hand of the simulated annotator: the lines it draws around and over a patch, and their errors."""

from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float64

AROUND = np.ones((3, 3), np.uint8)
BRUSHES_PX = (3.0, 6.0, 10.0)
"""Radii of the brush in image pixels, without zoom: those of ``gui.commands`` at the window's usual scale."""
NOTCH = 1.2
"""Factor by which one notch of the wheel enlarges the image, as in the window."""


@dataclass(frozen=True)
class Hand:
    """A way of drawing. sd_px: standard deviation of its error in image pixels; slack_px: distance outside
    the patch at which it aims where that does no harm; notches: of the wheel, to zoom in first."""

    sd_px: float
    slack_px: int
    notches: int = 0

    @property
    def zoom(self) -> float:
        """Factor by which the image is enlarged for it."""
        return NOTCH**self.notches


CAREFUL = Hand(sd_px=1.0, slack_px=2)
"""Along a border that must be kept. Chosen by eye."""
QUICK = Hand(sd_px=2.5, slack_px=5)
"""Round a patch, two standard deviations outside it, where the tool keeps the surroundings. Chosen by eye."""
FINE = Hand(sd_px=0.5, slack_px=1, notches=4)
"""Round details as thin as a finger: the careful hand with an image twice as large."""


def outline(patch: Bool, free: Bool, hand: Hand) -> Float64:
    """Corners (k, 2) as (u, v) of a lasso round a patch (h, w), simplified to the hand's error.

    free: bool (h, w), pixels that the lasso may include. Pieces of the patch closer than five pixels are
    joined, otherwise the largest counts. Source: Douglas & Peucker 1973.
    """
    mask = cv2.morphologyEx(patch.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    wide = cv2.dilate(mask, AROUND, iterations=hand.slack_px)
    contours, _ = cv2.findContours(
        mask | wide & free.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    largest = max(contours, key=cv2.contourArea)
    return np.asarray(cv2.approxPolyDP(largest, hand.sd_px, True).reshape(-1, 2), np.float64)


def loop(patch: Bool, hand: Hand) -> Float64:
    """Corners (k, 2) as (u, v) of a loop right round a patch (h, w): its convex hull, with slack."""
    wide = cv2.dilate(patch.astype(np.uint8), AROUND, iterations=hand.slack_px)
    v, u = np.nonzero(wide)
    hull = cv2.convexHull(np.stack([u, v], axis=1).astype(np.int32))
    return np.asarray(cv2.approxPolyDP(hull, hand.sd_px, True).reshape(-1, 2), np.float64)


def along(patch: Bool, radius_px: float) -> Float64:
    """Path (k, 2) as (u, v) of a brush over a patch (h, w), along its main axis."""
    v, u = np.nonzero(patch)
    points = np.stack([u, v], axis=1).astype(np.float64)
    middle = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - middle).T) if len(points) > 1 else np.eye(2))
    station = np.rint((points - middle) @ axes[:, -1] / max(2.0, radius_px)).astype(np.intp)
    station -= station.min()
    count = np.bincount(station)
    path = np.stack([np.bincount(station, axis) for axis in points.T], axis=1)[count > 0]
    return np.asarray(path / count[count > 0, None])


def drawn(corners: Float64, hand: Hand, rng: np.random.Generator) -> Float64:
    """The corners (k, 2) with the error of the hand."""
    return corners + rng.normal(0, hand.sd_px, corners.shape)


def length_px(corners: Float64, closed: bool) -> float:
    """Length of the line through the corners (k, 2)."""
    return float(cv2.arcLength(corners.astype(np.float32)[:, None], closed)) if len(corners) > 1 else 0.0
