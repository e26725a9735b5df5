"""The nearest of many points, exactly: OpenCV's FLANN with a single k-d tree."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_KDTREE_SINGLE = 4
"""FLANN's exact tree for few dimensions; its other indices only guess (flann/defines.h)."""
_ALL = -1
"""Leaves to visit: as many as it takes."""


class Nearest:
    """Points to look for the nearest of. points: (n, d), of any type and unit; compared in float32."""

    def __init__(self, points: NDArray[Any]) -> None:
        self.points = points
        self._rows = np.ascontiguousarray(points, np.float32)  # FLANN keeps no copy
        self._index = cv2.flann.Index(self._rows, {"algorithm": _KDTREE_SINGLE}) if len(points) else None

    def query(
        self, places: NDArray[Any], k: int = 1, within: float = np.inf
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Distances and indices of the k nearest points of each place (m, d), nearest first: (m, k) each.

        Where fewer are nearer than ``within``: infinity, and index n. For k = 1 both are (m,).
        """
        n, shape = len(self.points), (len(places), k)
        away, index = np.full(shape, np.inf), np.full(shape, n, np.intp)
        found = min(k, n)
        if self._index is not None and len(places):
            rows = np.ascontiguousarray(places, np.float32)
            nearest, squared = self._index.knnSearch(rows, found, params={"checks": _ALL})
            away[:, :found], index[:, :found] = np.sqrt(squared), nearest
            far = away >= within
            away[far], index[far] = np.inf, n
        return (away[:, 0], index[:, 0]) if k == 1 else (away, index)
