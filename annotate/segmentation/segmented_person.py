"""Parts and confidence (h, w) of a frame's subject."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.labelset.images import Probabilities
from annotate.parts import PAPER
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from annotate.suit.color_model import ColorModel


@dataclass(frozen=True)
class Segmentation:
    """Parts uint8 (h, w) over the depth image, and their confidence float32 (h, w), 0 outside the person.

    notes: for the reviewer. probabilities: of all classes, if they are to be stored. illuminant: the suit's
    colours in the frame's illuminant. bearing: joints, facing and posture, as the frame's note.
    scheme: of the parts.
    """

    parts: UInt8
    confidence: Float32
    notes: tuple[str, ...] = ()
    probabilities: Probabilities | None = None
    illuminant: ColorModel | None = None
    bearing: dict[str, Any] | None = None
    scheme: Scheme = PAPER


def unlabelled(mask: Bool, *notes: str, scheme: Scheme = PAPER) -> Segmentation:
    """Return undefined parts on a person's mask (bool (h, w)). notes: the reasons. scheme: of the labels."""
    parts = np.where(mask, UNDEFINED, BACKGROUND).astype(np.uint8)
    return Segmentation(parts, np.zeros(mask.shape, np.float32), notes, scheme=scheme)
