"""Average of a network's outputs for an image and for its flip (docs/adr/0024).

Outputs: probabilities (B, K, h, w). From some networks also, as in ``NetworkOutput``: facing (B, 2), posture
(B, P) and joints (B, 15, 3). From newer ones also deviations (B, 15, 2) and visibility (B, 15, 3) of joints.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Index, UInt8
from annotate.scheme.scheme import BACKGROUND
from eval.architecture.kinds import Kinds
from eval.scores.joints import TWIN

PLANES, FACING, POSTURE, JOINTS = range(4)
CELL_OUTPUTS = ("cell_odds", "cell_left")
"""Further outputs, factors of the probabilities: odds of each kind of class, and the probability of left.
Their shapes are (B, 4 n, h / 2, w / 2) and (B, 4, h / 2, w / 2): of each, the 2 x 2 pixels of a cell."""


def flipped_back(outputs: list[Float32], twins: UInt8) -> list[Float32]:
    """Return outputs for flipped images as outputs for the images. twins: (K,), twin of each class."""
    back = [
        outputs[PLANES][:, twins, :, ::-1],
        *(facing * np.array([1, -1], np.float32) for facing in outputs[FACING:POSTURE]),
        *outputs[POSTURE:JOINTS],
        *(one[:, TWIN] for one in outputs[JOINTS:]),
    ]
    if len(back) > JOINTS:
        back[JOINTS] = np.array([1, 0, 0], np.float32) + back[JOINTS] * np.array([-1, 1, 1], np.float32)
    return back


def averaged(own: list[Float32], other: list[Float32], twins: UInt8) -> list[Float32]:
    """Return the means of two outputs for the same images.

    Sides are exchanged before, see ``agreeing``.
    """
    own, other = agreeing(own, other, twins)
    means = [a + b for a, b in zip(own, other, strict=True)]
    for mean in means:
        mean *= np.float32(0.5)
    return means


def agreeing(own: list[Float32], other: list[Float32], twins: UInt8) -> tuple[list[Float32], list[Float32]]:
    """Return two outputs for the same images that agree about left and right.

    Where the two disagree about left and right as a whole, the sides of the less sure facing are exchanged;
    if both are equally sure, the sides of ``other``.
    """
    if len(own) > JOINTS:
        apart = _disagree(own, other)
        surer = _length(other[FACING]) > _length(own[FACING])
        own = _exchanged(own, twins, apart & surer)
        other = _exchanged(other, twins, apart & ~surer)
    return own, other


def _disagree(own: list[Float32], other: list[Float32]) -> Bool:
    """Return True (B,) where facings are opposite and joints agree better with exchanged sides."""
    first, second = own[JOINTS], other[JOINTS]
    off, twin_off = (np.abs(first - one).sum(axis=(1, 2)) for one in (second, second[:, TWIN]))
    opposite = (own[FACING] * other[FACING]).sum(axis=1) < 0
    return np.asarray(opposite & (twin_off < off), np.bool_)


def _length(facing: Float32) -> Float32:
    return np.asarray(np.hypot(facing[:, 0], facing[:, 1]), np.float32)


def _exchanged(outputs: list[Float32], twins: UInt8, which: Bool) -> list[Float32]:
    """Return the outputs; the images ``which`` (B,) have left and right exchanged."""
    if not which.any():
        return outputs
    other = [
        outputs[PLANES][:, twins],
        -outputs[FACING],
        outputs[POSTURE],
        *(one[:, TWIN] for one in outputs[JOINTS:]),
    ]
    return [
        np.where(which.reshape(-1, *[1] * (one.ndim - 1)), new, one)
        for one, new in zip(outputs, other, strict=True)
    ]


def mean_of_factors(depth: Float32, outputs: Sequence[list[Float32]], kinds: Kinds) -> list[Float32]:
    """Return the mean outputs for an image, probabilities (1, K, h, w) first, as ``averaged`` does.

    depth: the image (h, w); a pixel without depth is background. outputs: ``CELL_OUTPUTS`` and the outputs
    about the body for the image, and for its flip if there are two. kinds: of the classes. Raises ValueError
    for outputs of other shapes.
    """
    count, weight = len(CELL_OUTPUTS), np.float32(1 / len(outputs))
    classes, body = _aligned([one[count:] for one in outputs], kinds)
    planes = np.zeros((len(kinds.sides), *depth.shape), np.float32)
    for i, (one, which) in enumerate(zip(outputs, classes, strict=True)):
        odds, left = (
            values.reshape(-1, 2, 2, *(side // 2 for side in depth.shape)) for values in one[:count]
        )
        if len(odds) != len(kinds) or len(left) != 1:
            raise ValueError(f"factors of {len(odds)} kinds instead of {len(kinds)}")
        of_class, sides = (np.array(values)[which] for values in (kinds.of_class, kinds.sides))
        _add_weighted(planes, _Factors(odds, left[0], of_class, sides, i > 0), depth, weight)
    return [planes[None], *body]


def _aligned(bodies: list[list[Float32]], kinds: Kinds) -> tuple[list[Index], list[Float32]]:
    """Return the class (K,) that each class of the image is in each image, and the mean outputs.

    bodies: outputs about the body for an image, and for its flip if there are two.
    """
    pairs = list(zip(kinds.of_class, kinds.sides, strict=True))
    twins = np.array([pairs.index((kind, -side)) for kind, side in pairs], np.uint8)
    if len(bodies) == 1:
        return [np.arange(len(twins))], bodies[0]
    # Classes in place of their probabilities are exchanged along with the sides.
    ids = np.arange(len(twins), dtype=np.float32).reshape(1, -1, 1, 1)
    own, other = agreeing([ids, *bodies[0]], flipped_back([ids, *bodies[1]], twins), twins)
    means = [(a + b) * np.float32(0.5) for a, b in zip(own[1:], other[1:], strict=True)]
    return [one[PLANES].ravel().astype(np.intp) for one in (own, other)], means


class _Factors(NamedTuple):
    """Factors of an image's probabilities: odds (n, 2, 2, h, w), probability of left (2, 2, h, w).

    kinds, sides: (K,), of each class. is_flipped: of a flipped image.
    """

    odds: Float32
    left: Float32
    kinds: Index
    sides: Index
    is_flipped: bool


@njit(cache=True, nogil=True)
def _add_weighted(planes: Float32, factors: _Factors, depth: Float32, weight: np.float32) -> None:
    """Add the weighted probabilities of an image to ``planes`` (K, 2 h, 2 w)."""
    odds, left, kinds, sides, is_flipped = factors
    count, _, _, height, width = odds.shape
    row, shares = np.empty((count, 2 * width), np.float32), np.empty((3, 2 * width), np.float32)
    total, empty = np.empty(2 * width, np.float32), np.empty(2 * width, np.float32)
    step, last = (-2, 2 * width - 1) if is_flipped else (2, 0)
    for v in range(2 * height):
        for right in range(2):
            first = last - right if is_flipped else right
            for k in range(count):
                for u in range(width):
                    row[k, first + step * u] = odds[k, v % 2, right, v // 2, u]
            for u in range(width):
                shares[1, first + step * u] = left[v % 2, right, v // 2, u]
        total[:] = row[0]
        for k in range(1, count):
            for u in range(2 * width):
                total[u] += row[k, u]
        for u in range(2 * width):
            seen = np.float32(depth[v, u] > 0) * weight
            shares[0, u], empty[u] = seen / total[u], weight - seen
            shares[1, u] *= shares[0, u]
            shares[2, u] = shares[0, u] - shares[1, u]
        for k in range(len(planes)):
            own, share = row[kinds[k]], shares[sides[k]]
            for u in range(2 * width):
                planes[k, v, u] += own[u] * share[u]
        for u in range(2 * width):
            planes[BACKGROUND, v, u] += empty[u]
