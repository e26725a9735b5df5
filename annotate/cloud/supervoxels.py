"""Supervoxels and clusters of a cloud: PCL behind plain numpy arrays.

Points are (n, 3) in metres in any one frame. Points that are not finite (no reading) have id -1. The same
input always gives the same ids.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate import _pcl
from annotate.array_types import Bool, Float32, Float64, Int32, Int64, UInt8
from sensors.errors import CloudError
from sensors.rig.nearest import Nearest


@dataclass(frozen=True)
class Supervoxels:
    """Tiles of a cloud: small pieces of surface, alike in place, normal and colour.

    ids: int32 (n,), 0 <= id < count, -1 for points without a reading; no id is unused.
    count: number of supervoxels. edges: int32 (e, 2), pairs of touching supervoxels, each pair
    once, low id first, sorted. Raises CloudError on arrays that contradict each other.
    """

    ids: Int32
    count: int
    edges: Int32

    def __post_init__(self) -> None:
        used = np.unique(self.ids[self.ids >= 0])
        if self.ids.ndim != 1 or not np.array_equal(used, np.arange(self.count)):
            raise CloudError(
                f"supervoxel ids {self.ids.shape} do not run from 0 to {self.count - 1}; renumber them"
            )
        if self.edges.ndim != 2 or self.edges.shape[1] != 2:
            raise CloudError(f"supervoxel edges are {self.edges.shape}; give (e, 2)")
        if self.edges.size and not 0 <= self.edges.min() <= self.edges.max() < self.count:
            raise CloudError(f"an edge names no supervoxel; use ids from 0 to {self.count - 1}")

    @property
    def sizes(self) -> Int64:
        """Number of points (count,) in each supervoxel; never 0."""
        return np.bincount(self.ids[self.ids >= 0], minlength=self.count)

    def mean(self, values: NDArray[np.generic]) -> Float64:
        """Mean (count, ...) over each supervoxel of a feature (n, ...) of the points.

        NaN in a feature spreads to its supervoxel. Raises CloudError on another length.
        """
        if len(values) != len(self.ids):
            raise CloudError(f"{len(values)} values for {len(self.ids)} points; give one for each point")
        inside = self.ids >= 0
        ids = self.ids[inside]
        columns = np.asarray(values)[inside].reshape(len(ids), -1).astype(np.float64)
        sums = np.empty((self.count, columns.shape[1]))
        for column, total in zip(columns.T, sums.T, strict=True):
            total[:] = np.bincount(ids, column, self.count)
        return (sums / self.sizes[:, None]).reshape(self.count, *values.shape[1:])

    def centroids_m(self, points_m: Float32) -> Float64:
        """Centroids (count, 3) in metres of the points (n, 3) the supervoxels were made of."""
        return self.mean(points_m)


def single_points(mask: Bool) -> Supervoxels:
    """The points of a mask (h, w), row-major, each by itself; points side by side in the image touch."""
    ids = np.full(mask.shape, -1, np.int32)
    ids[mask] = np.arange(mask.sum())
    pairs = ((ids[:, :-1], ids[:, 1:]), (ids[:-1], ids[1:]))
    edges = np.concatenate([np.column_stack([a.ravel(), b.ravel()]) for a, b in pairs])
    edges = edges[(edges >= 0).all(axis=1)]
    return Supervoxels(ids[mask], len(ids[mask]), edges)


def supervoxels(
    points_m: Float32,
    colors_rgb: UInt8,
    *,
    voxel_m: float = 0.012,
    seed_m: float = 0.06,
    spatial_weight: float = 0.4,
    normal_weight: float = 1.0,
    color_weight: float = 1.0,
) -> Supervoxels:
    """Supervoxels of a cloud by VCCS (Papon et al., CVPR 2013) without its camera transform.

    points_m: float32 (n, 3). colors_rgb: uint8 (n, 3). voxel_m: spacing of the grid on which the surface is
    followed. seed_m: distance between seeds, about a supervoxel's diameter. The weights are those of PCL's
    distance (spatial relative to seed_m, 1 - |cos| of the normals, colour relative to 255).

    Every finite point is assigned: points that VCCS leaves out join the supervoxel of the nearest assigned
    point within seed_m; islands farther off become supervoxels of their own. Raises CloudError on shapes or
    lengths that differ, and on sizes that are not positive.
    """
    finite, points, colors = _finite(points_m, colors_rgb)
    with _one_line_errors():
        found, edges = _pcl.supervoxels(
            points,
            colors,
            voxel_m=voxel_m,
            seed_m=seed_m,
            spatial_weight=spatial_weight,
            normal_weight=normal_weight,
            color_weight=color_weight,
        )
    count, found = _assign_rest(points, found, seed_m)
    return Supervoxels(_spread(found, finite), count, edges)


def clusters(points_m: Float32, *, tolerance_m: float, min_size: int = 1) -> Int32:
    """Numbers int32 (n,) of clusters: points (n, 3) joined within tolerance_m of one another.

    0 is the largest cluster, ties go by the first point; -1 in clusters under min_size points. Raises
    CloudError as `supervoxels` does.
    """
    finite, points, _ = _finite(points_m, np.zeros((len(points_m), 3), np.uint8))
    with _one_line_errors():
        found = _pcl.euclidean_clusters(points, tolerance_m=tolerance_m, min_size=min_size)
    return _spread(found, finite)


def _finite(points_m: Float32, colors_rgb: UInt8) -> tuple[Bool, Float32, UInt8]:
    """Mask (n,) of the finite points, and those points and colours as PCL's binding takes them."""
    if points_m.ndim != 2 or points_m.shape[1] != 3 or points_m.dtype.kind != "f":
        raise CloudError(f"points are {points_m.dtype} {points_m.shape}; give metres as float32 (n, 3)")
    if colors_rgb.shape != points_m.shape or colors_rgb.dtype != np.uint8:
        raise CloudError(
            f"colours are {colors_rgb.dtype} {colors_rgb.shape} for points {points_m.shape}; "
            "give uint8, one row for each point"
        )
    finite = np.asarray(np.isfinite(points_m).all(axis=1))
    return finite, points_m[finite].astype(np.float32, copy=False), colors_rgb[finite]


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """Turn the binding's refusals into the project's own error."""
    try:
        yield
    except ValueError as error:
        raise CloudError(str(error)) from error


def _assign_rest(points: Float32, ids: Int32, seed_m: float) -> tuple[int, Int32]:
    """Number of supervoxels, and ids (n,) with one for every point that VCCS left out (-1)."""
    assigned, count = ids >= 0, int(ids.max(initial=-1)) + 1
    rest = np.flatnonzero(~assigned)
    if rest.size and count:
        away_m, nearest = Nearest(points[assigned]).query(points[rest], within=seed_m)
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
