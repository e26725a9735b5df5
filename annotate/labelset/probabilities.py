"""Class probabilities of a person's crop: eight bits each, as one tall greyscale PNG of twelve planes."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from annotate.array_types import Float32
from annotate.crop import SIZE, Crop, crop_from_note
from annotate.labelset.images import encode_png
from annotate.parts import N_CLASSES
from sensors.errors import FormatError
from sensors.files.png import decode_grey, png_shape

NOTE = "probability_crop"
"""Name of the note with the crop's place in the frame: [top, left, side], pixels."""


@dataclass(frozen=True)
class Probabilities:
    """Class probabilities of a crop. crop: where it lies in the depth image.

    planes: float32 (12, 212, 212), by part id, adding up to one at every pixel.
    """

    crop: Crop
    planes: Float32

    def note(self) -> dict[str, list[int]]:
        """Where the crop lies, for the frame's notes."""
        return {NOTE: [self.crop.top, self.crop.left, self.crop.side]}


def encode_probabilities(probabilities: Probabilities) -> bytes:
    """The planes below each other, in steps of 1/255, as a greyscale PNG (12 * 212, 212).

    Nearly all values are 0 or 255. Measured: plain runs take 1 ms and 12 kB a frame, differences 1.3 ms and
    16 kB.
    """
    tall = np.rint(np.clip(probabilities.planes, 0, 1) * 255).astype(np.uint8).reshape(-1, SIZE)
    return encode_png(tall, cv2.IMWRITE_PNG_FILTER_NONE)


def decode_probabilities(data: bytes, notes: dict[str, Any]) -> Probabilities:
    """Inverse of ``encode_probabilities`` but for rounding; notes: the frame's. Raises FormatError."""
    if png_shape(data, "probability") != (N_CLASSES * SIZE, SIZE):
        raise FormatError(f"probability PNG is not {N_CLASSES * SIZE} x {SIZE} pixels; predict again")
    stored = decode_grey(data, np.uint8, "probability").reshape(N_CLASSES, SIZE, SIZE)
    total = stored.sum(axis=0, dtype=np.int64)
    # Each of the twelve was rounded by half a step at most.
    if np.abs(total - 255).max() > N_CLASSES / 2:
        raise FormatError("probabilities do not add up to one; restore the PNG or predict again")
    return Probabilities(crop_from_note(notes.get(NOTE), NOTE), (stored / total).astype(np.float32))
