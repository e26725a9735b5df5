"""How a person's points were read from the colours of a suit: all that is known besides the labels."""

from dataclasses import dataclass

from annotate.array_types import Bool, Float64
from annotate.cloud.supervoxels import Supervoxels
from annotate.suit.color_model import ColorModel
from annotate.suit.palette import Suit


@dataclass(frozen=True)
class Reading:
    """How a person's n points, those of a mask (h, w) row-major, were read.

    groups: their supervoxels; belief: (G, 11) which parts these are; theirs: (G,) log odds of their being the
    person's at all, 0 where nothing tells. usable: (n,), which colours can be read; evidence: (n, 11) log
    likelihood of these, 0 elsewhere; model: the suit's colours in the frame's light.
    """

    suit: Suit
    mask: Bool
    groups: Supervoxels
    belief: Float64
    theirs: Float64
    usable: Bool
    evidence: Float64
    model: ColorModel
