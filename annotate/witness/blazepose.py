"""MediaPipe Pose, BlazePose GHUM full (Bazarevsky et al., arXiv:2006.10204): detector and landmark network.

Constants are MediaPipe's graphs unless stated. Of people who hide each other by half, one is found.
"""

from pathlib import Path

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from annotate.witness.lite_model import LiteModel
from annotate.witness.model_files import DETECTOR, LANDMARKS, SHA256, model_bytes, models_folder
from annotate.witness.person_crop import PersonCrop, upright
from annotate.witness.pose_network import LEAST, PosedPerson, intersection

_FACE = ("eye_inner", "eye", "eye_outer")
_SIDED = (
    *("ear", "mouth", "shoulder", "elbow", "wrist", "pinky", "index", "thumb"),
    *("hip", "knee", "ankle", "heel", "foot_index"),
)
NAMES = (
    "nose",
    *(f"{side}_{part}" for side in ("left", "right") for part in _FACE),
    *(f"{side}_{part}" for part in _SIDED for side in ("left", "right")),
)
"""Landmarks in MediaPipe's order."""
CENTRE, RIM = 33, 34  # the landmark network's own rows for the next crop
DETECTOR_PX, CROP_PX = 224, 256
STRIDES = ((8, 2), (16, 2), (32, 6))  # pixels between the detector's cells, boxes a cell
OVERLAP = 0.3  # least intersection over union of boxes of one person
WINDOW = 3  # cells about a landmark whose heat refines it


class BlazePose:
    """Network ``PoseNetwork`` of 33 landmarks with visibility and a person's mask.

    models: wheel or folder with both models; None = the user's cache. Raises FormatError for missing or other
    models, CloudError without the extra ``colour``.
    """

    names = NAMES
    sha256 = SHA256[LANDMARKS]

    def __init__(self, models: Path | None = None) -> None:
        source = models or models_folder()
        self._detector, self._landmarks = (
            LiteModel(model_bytes(name, source)) for name in (DETECTOR, LANDMARKS)
        )

    def detect(self, image: UInt8) -> list[PersonCrop]:
        """Return a crop for each detected person in an image (h, w, 3), the surest first."""
        height, width = image.shape[:2]
        side = max(height, width)
        pad = (side - width) / 2, (side - height) / 2
        # Shrunk by area before the cut, because the detector misses people in aliased images.
        small = cv2.resize(image, None, fx=(k := DETECTOR_PX / side), fy=k, interpolation=cv2.INTER_AREA)
        out = self._detector(2 * _padded(np.asarray(small, np.uint8)) - 1)
        score, raw = _sigmoid(out["Identity_1"][:, 0]), out["Identity"] / DETECTOR_PX
        sure = score >= LEAST
        score, raw, centre = score[sure], raw[sure], _anchors()[sure]
        middle, half = centre + raw[:, :2], raw[:, 2:4] / 2
        rows = np.hstack([middle - half, middle + half, *(centre + raw[:, k : k + 2] for k in (4, 6))])
        found, left = [], np.argsort(-score, kind="stable")
        while len(left):
            both, own, others = intersection(rows[left[0], :4], rows[left, :4])
            same = both > OVERLAP * (own + others - both)
            same[0] = True
            merged = np.average(rows[left[same]], axis=0, weights=score[left[same]]) * side
            found.append(upright(merged[4:6] - pad, merged[6:8] - pad))
            left = left[~same]
        return found

    def landmark(self, image: UInt8, crop: PersonCrop, least: float = LEAST) -> PosedPerson | None:
        """Return the person in a crop, with a mask; None for a score below ``least``."""
        out = self._landmarks(crop.cut(image, CROP_PX, CROP_PX))
        if out["Identity_1"][0] < least:
            return None
        rows = out["Identity"].reshape(-1, 5)
        at = _refined(rows[:, :2] / CROP_PX, _sigmoid(out["Identity_3"]))
        at = crop.points(CROP_PX * at, CROP_PX, CROP_PX)
        visibility = _sigmoid(rows[:, 3])[: len(NAMES)]
        landmarks = np.column_stack([at[: len(NAMES)], visibility]).astype(np.float64)
        mask = crop.pasted(_sigmoid(out["Identity_2"][..., 0]), (image.shape[0], image.shape[1]))
        return PosedPerson(landmarks, upright(at[CENTRE], at[RIM]), mask)


def _anchors() -> Float64:
    """Return the centres of the detector's boxes (2254, 2), as shares of the image."""
    rows = []
    for stride, boxes in STRIDES:
        n = DETECTOR_PX // stride
        y, x = np.mgrid[:n, :n]
        cells = np.column_stack([x.ravel(), y.ravel()])
        rows.append(np.repeat((cells + 0.5) / n, boxes, axis=0))
    return np.concatenate(rows)


def _sigmoid(x: Float32) -> Float32:
    return np.asarray(1 / (1 + np.exp(-np.clip(x, -80, 80))), np.float32)


def _padded(image: UInt8) -> Float32:
    """Return an image in the middle of a black square (224, 224, 3), values 0 to 1."""
    height, width = image.shape[:2]
    square = np.zeros((DETECTOR_PX, DETECTOR_PX, 3), np.float32)
    top, left = (DETECTOR_PX - height) // 2, (DETECTOR_PX - width) // 2
    square[top : top + height, left : left + width] = image / np.float32(255)
    return square


def _refined(at: Float64, heat: Float32) -> Float64:
    """Return landmarks (n, 2), shares of the crop, moved to the centroid of the heat (h, w, n) about them."""
    n, moved = heat.shape[0], at.astype(np.float64)
    for k, (x, y) in enumerate((at * n).astype(int)):
        if not (0 <= x < n and 0 <= y < n):
            continue
        left, top = max(0, x - WINDOW), max(0, y - WINDOW)
        window = heat[top : y + WINDOW + 1, left : x + WINDOW + 1, k]
        if window.max() >= LEAST:
            rows, columns = np.mgrid[top : top + window.shape[0], left : left + window.shape[1]]
            moved[k] = np.array([(columns * window).sum(), (rows * window).sum()]) / window.sum() / n
    return moved
