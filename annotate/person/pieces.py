"""Connected pieces of a cloud with their sizes in space, and which of them is most like a person."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, Float64, Index, Int32
from annotate.cloud.grid import components
from annotate.cloud.thermal_cloud import ThermalCloud

MIN_PERSON_M2, MAX_PERSON_M2 = 0.03, 2.5
"""Visible surface of a person: from a head with a shoulder to twice the front of a tall adult."""
MAX_PERSON_M = 2.4
"""Longest side of a person's bounding box, arms raised."""
PLANE_M = 0.02
"""Points so near to a plane lie on it."""


@dataclass(frozen=True)
class Piece:
    """One connected piece of a cloud.

    label: its id in the label image. area_m2: its visible surface, taken as seen head-on.
    window: (top, left, bottom, right) in pixels, the last two exclusive.
    thickness_m: the least standard deviation of its points over all directions. flat: the share of its
    points on one plane. low_m, high_m: its bounding box (3,), depth-camera frame. centre_m: the mean
    of its points (3,).
    """

    label: int
    area_m2: float
    window: tuple[int, int, int, int]
    thickness_m: float
    flat: float
    low_m: Float64
    high_m: Float64
    centre_m: Float64

    @property
    def is_human_sized(self) -> bool:
        """Whether a person, or the visible part of one, can have this surface and extent."""
        extent = float((self.high_m - self.low_m).max())
        return MIN_PERSON_M2 <= self.area_m2 <= MAX_PERSON_M2 and extent <= MAX_PERSON_M

    @property
    def likeness(self) -> float:
        """Surface in m2 off its main plane: radiators, screens and sunlit walls have little of it."""
        return self.area_m2 * (1 - self.flat)


def pieces_of(cloud: ThermalCloud, mask: Bool, least_m2: float) -> tuple[Int32, list[Piece]]:
    """Connected pieces of a mask (h, w) of valid pixels: label image (h, w), and those of ``least_m2`` on."""
    labels, count = components(mask, cloud.points_m[..., 2])
    index = np.flatnonzero(labels)
    label = labels.ravel()[index]
    points = cloud.points_m.reshape(-1, 3)[index].astype(np.float64)
    pixel_m2 = points[:, 2] ** 2 / (cloud.camera.fx * cloud.camera.fy)
    area = np.bincount(label, pixel_m2, count + 1)
    order = np.argsort(label, kind="stable")
    first = np.searchsorted(label[order], np.arange(count + 2))
    pieces = []
    for i in np.flatnonzero(area >= least_m2):
        member = order[first[i] : first[i + 1]]
        v, u = np.divmod(index[member], mask.shape[1])
        pieces.append(_measured(int(i), float(area[i]), v, u, points[member]))
    return labels, pieces


def likeliest(pieces: Sequence[Piece]) -> Piece | None:
    """The human-sized piece most like a person, or None."""
    return max((p for p in pieces if p.is_human_sized), key=lambda p: p.likeness, default=None)


def _measured(label: int, area_m2: float, v: Index, u: Index, points_m: Float64) -> Piece:
    thickness, flat = _flatness(points_m)
    window = int(v.min()), int(u.min()), int(v.max()) + 1, int(u.max()) + 1
    low, high, centre = points_m.min(axis=0), points_m.max(axis=0), points_m.mean(axis=0)
    return Piece(label, area_m2, window, thickness, flat, low, high, centre)


def _flatness(points_m: Float64) -> tuple[float, float]:
    """Least standard deviation, and the share of points within PLANE_M of the best trimmed plane."""
    sample = points_m[:: max(1, len(points_m) // 2000)]
    kept = sample
    for _ in range(4):
        centre = kept.mean(axis=0)
        variances, axes = np.linalg.eigh((kept - centre).T @ (kept - centre) / len(kept))
        if kept is sample:
            thickness = float(np.sqrt(max(variances[0], 0.0)))
        distance = np.abs((sample - centre) @ axes[:, 0])
        kept = sample[distance <= np.quantile(distance, 0.6)]
    return thickness, float((distance < PLANE_M).mean())
