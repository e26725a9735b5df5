"""Borders at the depth image's resolution: what the network leaves open, each pixel's own colour decides."""

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int32, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import N_CLASSES
from annotate.reader.channels import Rectangle
from annotate.suit.color_model import ColorModel, readable

SURELY_ROOM, LEAST = 0.98, 1e-4
"""Probability from which on a pixel stays the room's, and probability added to each. Chosen by eye."""
OWN_COLOR = 0.5
"""Weight of the log likelihood of a pixel's colour beside the network's log probability. Of 0, 0.5, 1 and 2
fitted to 48 frames of the virtual rig, with an early network."""
NEIGHBOUR, JUMP_M, ROUNDS = 0.5, 0.03, 4
"""Log score that each of the eight neighbours adds to its own class at a pixel, the depth difference in
metres of neighbours on different surfaces, and most rounds. Chosen by eye."""


def with_borders(
    cloud: ThermalCloud, where: Rectangle, chance: Float32, light: ColorModel
) -> tuple[UInt8, Float32]:
    """Likeliest class uint8 (h, w) of the pixels of a rectangle, and its probability by the network (h, w).

    chance: float32 (13, h, w), of the network. light: the suit's colours in the frame's light; the classes
    that are no part count as of the usual colour of the parts. By iterated conditional modes (Besag 1986).
    """
    asked = cloud.valid[where] & (chance[0] < SURELY_ROOM)
    own = chance[:, asked].T
    scores = np.log(own.astype(np.float64) + LEAST)
    scores += OWN_COLOR * _by_color(cloud, where, asked, scores, light)
    index = np.full(asked.shape, -1, np.int32)
    index[asked] = np.arange(len(scores))
    named, sure = np.zeros(asked.shape, np.uint8), np.zeros(asked.shape, np.float32)
    if len(scores):
        depth_m = np.nan_to_num(cloud.points_m[where][..., 2])
        chosen = _modes(scores, scores.argmax(axis=1).astype(np.uint8), depth_m, index)
        named[asked], sure[asked] = chosen, own[np.arange(len(own)), chosen]
    return named, sure


def _by_color(
    cloud: ThermalCloud, where: Rectangle, asked: Bool, scores: Float64, light: ColorModel
) -> Float64:
    """Log likelihood (n, 13) of the colours of the n pixels asked under each class; 0 without a colour."""
    found, parts = np.zeros_like(scores), slice(1, N_CLASSES)
    rgb = cloud.color_rgb[where][asked]
    usable = readable(rgb, cloud.color_valid[where][asked])
    of_parts = light.evidence(rgb[usable])
    found[usable, parts] = of_parts
    weight = np.exp(scores[usable, parts])
    usual = (weight * of_parts).sum(axis=1) / weight.sum(axis=1)
    found[usable, 0] = found[usable, N_CLASSES] = usual
    return found


@njit(cache=True, nogil=True)
def _modes(scores: Float64, start: UInt8, depth_m: Float32, index: Int32) -> UInt8:
    """Classes (n,); index: (h, w), place of each pixel in ``scores`` (n, k), -1 elsewhere."""
    height, width = index.shape
    chosen = start.copy()
    total = np.empty(scores.shape[1])
    for _ in range(ROUNDS):
        last = chosen.copy()
        for v in range(height):
            for u in range(width):
                i = index[v, u]
                if i < 0:
                    continue
                total[:] = scores[i]
                for r in range(max(v - 1, 0), min(v + 2, height)):
                    for c in range(max(u - 1, 0), min(u + 2, width)):
                        j = index[r, c]
                        if j >= 0 and j != i and abs(depth_m[r, c] - depth_m[v, u]) <= JUMP_M:
                            total[last[j]] += NEIGHBOUR
                chosen[i] = np.argmax(total)
        if np.array_equal(chosen, last):
            break
    return chosen
