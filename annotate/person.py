"""The person in a thermal cloud: warm, connected in space, of human size.

Nishi & Miura 2017, section 4.2.1, take every point of 25 to 35 degrees Celsius. Here that window only
sets the marks: hair, cold cloth and points without a temperature go with the surface they lie on, and a
sofa is told from the person on it by being colder than halfway between the two.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from annotate.cloud import ThermalCloud
from annotate.grid import NO_PIXEL, flood
from annotate.pieces import Piece, likeliest, pieces_of
from annotate.planes import without_planes

WINDOW_C = (25.0, 35.0)
"""Surface temperatures of a dressed person in a room (Nishi & Miura 2017, section 4.2.1)."""
HOT_MARGIN_C = 2.0
"""A radiometric camera is off by up to 2 degrees (Optris PI200): that far above the window is unsure."""
COLD_SHARE, HALFWAY = 0.25, 0.5
"""Shares of the way from the background's temperature to the person's: below the first a point is no
person, above the second (and inside the window) it is, between them its surface decides."""
LEAST_CONTRAST_C = 0.1
"""The camera's own noise (Optris PI200, 0.08 degrees): less than that parts nothing."""

SURROUNDINGS_M = 0.9
"""How far around the warm piece the person may reach: a sleeve, a leg behind an arm rest."""
LOCAL_M = 0.3
"""Half side of the window in which person and background temperatures are compared."""
REACH_M = 0.5
"""How far marks spread over a surface whose temperature is unknown."""
NEAR_M, NEAR_SIZES = 0.35, 3.0
"""A loose warm piece is a limb of the person within this distance, and this many times its own size."""
SPECK_M2 = 0.001
"""Visible surface of what is too small to be anything."""
PANEL_M = 0.006
"""Loose pieces flatter than this (standard deviation) are screens or panels, not limbs."""

UNDECIDED, PERSON, OTHER = 0, 1, 2


@dataclass(frozen=True)
class PersonMask:
    """Which pixels (h, w) of the undistorted depth image are the person; a subset of the valid ones.

    method: "thermal", or "depth" where the cloud has no temperature at all. notes: what the user should
    know, e.g. why the mask is empty.
    """

    mask: NDArray[np.bool_]
    method: Literal["thermal", "depth"]
    notes: tuple[str, ...] = ()


def extract_person(cloud: ThermalCloud, window_c: tuple[float, float] = WINDOW_C) -> PersonMask:
    """Find the person by temperature, or by depth alone where the cloud has none.

    window_c: surface temperatures of a person, degrees Celsius. Where there is no person the mask is
    empty and a note says so; that is no error.
    """
    if np.isfinite(cloud.temperature_c).any():
        return _by_temperature(cloud, window_c)
    return _by_depth(cloud)


def _by_temperature(cloud: ThermalCloud, window_c: tuple[float, float]) -> PersonMask:
    warm = cloud.valid & (cloud.temperature_c >= window_c[0]) & (cloud.temperature_c <= window_c[1])
    mask = np.zeros(warm.shape, np.bool_)
    core = likeliest(pieces_of(cloud, warm, SPECK_M2)[1])
    if core is None:
        note = f"no person: nothing of human size is {window_c[0]:g} to {window_c[1]:g} degrees warm"
        return PersonMask(mask, "thermal", (note,))
    pixels_per_m = cloud.camera.fx / core.centre_m[2]
    around = _window_around(core, round(SURROUNDINGS_M * pixels_per_m))
    marks = _marks(cloud.temperature_c[around], warm[around], window_c[1], pixels_per_m)
    marks[~cloud.valid[around]] = NO_PIXEL
    marks = flood(marks, cloud.points_m[..., 2][around], REACH_M * pixels_per_m)
    mask[around] = marks == PERSON
    return PersonMask(_person_and_limbs(cloud, mask), "thermal")


def _by_depth(cloud: ThermalCloud) -> PersonMask:
    """Without temperature: the human-sized piece nearest to the view's centre, planes taken away."""
    rest = without_planes(cloud)
    labels, pieces = pieces_of(cloud, rest, SPECK_M2)
    candidates = [piece for piece in pieces if piece.is_human_sized]
    if not candidates:
        note = "no person: no connected surface of human size; record temperature to tell people from things"
        return PersonMask(np.zeros(rest.shape, np.bool_), "depth", (note,))
    chosen = max(candidates, key=_centrality)
    note = "found by depth alone: things that touch the person are in the mask"
    return PersonMask(labels == chosen.label, "depth", (note,))


def _centrality(piece: Piece) -> float:
    """Surface over squared distance, nearer to the middle of the view first."""
    x, y, z = piece.centre_m
    return float(piece.area_m2 / (z * z) * np.exp(-(x * x + y * y) / (z * z) / 0.5**2))


def _window_around(core: Piece, margin_px: int) -> tuple[slice, slice]:
    """Rows and columns within a margin of a piece."""
    top, left, bottom, right = core.window
    return np.s_[max(top - margin_px, 0) : bottom + margin_px, max(left - margin_px, 0) : right + margin_px]


def _marks(
    temperature: NDArray[np.float32], warm: NDArray[np.bool_], hottest_c: float, pixels_per_m: float
) -> NDArray[np.uint8]:
    """PERSON and OTHER where the temperature is clear, UNDECIDED elsewhere.

    Compared are each point and the local means of what is warm and what is colder: an image edge blurred
    by the thermal lens lies halfway between its two sides.
    """
    size = 2 * round(LOCAL_M * pixels_per_m) + 1
    person = _local_mean(temperature, warm, size)
    cold = np.isfinite(temperature) & ~warm & (temperature < hottest_c)
    for _ in range(2):  # the second time without cold cloth, which has raised the mean
        background = _local_mean(temperature, cold, size)
        share = (temperature - background) / np.maximum(person - background, LEAST_CONTRAST_C)
        cold &= share < COLD_SHARE
    marks = np.zeros(temperature.shape, np.uint8)
    marks[warm & (share >= HALFWAY)] = PERSON
    marks[~warm & (share < COLD_SHARE)] = OTHER
    marks[temperature > hottest_c + HOT_MARGIN_C] = OTHER
    return marks


def _local_mean(values: NDArray[np.float32], mask: NDArray[np.bool_], size: int) -> NDArray[np.float32]:
    """Mean over the masked pixels of a square window; the overall mean where there is none."""
    kept = np.where(mask, values, np.float32(0))
    total = cv2.boxFilter(kept, cv2.CV_32F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
    count = cv2.boxFilter(
        mask.astype(np.float32), cv2.CV_32F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    overall = np.float32(kept.sum() / max(mask.sum(), 1))
    return np.where(count > 0.5, total / np.maximum(count, 1), overall).astype(np.float32)


def _person_and_limbs(cloud: ThermalCloud, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The likeliest person among the mask's pieces, with the loose pieces near to it that can be limbs."""
    labels, pieces = pieces_of(cloud, mask, SPECK_M2)
    body = likeliest(pieces)
    if body is None:
        return np.zeros(mask.shape, np.bool_)
    tree = cKDTree(cloud.points_m[labels == body.label][::7])
    kept = [body.label]
    for piece in pieces:
        if piece.label != body.label:
            gap, _ = tree.query(cloud.points_m[labels == piece.label][::3], distance_upper_bound=NEAR_M)
            near_m = min(NEAR_M, NEAR_SIZES * np.sqrt(piece.area_m2))
            if gap.min() <= near_m and piece.thickness_m >= PANEL_M:
                kept.append(piece.label)
    return np.isin(labels, kept)
