"""Parts and confidence (h, w) of a frame's subject."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.labelset.images import Probabilities
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.suit.color_model import ColorModel


@dataclass(frozen=True)
class Segmentation:
    """Parts uint8 (h, w) over the depth image, and their confidence float32 (h, w), 0 outside the person.

    notes: for the reviewer. probabilities: of all classes, if they are to be stored. illuminant: the suit's
    colours in the frame's illuminant. bearing: joints, facing and posture, as the frame's note.
    """

    parts: UInt8
    confidence: Float32
    notes: tuple[str, ...] = ()
    probabilities: Probabilities | None = None
    illuminant: ColorModel | None = None
    bearing: dict[str, Any] | None = None


def unlabelled(mask: Bool, *notes: str) -> Segmentation:
    """Return undefined parts on a person's mask (bool (h, w)); notes: the reasons."""
    parts = np.where(mask, UNDEFINED, BACKGROUND).astype(np.uint8)
    return Segmentation(parts, np.zeros(mask.shape, np.float32), notes)
