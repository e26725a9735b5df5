"""Connected pieces of a cloud with their sizes in space."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, Float64, Int32
from annotate.cloud.grid import components
from annotate.cloud.thermal_cloud import ThermalCloud

MIN_PERSON_M2 = 0.03
"""Least visible surface of a person in m2: a head with a shoulder. Chosen by eye."""
MOST_PERSON_M2 = 2.5
"""Largest visible surface of a person in m2, twice the front of a tall adult. Chosen by eye."""


@dataclass(frozen=True)
class Piece:
    """One connected piece of a cloud.

    label: its id in the label image. area_m2: its visible surface, taken as seen head-on. thickness_m: the
    least standard deviation of its points over all directions.
    """

    label: int
    area_m2: float
    thickness_m: float


def pieces_of(cloud: ThermalCloud, mask: Bool, least_m2: float) -> tuple[Int32, list[Piece]]:
    """Label image (h, w) of a mask's connected pieces, 0 off them, and the pieces of at least ``least_m2``.

    mask: bool (h, w), valid pixels only.
    """
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
        own = points[order[first[i] : first[i + 1]]]
        pieces.append(Piece(int(i), float(area[i]), _thickness_m(own)))
    return labels, pieces


def _thickness_m(points_m: Float64) -> float:
    """Least standard deviation in metres of points (n, 3) over all directions, by a sample of them."""
    sample = points_m[:: max(1, len(points_m) // 2000)]
    away = sample - sample.mean(axis=0)
    variances, _ = np.linalg.eigh(away.T @ away / len(sample))
    return float(np.sqrt(max(variances[0], 0.0)))
