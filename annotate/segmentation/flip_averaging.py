"""A frame read twice: as it is, and as a mirror shows it (docs/adr/0026)."""

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.parts import N_CLASSES, TWIN_PARTS, swap_left_right
from annotate.segmentation.input_channels import CHANNELS, Rectangle
from annotate.segmentation.suit_network import Reader


def mirrored(planes: UInt8) -> UInt8:
    """Channels (24, h, w) in a mirror: left parts are right ones, in the labels before and likenesses too."""
    turned = planes[:, :, ::-1].copy()
    before, of_parts = CHANNELS.index("before"), slice(1 - N_CLASSES, None)
    turned[before] = swap_left_right(turned[before])
    turned[of_parts] = turned[of_parts][TWIN_PARTS[1:] - 1]
    return turned


def read_twice(reader: Reader, planes: UInt8, step: int, near: Rectangle) -> Float32:
    """Mean of a reader's probabilities for channels and for their mirror image; arguments as it has them."""
    # What is around is seen in every step-th column, which the mirror has to keep.
    if more := (1 - planes.shape[2]) % step:
        planes = np.pad(planes, ((0, 0), (0, 0), (0, more)))
    left, right = (planes.shape[2] - end for end in (near.columns.stop, near.columns.start))
    there = Rectangle(near.rows, slice(left, right))
    other = reader.probabilities(mirrored(planes), step, there)[np.append(TWIN_PARTS, N_CLASSES), :, ::-1]
    return np.float32(0.5) * (reader.probabilities(planes, step, near) + other)
