"""Pixels of a witnessed person in the depth image."""

from typing import NamedTuple

import cv2
import numpy as np

from annotate.array_types import Bool, Float32
from annotate.witness.coloured_cloud import ColouredCloud
from annotate.witness.limbs import ALONG, distances
from annotate.witness.outline import BORDER, outline
from annotate.witness.outline import LEAST_PX as LEAST_BORDER_PX
from annotate.witness.pose_network import PosedPerson
from annotate.witness.skeleton import JOINT, Skeleton, skeleton_of

LEAST_PX = 100  # of a person that the colour camera and the depth camera show; untuned
HEAD_LONG, HEAD_WIDE = 0.75, 0.25  # trunks above the neck (Winter: 0.63) and to each side; untuned
LIMB_REACH = 0.3  # trunks from a limb, within which depth decides without a witness's mask; untuned


class Outline(NamedTuple):
    """Witnessed person in depth. mask: (h, w). border_px: width of the witness's border."""

    mask: Bool
    skeleton: Skeleton
    border_px: float

    def bounds(self) -> tuple[Bool, Bool]:
        """Return the pixels (h, w) within the border, and the pixels within or on it."""
        side = 2 * max(LEAST_BORDER_PX, round(self.border_px)) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        own = self.mask.astype(np.uint8)
        return cv2.erode(own, kernel, borderValue=1) > 0, cv2.dilate(own, kernel) > 0


def person_outline(
    cloud: ColouredCloud, person: PosedPerson, names: tuple[str, ...], found: Bool
) -> Outline | None:
    """Return the person's outline and skeleton; None for a person without depth.

    names: of the landmarks. found: pixels (h, w) of people found in depth.
    """
    mask = None if person.mask is None else cloud.seen(person.mask)
    shown = found if mask is None else np.nan_to_num(mask) >= 0.5
    shown = shown & cloud.cloud.color_valid
    if shown.sum() < LEAST_PX:
        return None
    border_px = BORDER * person.crop.side * cloud.px_per_px()
    skeleton = skeleton_of(person.landmarks, names, cloud.surface(_inner(shown, border_px)))
    if not np.isfinite(skeleton.joints_m).any():
        return None
    known = found & _above_neck(cloud.cloud.points_m, skeleton)
    if mask is None:
        mask = _near_limbs(cloud.cloud.points_m, skeleton, found)
    own = outline(cloud.depth_mm, mask, found, known, border_px)
    return Outline(own, skeleton, border_px) if own.sum() >= LEAST_PX else None


def _inner(shown: Bool, border_px: float) -> Bool:
    """Return the pixels (h, w) of a mask off its border, where depth mixes surfaces; all of a thin mask."""
    size = 2 * round(border_px / 3) + 1
    inner = cv2.erode(shown.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    return np.asarray(inner, np.bool_) if inner.sum() >= LEAST_PX else shown


def _above_neck(points_m: Float32, skeleton: Skeleton) -> Bool:
    """Return flags (h, w) of points (h, w, 3) where a head can be."""
    neck, pelvis = (skeleton.joints_m[JOINT[name]] for name in ("neck", "pelvis"))
    if not np.isfinite(neck + pelvis).all():
        return np.zeros(points_m.shape[:2], np.bool_)
    up = (neck - pelvis) / max(float(np.linalg.norm(neck - pelvis)), 1e-6)
    off = points_m - neck.astype(np.float32)
    along, ray = off @ up.astype(np.float32), (neck / np.linalg.norm(neck)).astype(np.float32)
    off -= along[..., None] * up.astype(np.float32)
    off -= (1 - ALONG) * (off @ ray)[..., None] * ray
    beside = np.linalg.norm(off, axis=-1)
    trunk_m = skeleton.trunk_m
    return np.asarray((along > 0) & (along < HEAD_LONG * trunk_m) & (beside < HEAD_WIDE * trunk_m), np.bool_)


def _near_limbs(points_m: Float32, skeleton: Skeleton, found: Bool) -> Float32:
    """Return 1 for found points (h, w, 3) near a limb, 0 elsewhere."""
    near = np.zeros(found.shape, np.float32)
    far, _ = distances(points_m[found], skeleton)
    near[found] = np.nanmin(np.where(np.isnan(far), np.inf, far), axis=1) < LIMB_REACH
    return near
