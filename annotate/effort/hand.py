"""Drawing hand of the simulated annotator: lines around and over a patch, and random errors.

Constants are untuned unless a source is given.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float64

AROUND = np.ones((3, 3), np.uint8)
BRUSHES_PX = (3.0, 6.0, 10.0)  # radii in image pixels, as ``gui.commands`` at the usual scale


@dataclass(frozen=True)
class Hand:
    """Accuracy and zoom of a drawing hand.

    sd_px: standard deviation of the error in image pixels. slack_px: distance outside the patch at which the
    hand aims. notches: notches of the mouse wheel by which the view is zoomed in first.
    """

    sd_px: float
    slack_px: int
    notches: int = 0

    @property
    def zoom(self) -> float:
        """Return the enlargement of the image: a factor of 1.2 for each notch, as in the window."""
        return 1.2**self.notches


CAREFUL = Hand(sd_px=1.0, slack_px=2)  # along a border that must be kept
QUICK = Hand(sd_px=2.5, slack_px=5)  # round a patch, where the tool keeps the surroundings
FINE = Hand(sd_px=0.5, slack_px=1, notches=4)  # round a finger: the careful hand, enlarged twice


def outline(patch: Bool, free: Bool, hand: Hand) -> Float64:
    """Return the corners (k, 2) as (u, v) of a lasso around a patch (h, w), simplified to the hand's error.

    free: bool (h, w), pixels that the lasso may include. Pieces closer than five pixels are joined, and the
    largest one is outlined. Source: Douglas & Peucker 1973.
    """
    mask = cv2.morphologyEx(patch.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    wide = cv2.dilate(mask, AROUND, iterations=hand.slack_px)
    contours, _ = cv2.findContours(
        mask | wide & free.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    largest = max(contours, key=cv2.contourArea)
    return np.asarray(cv2.approxPolyDP(largest, hand.sd_px, True).reshape(-1, 2), np.float64)


def loop(patch: Bool, hand: Hand) -> Float64:
    """Return the corners (k, 2) as (u, v) of a lasso: a patch's convex hull, enlarged by ``slack_px``."""
    wide = cv2.dilate(patch.astype(np.uint8), AROUND, iterations=hand.slack_px)
    v, u = np.nonzero(wide)
    hull = cv2.convexHull(np.stack([u, v], axis=1).astype(np.int32))
    return np.asarray(cv2.approxPolyDP(hull, hand.sd_px, True).reshape(-1, 2), np.float64)


def along(patch: Bool, radius_px: float) -> Float64:
    """Return the path (k, 2) as (u, v) of a brush over a patch (h, w), along its main axis."""
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
    """Return corners (k, 2) with random errors of the hand."""
    return corners + rng.normal(0, hand.sd_px, corners.shape)


def length_px(corners: Float64, closed: bool) -> float:
    """Return the length of the line through corners (k, 2). closed: add the line from last to first."""
    return float(cv2.arcLength(corners.astype(np.float32)[:, None], closed)) if len(corners) > 1 else 0.0
