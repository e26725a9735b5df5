"""Do labels and a network err at the same places? Overlap of the errors of two label sets of one recording.

python -m tools.measure.overlap LABELS PREDICTED TRUTH

Prints the shares of wrong pixels, the share wrong in both over what independent errors would give (1), and
how many of the first one's errors the second one makes too, by the same wrong part; with and without seams.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from annotate.labelset.label_set import LabelSet
from annotate.parts import BACKGROUND, UNDEFINED

SEAM_PX = 2
"""Pixels to another part, or to the outline, that count as a seam: the tolerance of agreement."""


def named(parts: np.ndarray) -> np.ndarray:
    """Flags (h, w) of the pixels that have a part."""
    return (parts != BACKGROUND) & (parts != UNDEFINED)


def errors(labels: LabelSet, predicted: LabelSet, truth: LabelSet, *, seams: bool) -> np.ndarray:
    """Numbers of pixels: named by all three; wrong in labels, in prediction, in both, in both alike."""
    window, total = np.ones((2 * SEAM_PX + 1,) * 2, np.uint8), np.zeros(5, np.int64)
    for frame in truth:
        true = frame.parts
        one, other = (each.read(frame.frame_id).parts for each in (labels, predicted))
        counted = named(true) & named(one) & named(other)
        if not seams:
            counted &= cv2.erode(true, window) == cv2.dilate(true, window)
        wrong, too = (one != true)[counted], (other != true)[counted]
        same = wrong & too & (one == other)[counted]
        total += [counted.sum(), wrong.sum(), too.sum(), (wrong & too).sum(), same.sum()]
    return total


def row(heading: str, counts: np.ndarray) -> str:
    """A line of the table."""
    pixels, wrong, too, both, same = (float(count) for count in counts)
    lift = both * pixels / max(wrong * too, 1)
    shares = f"{100 * wrong / pixels:.2f} | {100 * too / pixels:.2f} | {100 * both / pixels:.2f}"
    return f"| {heading} | {shares} | {lift:.1f} | {100 * same / max(wrong, 1):.0f} |"


if __name__ == "__main__":
    sets = [LabelSet.open(Path(name)) for name in sys.argv[1:]]
    print("| | labels wrong, % | network wrong, % | both, % | over chance | same wrong part, % |")
    print("|---|---:|---:|---:|---:|---:|")
    print(row("all pixels", errors(*sets, seams=True)))
    print(row(f"{SEAM_PX} px off the seams", errors(*sets, seams=False)))
