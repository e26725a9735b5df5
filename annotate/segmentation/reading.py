"""Beliefs about a person's points, read from the colours of a suit, from which labels are made."""

from dataclasses import dataclass

from annotate.array_types import Bool, Float64
from annotate.cloud.supervoxels import Supervoxels
from annotate.suit.color_model import ColorModel
from annotate.suit.palette import Suit


@dataclass(frozen=True)
class SuitReading:
    """Beliefs about a person's n points, those of a mask (h, w) in row-major order.

    groups: their G supervoxels. belief: (G, 11), probabilities of the parts. person_odds: (G,), log odds of
    being the person's at all, 0 = unknown. usable: bool (n,), points with a readable colour. evidence: (n,
    11), log likelihood of their colours, 0 elsewhere. model: the suit's colours in the frame's light.
    """

    suit: Suit
    mask: Bool
    groups: Supervoxels
    belief: Float64
    person_odds: Float64
    usable: Bool
    evidence: Float64
    model: ColorModel
