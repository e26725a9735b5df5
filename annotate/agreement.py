"""How far labels agree with a truth: the share of pixels right, strictly or with a tolerance at borders."""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED


class Agreement:
    """A truth, to which labels are compared pixel by pixel.

    Counted are the pixels where truth or labels name a part; those undefined in the truth are left out.
    truth: uint8 (h, w). valid: bool (h, w), pixels with a depth reading. tolerance_px: a label is right
    too where the truth has it within so many pixels along rows and columns (Chebyshev), as for boundary F;
    of pixels without a reading the truth knows nothing, or a dropout would excuse a missing face.
    """

    def __init__(self, truth: NDArray[np.uint8], valid: NDArray[np.bool_], tolerance_px: int = 0) -> None:
        self.truth = truth
        self._defined = truth.ravel() != UNDEFINED
        self._named = self._defined & (truth.ravel() != BACKGROUND)
        around = np.ones((2 * tolerance_px + 1, 2 * tolerance_px + 1), np.uint8)
        self._right = np.zeros((N_CLASSES + 1, truth.size), np.bool_)
        for part in range(N_CLASSES):
            self._right[part] = cv2.dilate((valid & (truth == part)).astype(np.uint8), around).ravel() > 0
            self._right[part] |= truth.ravel() == part

    def wrong_at(self, pixels: NDArray[np.int64], parts: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which of the flat ``pixels`` (n,) are counted and wrong when they have these ``parts`` (n,)."""
        right = self._right[np.minimum(parts, N_CLASSES), pixels]
        return np.asarray(self._counted(pixels, parts) & ~right)

    def wrong(self, parts: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which pixels (h, w) of labels (h, w) are counted and wrong."""
        return self.wrong_at(np.arange(parts.size), parts.ravel()).reshape(parts.shape)

    def gains(
        self, before: NDArray[np.uint8], pixels: NDArray[np.int64], after: NDArray[np.uint8]
    ) -> NDArray[np.int64]:
        """For each flat pixel (n,) 1 where the parts ``after`` (n,) put it right, -1 where wrong, else 0.

        before: the labels (h, w).
        """
        was_wrong = self.wrong_at(pixels, before.ravel()[pixels])
        return was_wrong.astype(np.int64) - self.wrong_at(pixels, after)

    def counted(self, parts: NDArray[np.uint8]) -> int:
        """Number of pixels that count for these labels (h, w)."""
        return int(self._counted(np.arange(parts.size), parts.ravel()).sum())

    def of(self, parts: NDArray[np.uint8]) -> float:
        """Share of the counted pixels of labels (h, w) that are right; 1 where nothing counts."""
        counted = self.counted(parts)
        return 1.0 - int(self.wrong(parts).sum()) / counted if counted else 1.0

    def _counted(self, pixels: NDArray[np.int64], parts: NDArray[np.uint8]) -> NDArray[np.bool_]:
        named = (parts != BACKGROUND) & (parts != UNDEFINED)
        return np.asarray(self._named[pixels] | named & self._defined[pixels])
