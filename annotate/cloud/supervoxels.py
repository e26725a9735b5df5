"""Supervoxels and clusters of a cloud: PCL behind plain numpy arrays.

Points are (n, 3) in metres in any one frame. Points that are not finite (no reading) have id -1. The same
input always gives the same ids.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from annotate import _pcl
from annotate.array_types import Bool, Float32, Float64, Int32, Int64, UInt8

VOXEL_M = 0.012
"""Metres between the points of the grid on which the surface is followed. Chosen by eye."""
SPATIAL_WEIGHT, NORMAL_WEIGHT = 0.4, 1.0
"""Weights in PCL's distance of place, relative to ``seed_m``, and of 1 - |cos| of normals. Chosen by eye."""


@dataclass(frozen=True)
class Supervoxels:
    """Tiles of a cloud: small pieces of surface, alike in place, normal and colour.

    ids: int32 (n,), 0 <= id < count, -1 for points without a reading; no id is unused.
    count: number of supervoxels. edges: int32 (e, 2), pairs of touching supervoxels, each pair
    once, low id first, sorted.
    """

    ids: Int32
    count: int
    edges: Int32

    @property
    def sizes(self) -> Int64:
        """Number of points (count,) in each supervoxel; never 0."""
        return np.bincount(self.ids[self.ids >= 0], minlength=self.count)

    def mean(self, values: NDArray[np.generic]) -> Float64:
        """Mean (count, ...) over each supervoxel of a feature (n, ...) of the points; NaN spreads."""
        inside = self.ids >= 0
        ids = self.ids[inside]
        columns = np.asarray(values)[inside].reshape(len(ids), -1).astype(np.float64)
        sums = np.empty((self.count, columns.shape[1]))
        for column, total in zip(columns.T, sums.T, strict=True):
            total[:] = np.bincount(ids, column, self.count)
        return (sums / self.sizes[:, None]).reshape(self.count, *values.shape[1:])


def supervoxels(
    points_m: Float32, colors_rgb: UInt8, *, seed_m: float = 0.06, color_weight: float = 1.0
) -> Supervoxels:
    """Supervoxels of a cloud by VCCS (Papon et al., CVPR 2013) without its camera transform.

    points_m: float32 (n, 3). colors_rgb: uint8 (n, 3). seed_m: distance between seeds, about a supervoxel's
    diameter, more than VOXEL_M. color_weight: weight in PCL's distance of colour relative to 255.

    Every finite point is assigned: points that VCCS leaves out join the supervoxel of the nearest assigned
    point within seed_m; islands farther off become supervoxels of their own.
    """
    finite = np.asarray(np.isfinite(points_m).all(axis=1))
    points = points_m[finite].astype(np.float32, copy=False)
    found, edges = _pcl.supervoxels(
        points,
        colors_rgb[finite],
        voxel_m=VOXEL_M,
        seed_m=seed_m,
        spatial_weight=SPATIAL_WEIGHT,
        normal_weight=NORMAL_WEIGHT,
        color_weight=color_weight,
    )
    count, found = _assign_rest(points, found, seed_m)
    return Supervoxels(_spread(found, finite), count, edges)


def clusters(points_m: Float32, *, tolerance_m: float) -> Int32:
    """Numbers int32 (n,) of clusters: points (n, 3) joined within tolerance_m of one another.

    0 is the largest cluster, ties go by the first point.
    """
    finite = np.asarray(np.isfinite(points_m).all(axis=1))
    points = points_m[finite].astype(np.float32, copy=False)
    return _spread(_pcl.euclidean_clusters(points, tolerance_m=tolerance_m, min_size=1), finite)


def _assign_rest(points: Float32, ids: Int32, seed_m: float) -> tuple[int, Int32]:
    """Number of supervoxels, and ids (n,) with one for every point that VCCS left out (-1)."""
    assigned, count = ids >= 0, int(ids.max(initial=-1)) + 1
    rest = np.flatnonzero(~assigned)
    if rest.size and count:
        away_m, nearest = cKDTree(points[assigned]).query(points[rest], distance_upper_bound=seed_m)
        near = np.isfinite(away_m)
        ids[rest[near]] = ids[assigned][nearest[near]]
        rest = rest[~near]
    if rest.size:
        islands = clusters(points[rest], tolerance_m=seed_m)
        ids[rest] = count + islands
        count += int(islands.max()) + 1
    return count, ids


def _spread(ids: Int32, finite: Bool) -> Int32:
    """Ids (n,) of all points, from those of the finite ones (bool (n,)); -1 for the others."""
    spread = np.full(len(finite), -1, np.int32)
    spread[finite] = ids
    return spread
