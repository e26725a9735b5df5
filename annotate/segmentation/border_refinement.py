"""Borders of parts at the depth image's resolution, refined by each pixel's colour.

Constants are untuned unless a source is given.
"""

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Int32, UInt8
from annotate.cloud.grid import JUMP
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from annotate.segmentation.input_channels import Rectangle
from annotate.suit.color_model import ColorModel, readable

SURELY_ROOM = 0.98  # probability from which a pixel stays background
OWN_COLOR = 0.5  # weight of a colour's log likelihood; 0.75 and 1 lose 0.001 recall on 176 virtual frames
NEIGHBOUR = 0.5  # log score that each of eight neighbours on the surface adds to its own class
ROUNDS = 4


def refine_borders(
    cloud: ThermalCloud,
    where: Rectangle,
    chance: Float32,
    illuminant: ColorModel | None,
    scheme: Scheme = PAPER,
) -> tuple[UInt8, Float32]:
    """Label the pixels of a rectangle; return class uint8 (h, w) and the network's probability (h, w) of that
    class.

    chance: float32 (K + 1, h, w), probabilities of a scheme's classes and another person. illuminant: the
    suit's colours in the frame's illuminant; None = no suit. The colour likelihood of all but the body is the
    mean over its parts. Solved with neighbours on a surface by iterated conditional modes (Besag 1986).
    """
    undecided = cloud.valid[where] & (chance[0] < SURELY_ROOM)
    own = chance.reshape(len(chance), -1).take(np.flatnonzero(undecided), axis=1)
    scores = np.log(np.maximum(own, np.finfo(np.float32).tiny))
    if illuminant is not None:
        rgb = cloud.color_rgb[where][undecided]
        usable = readable(rgb, cloud.color_valid[where][undecided])
        scores += by_color(rgb, usable, scores, (illuminant, scheme))
    index = np.full(undecided.shape, -1, np.int32)
    index[undecided] = np.arange(scores.shape[1])
    named, sure = np.zeros(undecided.shape, np.uint8), np.zeros(undecided.shape, np.float32)
    if scores.size:
        depth_m = np.nan_to_num(cloud.points_m[where][..., 2])
        chosen = _modes(np.ascontiguousarray(scores.T), depth_m, index)
        named[undecided], sure[undecided] = chosen, own[chosen, np.arange(len(chosen))]
    return named, sure


def by_color(rgb: UInt8, usable: Bool, scores: Float32, suit: tuple[ColorModel, Scheme]) -> Float32:
    """Return the weighted log likelihood (K + 1, n) of colours uint8 (n, 3); 0 where not ``usable`` (n,).

    scores: (K + 1, n), log probabilities of a scheme's classes and another person. suit: its colours, and the
    scheme.
    """
    illuminant, scheme = suit
    found, parts = np.zeros_like(scores), scheme.body_classes
    others = np.setdiff1d(np.arange(len(scores)), parts)
    of_parts = illuminant.evidence(rgb[usable], scheme)
    weight = np.exp(scores[parts][:, usable])
    found[np.ix_(parts, usable)] = of_parts
    found[np.ix_(others, usable)] = (weight * of_parts).sum(axis=0) / weight.sum(axis=0)
    return np.float32(OWN_COLOR) * found


@njit(cache=True, nogil=True)
def _modes(scores: Float32, depth_m: Float32, index: Int32) -> UInt8:
    """Return classes (n,) by iterated conditional modes from ``scores`` (n, k). index: (h, w), each pixel's
    row in ``scores``, -1 = none.
    """
    height, width = index.shape
    chosen = np.empty(len(scores), np.uint8)
    for i in range(len(scores)):
        chosen[i] = np.argmax(scores[i])
    moved, total = _at_borders(chosen, index), np.empty(scores.shape[1], np.float32)
    for _ in range(ROUNDS):
        last, moved_last, moved = chosen.copy(), moved, np.zeros(index.shape, np.bool_)
        for v in range(height):
            for u in range(width):
                i = index[v, u]
                near = slice(max(v - 1, 0), v + 2), slice(max(u - 1, 0), u + 2)
                # Elsewhere all neighbours are of the same class, or none has moved: the class stays.
                if i < 0 or not moved_last[near].any():
                    continue
                total[:], jump_m = scores[i], np.float32(JUMP) * depth_m[v, u]
                for r in range(max(v - 1, 0), min(v + 2, height)):
                    for c in range(max(u - 1, 0), min(u + 2, width)):
                        j = index[r, c]
                        if j >= 0 and j != i and abs(depth_m[r, c] - depth_m[v, u]) <= jump_m:
                            total[last[j]] += np.float32(NEIGHBOUR)
                chosen[i] = np.argmax(total)
                moved[v, u] = chosen[i] != last[i]
        if not moved.any():
            break
    return chosen


@njit(cache=True, nogil=True)
def _at_borders(chosen: UInt8, index: Int32) -> Bool:
    """Return True (h, w) at pixels with another class to the right or below.

    index: (h, w), each pixel's row in classes ``chosen`` (n,), -1 = none.
    """
    height, width = index.shape
    found = np.zeros(index.shape, np.bool_)
    for v in range(height):
        for u in range(width):
            for r, c in ((v, u + 1), (v + 1, u - 1), (v + 1, u), (v + 1, u + 1)):
                if r >= height or not 0 <= c < width or min(index[v, u], index[r, c]) < 0:
                    continue
                if chosen[index[v, u]] != chosen[index[r, c]]:
                    found[v, u] = True
    return found
