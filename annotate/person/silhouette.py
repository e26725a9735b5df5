"""Evidence per pixel -> a smooth decision: neighbours on one surface and of one colour agree.

A binary Markov field over the candidate pixels, solved by mean field (Kraehenbuehl & Koltun 2011, with
sparse neighbours). A link is strong between pixels without a step, a crease or a colour edge between
them, so that the border settles on those.
"""

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Int64, UInt8
from annotate.cloud.grid import JUMP

OFFSETS = np.array([(0, 1), (1, -1), (1, 0), (1, 1), (0, 2), (2, 0), (2, 1), (2, -1)])
"""(v, u) to the neighbours that come later; some two apart, to bridge pixels without a reading."""
REACH = int(np.abs(OFFSETS).max())
STEP = 0.6 * JUMP
"""Depth step, as a share of the depth, that weakens a link to 1/e."""
CREASE = 0.08
"""1 - cosine between normals that does so: 23 degrees."""
EDGE_LAB = 18.0
"""Standard deviation of 8-bit CIE Lab distances within one material, folds and noise included."""
COUPLING = 1.2
"""Log odds that a wholly certain neighbour over a full link is worth."""
ROUNDS = 6
KEPT = 0.3
"""Share of the old belief kept in a round, so that it settles."""


def settle(evidence: Float32, candidates: Bool, depth_m: Float32, normals: Float32, lab: UInt8) -> Float32:
    """Log odds (h, w) of every pixel -> belief (h, w) in [-1, 1], positive = person; -1 off the candidates.

    depth_m (h, w): positive on the candidates. normals (h, w, 3): unit, NaN = unknown.
    lab: uint8 (h, w, 3), its first channel 0 = no colour there.
    """
    return Links(candidates, depth_m, normals, lab).settle(evidence)


class Links:
    """What joins the candidates (h, w) of a frame; arguments as of ``settle``.

    For evidence that is settled more than once on the same surface.
    """

    def __init__(self, candidates: Bool, depth_m: Float32, normals: Float32, lab: UInt8) -> None:
        left, top, width, height = cv2.boundingRect(candidates.astype(np.uint8))
        self._box = np.s_[top : top + height, left : left + width]
        self._candidates = np.pad(candidates[self._box], REACH)  # so that no neighbour is off the image
        depth_m, normals = (np.ascontiguousarray(plane[self._box]) for plane in (depth_m, normals))
        self._strength = _links(
            self._candidates, depth_m, normals, np.ascontiguousarray(lab[self._box]), OFFSETS
        )

    def settle(self, evidence: Float32) -> Float32:
        """Log odds (h, w) -> belief (h, w) in [-1, 1]; -1 off the candidates."""
        belief = np.full(evidence.shape, np.float32(-1))
        odds = np.where(self._candidates, np.pad(evidence[self._box], REACH), 0).astype(np.float32)
        settled = _mean_field(odds, self._strength, OFFSETS)[REACH:-REACH, REACH:-REACH]
        belief[self._box] = np.where(self._candidates[REACH:-REACH, REACH:-REACH], settled, np.float32(-1))
        return belief


@njit(cache=True, nogil=True)
def _links(candidates: Bool, depth_m: Float32, normals: Float32, lab: UInt8, offsets: Int64) -> Float32:
    """How strongly each pixel is linked to that at each offset, (8, h, w); 0 = not at all.

    candidates: with a border of ``REACH`` around all, as the result has it; the others: without.
    """
    height, width = candidates.shape
    strength = np.zeros((offsets.shape[0], height, width), np.float32)
    for v in range(height - 2 * REACH):
        for u in range(width - 2 * REACH):
            if not candidates[v + REACH, u + REACH]:
                continue
            for k in range(offsets.shape[0]):
                r, c = v + offsets[k, 0], u + offsets[k, 1]
                if not candidates[r + REACH, c + REACH]:
                    continue
                step = abs(depth_m[v, u] - depth_m[r, c]) / min(depth_m[v, u], depth_m[r, c])
                if step > JUMP:
                    continue
                cost = (step / STEP) ** 2
                cosine = np.float32(0)
                for axis in range(3):
                    cosine += normals[v, u, axis] * normals[r, c, axis]
                if cosine == cosine:
                    cost += (1 - cosine) / CREASE
                if lab[v, u, 0] > 0 and lab[r, c, 0] > 0:
                    square = 0.0
                    for channel in range(3):
                        square += (np.float64(lab[v, u, channel]) - np.float64(lab[r, c, channel])) ** 2
                    cost += square / (2 * EDGE_LAB**2)
                strength[k, v + REACH, u + REACH] = np.exp(-cost)
    return strength


@njit(cache=True, nogil=True)
def _tanh(x: Float32) -> Float32:
    """The hyperbolic tangent to 0.02, by its continued fraction cut where it reaches 1: ten times as fast."""
    y = np.minimum(np.maximum(x, np.float32(-3)), np.float32(3))
    return y * (np.float32(27) + y * y) / (np.float32(27) + np.float32(9) * y * y)


@njit(cache=True, nogil=True)
def _mean_field(evidence: Float32, strength: Float32, offsets: Int64) -> Float32:
    """Belief (h, w) by evidence (h, w), 0 off the candidates; strength: (8, h, w) as ``_links`` gives it."""
    height, width = evidence.shape
    inner = width - 2 * REACH
    belief = _tanh(np.float32(0.5) * evidence)
    for _ in range(ROUNDS):
        heard = np.zeros_like(evidence)
        for v in range(REACH, height - REACH):
            for k in range(offsets.shape[0]):
                r, c = v + offsets[k, 0], REACH + offsets[k, 1]
                link = strength[k, v, REACH : REACH + inner]
                here, there = belief[v, REACH : REACH + inner], belief[r, c : c + inner]
                hears, heeds = heard[v, REACH : REACH + inner], heard[r, c : c + inner]
                for i in range(inner):
                    hears[i] += link[i] * there[i]
                for i in range(inner):
                    heeds[i] += link[i] * here[i]
        now = _tanh(np.float32(0.5) * (evidence + np.float32(COUPLING) * heard))
        belief = np.float32(KEPT) * belief + np.float32(1 - KEPT) * now
    return belief
