"""Tubes of cloth that hang from the widest place of a limb."""

import numba
import numpy as np

from annotate.array_types import Bool, Float32
from synth.surface.rasterize import EXACT

SECTORS = 24  # directions around the axis
STEP_M = 0.02  # from ring to ring: about an edge of the skin
Places = tuple[Float32, Float32, Float32]
"""Vertices (V,): place along the axis, downwards, angle and distance as in ``Cylindrical``."""


@numba.njit(cache=True, fastmath=EXACT)
def slack_m(places: Places, source: Bool, give: float, spans: int = 0) -> Float32:
    """Return the distance (V,) of the vertices from a hanging tube around the vertices flagged in ``source``.

    give: narrowing of the tube per metre downwards; 0 hangs straight from the widest place, 2 follows the
    limb. spans: sectors on either side that the tube bridges.
    """
    down_m, around_rad, away_m = places
    start, end = np.inf, -np.inf
    for i in range(len(source)):
        if source[i]:
            start, end = min(start, down_m[i]), max(end, down_m[i])
    slack = np.zeros(len(source), np.float32)
    if end <= start:
        return slack
    radii = _widest(places, source, start, int((end - start) / STEP_M) + 3)
    for k in range(1, len(radii)):
        for j in range(SECTORS):
            radii[k, j] = max(radii[k, j], radii[k - 1, j] - np.float32(give * STEP_M))
    for _ in range(spans):
        before = radii.copy()
        for k in range(len(radii)):
            for j in range(SECTORS):
                radii[k, j] = max(before[k, j], before[k, j - 1], before[k, (j + 1) % SECTORS])
    radii = _smoothed(_smoothed(radii))
    for i in range(len(source)):
        if source[i]:
            slack[i] = max(_read(radii, (down_m[i] - start) / STEP_M, around_rad[i]) - away_m[i], 0.0)
    return slack


@numba.njit(cache=True, fastmath=EXACT)
def _widest(places: Places, source: Bool, start: float, rings: int) -> Float32:
    """Return the greatest distance (rings, SECTORS) of ``source`` vertices near each grid node from the axis.

    A sector without vertices gets the greater distance of its two neighbours.
    """
    down, around, away = places
    radii = np.zeros((rings, SECTORS), np.float32)
    for i in range(len(down)):
        if source[i]:
            k = int((down[i] - start) / STEP_M)
            j = int(np.floor(around[i] * (SECTORS / (2 * np.pi))))
            for a in range(2):
                for b in range(2):
                    c = (j + b) % SECTORS
                    radii[k + a, c] = max(radii[k + a, c], away[i])
    for k in range(rings):
        for _ in range(3):
            before = radii[k].copy()
            for j in range(SECTORS):
                if before[j] == 0:
                    radii[k, j] = max(before[j - 1], before[(j + 1) % SECTORS])
    return radii


@numba.njit(cache=True, fastmath=EXACT)
def _smoothed(radii: Float32) -> Float32:
    n = len(radii)
    result = np.empty_like(radii)
    for k in range(n):
        for j in range(SECTORS):
            near = radii[k, j - 1] + radii[k, (j + 1) % SECTORS]
            near += radii[max(k - 1, 0), j] + radii[min(k + 1, n - 1), j]
            result[k, j] = np.float32(0.4) * radii[k, j] + np.float32(0.15) * near
    return result


@numba.njit(cache=True, fastmath=EXACT)
def _read(radii: Float32, ring: float, around: float) -> float:
    sector = around * (SECTORS / (2 * np.pi))
    k, j = int(ring), int(np.floor(sector))
    a, b = ring - k, sector - j
    j, following = j % SECTORS, (j + 1) % SECTORS
    value: float = (1 - a) * ((1 - b) * radii[k, j] + b * radii[k, following])
    value += a * ((1 - b) * radii[k + 1, j] + b * radii[k + 1, following])
    return value
