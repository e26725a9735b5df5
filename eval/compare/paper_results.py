"""Confusion matrices published in the paper, indexed by part id: background is first, in the paper last.

Source: Nishi and Miura, Pattern Recognition 71 (2017), doi 10.1016/j.patcog.2017.06.006, Tables 2 and 3. Rows
are shares of the true part, rounded to two decimals.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64
from annotate.parts import PAPER
from annotate.scheme.scheme import BACKGROUND_PART, Scheme

CITATION = "Nishi & Miura, Pattern Recognition 71 (2017), doi:10.1016/j.patcog.2017.06.006"


PARTS = (BACKGROUND_PART, *PAPER.parts)
"""Parts in the order of the tables' rows and columns."""


class Reported(NamedTuple):
    """Published confusion matrix, float64 (12, 12), with numbers of frames and people; None: not printed."""

    title: str
    table: Float64
    frames: int
    people: int | None

    @property
    def mean_recall(self) -> float:
        """Mean of the diagonal over the body parts."""
        return float(np.diagonal(self.table)[1:].mean())


def _by_part_id(percent: str) -> Float64:
    printed = np.array(percent.split(), np.float64).reshape(12, 12) / 100
    table = np.roll(printed, 1, axis=(0, 1))
    table.setflags(write=False)
    return table


_TABLE2 = _by_part_id("""
  92   4   0   0   0   0   0   0   0   0   0   4
   0  95   1   2   0   0   1   0   0   0   0   1
   0  10  83   0   2   0   0   0   0   0   0   5
   0   8   0  86   0   3   0   0   0   0   0   3
   0   1   9   1  70   7   1   1   0   0   0  10
   0   0   0  10   3  79   0   0   1   0   0   7
   0  12   0   2   1   0  81   1   2   0   0   1
   0   0   0   0   0   0   4  91   0   3   0   2
   0   0   0   0   0   0   2   1  88   0   4   5
   0   0   0   0   0   0   0   2   0  92   1   5
   0   0   0   0   0   0   0   0   2   1  93   4
   0   0   0   0   0   0   0   0   0   0   0 100
""")
_TABLE3 = _by_part_id("""
  69  22   5   0   1   0   0   0   0   0   0   3
   0  83   5   6   0   0   3   0   0   0   0   3
   0   9  74   0  10   0   0   0   0   0   0   7
   0   6   0  80   0  10   0   0   0   0   0   4
   2   3  14   0  59   1   1   5   0   5   0  10
   1   2   1  11   4  65   1   0   7   0   3   5
   0  25   0   0   3   2  65   1   2   0   0   2
   0   0   0   0   6   0  16  66   2   5   0   5
   0   0   0   0   0   2  16   2  71   0   6   3
   0   0   0   0   2   0   0   3   0  86   2   7
   0   0   0   0   0   1   0   0   4   1  87   7
   0   0   0   0   0   0   0   0   0   0   0 100
""")
SYNTHETIC = Reported("Paper, synthetic", _TABLE2, 4984, None)
REAL = Reported("Paper, real", _TABLE3, 145, 8)
SECONDS_PER_FRAME = 60.0  # of a manual correction (section 4.2.1)


def published(schemes: Iterable[Scheme]) -> tuple[Reported, ...]:
    """Return the published results beside results of these schemes; empty without scheme ``paper``."""
    return (SYNTHETIC, REAL) if PAPER in schemes else ()
