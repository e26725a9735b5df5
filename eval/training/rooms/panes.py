"""Panes of random rooms, through which depth wanders: glass, mirrors, glossy fronts. Constants are untuned.

Glass gives its own depth or the depth behind it; a mirror gives depth from behind its plane. Where a
camera mixes them, depth drifts smoothly between both. Some places give none.
"""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, sheet

BEHIND, OWN, WANDERING = 0.35, 0.6, 0.92  # cumulative shares of a pane's area by its depth; rest: none
LUMP_PX = (6, 40)  # size of the patches
DEEP_M = 2.5  # greatest wandering depth behind a pane
WAVE_M = 0.06  # standard deviation of waves on a pane


def draw_pane(rng: np.random.Generator, corner_m: Float64, along_m: Float64) -> Mesh:
    """Draw an upright pane in a wall from a corner (3,) on the floor along a vector (3,)."""
    start, width = np.sort(rng.uniform(0, 1, 2)) * 0.9 + np.array([0, 0.1])
    low, high = np.sort(rng.uniform(0.3, 2.2, 2)) + np.array([0, 0.2])
    if rng.random() < 0.5:
        low, high = 0.0, 2.1
    at = corner_m + start * along_m + np.array([0, 0, low])
    return sheet(at, (width - start) * along_m, np.array([0, 0, high - low]), Surface.WINDOW)


def wandering(behind_m: Float32, pane_m: Float32, rng: np.random.Generator) -> tuple[Float32, Bool]:
    """Return the clean depth (h, w) of a room with panes, and the mask of pixels that show the room.

    behind_m, pane_m: depth of the room without panes, and of the panes; NaN = none.
    """
    hit = np.isfinite(pane_m) & ~(behind_m < pane_m)
    if not hit.any():
        return behind_m, np.ones(hit.shape, np.bool_)
    kind, ghost, waves = (_uneven(hit.shape, rng) for _ in range(3))
    rank = kind[hit].argsort().argsort() / hit.sum() + rng.normal(0, 0.25)
    deep = np.abs(ghost[hit]) * rng.uniform(0.05, DEEP_M)
    own = pane_m[hit] + np.float32(rng.uniform(0, WAVE_M)) * waves[hit]
    given = np.select([rank < BEHIND, rank < OWN, rank < WANDERING], [behind_m[hit], own, own + deep], np.nan)
    depth, shows = behind_m.copy(), np.ones(hit.shape, np.bool_)
    depth[hit] = given
    shows[hit] = rank < BEHIND
    return depth, shows


def _uneven(shape: tuple[int, ...], rng: np.random.Generator) -> Float32:
    """Return smooth noise (h, w) of standard deviation about 1."""
    size = rng.uniform(*LUMP_PX)
    rows, columns = (max(2, int(side / size)) for side in shape)
    coarse = rng.normal(0, 1, (rows, columns)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)
