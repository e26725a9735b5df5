"""Check that depth images are upright: in a room the floor in front is nearer than the wall behind it.

Turned upside down, and in disparity, which is large where depth is small, the lower part is the farther one.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.checks.depth_units import metres

UPSIDE_DOWN = "doubtful depth: the lower quarter"
"""First words of the note."""
FARTHER = 1.4
"""Times by which the lower quarter is farther than the upper one, in all images. Recordings that are upright
have 0.1 to 1.15 (rooms of four real cameras and of the virtual rig), turned ones 1.9. Untuned."""
FILLED = 0.25
"""Share of a quarter's pixels with a reading from which it is compared. Untuned."""


def upside_down(images: Sequence[NDArray[Any]], invalid: tuple[float, ...], unit_mm: float) -> list[str]:
    """Return a note where all of the images (h, w) that can be compared look upside down, else nothing."""
    pairs = [pair for image in images if (pair := _quarters(image, invalid)) is not None]
    if not pairs or min(lower / upper for upper, lower in pairs) < FARTHER:
        return []
    upper, lower = np.median(pairs, axis=0) * unit_mm / 1000
    return [
        f"{UPSIDE_DOWN} of the images is farther ({metres(lower)}) than the upper ({metres(upper)}): "
        "they are upside down (give --turn 180), or hold disparity"
    ]


def _quarters(image: NDArray[Any], invalid: tuple[float, ...]) -> tuple[float, float] | None:
    """Return the medians of the upper and the lower quarter of an image; None without enough readings."""
    rows = len(image) // 4
    medians = []
    for part in (image[:rows], image[len(image) - rows :]):
        with np.errstate(invalid="ignore"):
            good = part[np.isfinite(part) & (part > 0) & ~np.isin(part, invalid)]
        if not rows or good.size < FILLED * part.size:
            return None
        medians.append(float(np.median(good)))
    return medians[0], medians[1]
