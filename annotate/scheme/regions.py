"""Atlas: the finest regions of the body. Every scheme's parts of the body are unions of regions.

The regions refine the paper's eleven parts, and are SMPL's 24 segments. Left and right are the person's own.
"""

import itertools
from enum import IntEnum

import numpy as np

from annotate.array_types import UInt8


class Region(IntEnum):
    """Region of the body by its id in label images and networks; 0 = background."""

    HEAD = 1
    NECK = 2
    CHEST = 3
    BELLY = 4
    LOWER_BELLY = 5
    HIP = 6
    LEFT_SHOULDER = 7
    RIGHT_SHOULDER = 8
    LEFT_UPPER_ARM = 9
    RIGHT_UPPER_ARM = 10
    LEFT_FOREARM = 11
    RIGHT_FOREARM = 12
    LEFT_HAND = 13
    RIGHT_HAND = 14
    LEFT_FINGERS = 15
    RIGHT_FINGERS = 16
    LEFT_UPPER_LEG = 17
    RIGHT_UPPER_LEG = 18
    LEFT_LOWER_LEG = 19
    RIGHT_LOWER_LEG = 20
    LEFT_FOOT = 21
    RIGHT_FOOT = 22
    LEFT_TOES = 23
    RIGHT_TOES = 24

    @property
    def label(self) -> str:
        """Return the name in scheme files, such as ``left_hand``."""
        return self.name.lower()

    @property
    def twin(self) -> "Region":
        """Return the region on the other side; a region in the middle is its own twin."""
        side, _, rest = self.name.partition("_")
        other = {"LEFT": "RIGHT", "RIGHT": "LEFT"}.get(side)
        return Region[f"{other}_{rest}"] if other else self

    @staticmethod
    def on(side: str, name: str) -> "Region":
        """Return the region of a side ("left", "right") by its name without side, such as ``hand``."""
        return Region[f"{side}_{name}".upper()]


N_REGIONS = len(Region)

_CHAINS = (
    ("HEAD", "NECK", "CHEST", "BELLY", "LOWER_BELLY", "HIP"),
    *(
        chain
        for side in ("LEFT", "RIGHT")
        for chain in (
            (
                "CHEST",
                f"{side}_SHOULDER",
                f"{side}_UPPER_ARM",
                f"{side}_FOREARM",
                f"{side}_HAND",
                f"{side}_FINGERS",
            ),
            ("HIP", f"{side}_UPPER_LEG", f"{side}_LOWER_LEG", f"{side}_FOOT", f"{side}_TOES"),
            ("NECK", f"{side}_SHOULDER"),
        )
    ),
)
REGION_NEIGHBOURS = frozenset(
    frozenset((Region[a], Region[b])) for chain in _CHAINS for a, b in itertools.pairwise(chain)
)
"""Pairs of regions joined by anatomy."""


def swap_regions(regions: UInt8) -> UInt8:
    """Exchange left and right in region ids uint8 of any shape; other ids stay."""
    table = np.arange(256, dtype=np.uint8)
    for region in Region:
        table[region] = region.twin
    return table[regions]
