"""How a person's points were read from the colours of a suit: all that is known besides the labels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.cloud.supervoxels import Supervoxels
from annotate.suit.color_model import ColorModel
from annotate.suit.palette import Suit

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """How a person's n points, those of a mask (h, w) row-major, were read.

    groups: their supervoxels; belief: (G, 11) which parts these are; theirs: (G,) log odds of their being the
    person's at all, 0 where nothing tells. usable: (n,), which colours can be read; evidence: (n, 11) log
    likelihood of these, 0 elsewhere; model: the suit's colours in the frame's light.
    """

    suit: Suit
    mask: NDArray[np.bool_]
    groups: Supervoxels
    belief: _Array
    theirs: _Array
    usable: NDArray[np.bool_]
    evidence: _Array
    model: ColorModel
