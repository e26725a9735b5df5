"""Agreement of labels with a truth: share of right pixels, with a tolerance at borders."""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Int64, UInt8
from annotate.scheme.scheme import BACKGROUND, UNDEFINED

Box = tuple[slice, slice]
EVERYWHERE: Box = np.s_[:, :]


class Agreement:
    """Comparison of labels with a truth, pixel by pixel.

    Pixels count where truth or labels name a part, unless the truth is undefined there. A pixel is right
    where both are equal. A pixel is also right beside a border: within ``tolerance_px`` (Chebyshev) the truth
    has the labelled part and the labels have the true part. Therefore a part that the labels lack is wrong,
    however thin. truth: uint8 (h, w). valid: bool (h, w), pixels with depth; only these count as neighbours.
    """

    def __init__(self, truth: UInt8, valid: Bool, tolerance_px: int = 0) -> None:
        self.truth, self._valid, self._reach_px = truth, valid, tolerance_px
        present = np.unique(truth[truth != UNDEFINED]).tolist()
        # The last plane is for labels that the truth lacks.
        self._plane = np.full(256, len(present), np.uint8)
        self._plane[present] = range(len(present))
        self._beside = np.zeros((len(present) + 1, *truth.shape), np.bool_)
        for part in present:
            self._beside[self._plane[part]] = self._dilated(valid & (truth == part))

    def wrong(self, parts: UInt8, box: Box = EVERYWHERE) -> Bool:
        """Return the mask of the wrong pixels of labels (h, w). box: part of the image that is returned."""
        truth, labels = self.truth[box], parts[box]
        wrong: Bool = self._counted(parts, box) & (labels != truth)
        if not self._reach_px or not wrong.any():
            return wrong
        v, u = np.nonzero(wrong)
        given, true = self._plane[labels[v, u]], truth[v, u]
        right = self._beside[:, *box][given, v, u]
        for part in np.unique(true[right]).tolist():
            own = np.flatnonzero(right & (true == part))
            beside = self._dilated(self._valid[box] & (labels == part))
            right[own] = beside[v[own], u[own]]
        wrong[v, u] = ~right
        return wrong

    def gains(self, before: UInt8, pixels: Int64, after: UInt8) -> NDArray[np.int8]:
        """Return the gain (h, w) of a change: 1 where labels become right, -1 where wrong, else 0.

        before: labels (h, w). pixels, after: flat indices (n,) and the parts (n,) that the change gives.
        """
        gains = np.zeros(before.shape, np.int8)
        if pixels.size:
            box, changed = self._around(pixels), before.copy()
            changed.ravel()[pixels] = after
            gains[box] = self.wrong(before, box).astype(np.int8) - self.wrong(changed, box)
        return gains

    def counted(self, parts: UInt8) -> int:
        """Return the number of pixels that count for labels (h, w)."""
        return int(self._counted(parts, EVERYWHERE).sum())

    def of(self, parts: UInt8) -> float:
        """Return the share of counted pixels of labels (h, w) that are right; 1 where nothing counts."""
        counted = self.counted(parts)
        return 1.0 - int(self.wrong(parts).sum()) / counted if counted else 1.0

    def _counted(self, parts: UInt8, box: Box) -> Bool:
        truth, labels = self.truth[box], parts[box]
        named = (labels != BACKGROUND) & (labels != UNDEFINED)
        return np.asarray((truth != UNDEFINED) & ((truth != BACKGROUND) | named))

    def _dilated(self, mask: Bool) -> Bool:
        size = 2 * self._reach_px + 1
        return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)

    def _around(self, pixels: Int64) -> Box:
        """Return the box of all pixels that a change of ``pixels`` (flat indices) can make right or wrong.

        The box includes the neighbours on which their correctness depends.
        """
        v, u = np.divmod(pixels, self.truth.shape[1])
        margin = 2 * self._reach_px
        top, left = max(0, int(v.min()) - margin), max(0, int(u.min()) - margin)
        return np.s_[top : int(v.max()) + margin + 1, left : int(u.max()) + margin + 1]
