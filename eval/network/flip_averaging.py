"""Average of a network's outputs for an image and for its flip (docs/adr/0024).

Outputs: probabilities (B, K, h, w). From some networks also, as in ``NetworkOutput``: facing (B, 2), posture
(B, P) and joints (B, 15, 3). From newer ones also deviations (B, 15, 2) and visibility (B, 15, 3) of joints.
"""

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from eval.scores.joints import TWIN

PLANES, FACING, POSTURE, JOINTS = range(4)


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

    Where the two disagree about left and right as a whole, the sides of the less sure facing are exchanged
    before; if both are equally sure, the sides of ``other``.
    """
    if len(own) > JOINTS:
        apart = _disagree(own, other)
        surer = _length(other[FACING]) > _length(own[FACING])
        own = _exchanged(own, twins, apart & surer)
        other = _exchanged(other, twins, apart & ~surer)
    means = [a + b for a, b in zip(own, other, strict=True)]
    for mean in means:
        mean *= np.float32(0.5)
    return means


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
