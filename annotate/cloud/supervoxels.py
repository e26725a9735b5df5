"""Supervoxels and clusters of a cloud by PCL.

Points are (n, 3) in metres in any frame. Points that are not finite have id -1. Deterministic.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from annotate import _pcl
from annotate.array_types import Bool, Float32, Float64, Int32, Int64, UInt8

VOXEL_M = 0.012  # of the grid on which the surface is followed; untuned
SPATIAL_WEIGHT, NORMAL_WEIGHT = 0.4, 1.0  # in PCL's distance: of place / ``seed_m``, of 1 - |cos|; untuned


@dataclass(frozen=True)
class Supervoxels:
    """Small pieces of surface with similar position, normal and colour.

    ids: int32 (n,), 0 to count - 1, all used; -1 for points without a reading. edges: int32 (e, 2), pairs of
    touching supervoxels, low id first, sorted.
    """

    ids: Int32
    count: int
    edges: Int32

    @property
    def sizes(self) -> Int64:
        """Return the number of points (count,) of each supervoxel."""
        return np.bincount(self.ids[self.ids >= 0], minlength=self.count)

    def mean(self, values: NDArray[np.generic]) -> Float64:
        """Return the mean (count, ...) of a feature (n, ...) over each supervoxel; NaN if a value is NaN."""
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
    """Compute the supervoxels of a cloud by VCCS (Papon et al., CVPR 2013) without camera transform.

    points_m: float32 (n, 3). colors_rgb: uint8 (n, 3). seed_m: distance between seeds, more than VOXEL_M.
    color_weight: weight of the colour term in PCL's distance, channels divided by 255. Points that VCCS
    leaves out join the nearest supervoxel within seed_m; islands farther off become supervoxels.
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
    """Return cluster numbers int32 (n,) of points (n, 3) joined within tolerance_m; 0 is the largest."""
    finite = np.asarray(np.isfinite(points_m).all(axis=1))
    points = points_m[finite].astype(np.float32, copy=False)
    return _spread(_pcl.euclidean_clusters(points, tolerance_m=tolerance_m, min_size=1), finite)


def _assign_rest(points: Float32, ids: Int32, seed_m: float) -> tuple[int, Int32]:
    """Return the number of supervoxels, and ids (n,) with the unassigned points added to supervoxels."""
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
    """Return ids (n,) of all points, from ids of the finite points (bool (n,)); -1 for the others."""
    spread = np.full(len(finite), -1, np.int32)
    spread[finite] = ids
    return spread
