"""Walls, floors and table tops: the large planes of a cloud."""

import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud

MAX_PLANES = 4
PLANE_TOLERANCE_M = 0.025
MIN_PLANE_SHARE = 0.12
"""Of the remaining points: a smaller plane is furniture, or a person's back."""
MIN_PLANE_M = 1.0
"""Second longest side of a plane: a person is narrower than that, arms spread or not."""
SAMPLE = 8000
"""Points on which planes are fitted."""


def without_planes(cloud: ThermalCloud, seed: int = 0) -> NDArray[np.bool_]:
    """Valid pixels (h, w) that lie on no large plane; the same for the same seed.

    Planes are found one after the other by RANSAC (open3d's ``segment_plane``).
    """
    import open3d as o3d  # takes seconds to import, and few clouds come without temperature

    left = cloud.valid.copy()
    rng = np.random.default_rng(seed)
    o3d.utility.random.seed(seed)
    points = cloud.points_m.reshape(-1, 3).astype(np.float64)
    for _ in range(MAX_PLANES):
        index = np.flatnonzero(left)
        if index.size < 500:
            break
        chosen = points[rng.choice(index, min(SAMPLE, index.size), replace=False)]
        sample = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(chosen))
        plane, inliers = sample.segment_plane(PLANE_TOLERANCE_M, 3, 300)
        if len(inliers) < MIN_PLANE_SHARE * len(chosen) or _second_side_m(chosen[inliers]) < MIN_PLANE_M:
            break
        distance = np.abs(points[index] @ np.asarray(plane[:3]) + plane[3])
        left.ravel()[index[distance < PLANE_TOLERANCE_M]] = False
    return left


def _second_side_m(points_m: NDArray[np.float64]) -> float:
    """Second longest side of the points' bounding box along their principal axes (2nd to 98th percentile)."""
    centred = points_m - points_m.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    low, high = np.percentile(centred @ axes.T, (2, 98), axis=0)
    return float(np.sort(high - low)[1])
