"""Crop of a depth image to the square around a person; network input of 212 x 212 pixels, depth in [0, 1]."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Index, UInt8, UInt16
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.rig.camera import Intrinsics

SIZE = 212  # px; side of the network's input (Nishi & Miura 2017, section 3.1)
RANGE_MM = 2000.0  # scaled to [0, 1] (same section); the person's median is moved to the middle
LEAST_VALUE = 1 / RANGE_MM  # of a person's pixel, because 0 is background
MARGIN = 0.04  # free border on each side, share of the person's larger extent; untuned


@dataclass(frozen=True)
class Crop:
    """Square of an image: top left corner (v, u), possibly outside the image, and side, in pixels."""

    top: int
    left: int
    side: int

    def cut(self, image: NDArray[Any], fill: int | float, size: int = SIZE) -> NDArray[Any]:
        """Return the square resampled to (size, size, ...) by nearest pixel; ``fill`` outside the image."""
        v, u = self.pixels(size)
        v_in, u_in = (v >= 0) & (v < image.shape[0]), (u >= 0) & (u < image.shape[1])
        result = np.full((size, size, *image.shape[2:]), fill, image.dtype)
        # Indices inside are one run, because they grow evenly.
        rows, columns = (
            slice(*np.flatnonzero(k)[[0, -1]] + (0, 1)) if k.any() else slice(0) for k in (v_in, u_in)
        )
        result[rows, columns] = image[v[rows]][:, u[columns]]
        return result

    def reads(self, shape: tuple[int, ...], size: int = SIZE) -> Bool:
        """Return flags (h, w), True for the image pixels that ``cut`` samples. shape: of the image."""
        v_read, u_read = np.zeros(shape[0], np.bool_), np.zeros(shape[1], np.bool_)
        for read, start in ((v_read, self.top), (u_read, self.left)):
            source = self._source(start, size)
            read[source[(source >= 0) & (source < len(read))]] = True
        return v_read[:, None] & u_read

    def pixels(self, size: int = SIZE) -> tuple[Index, Index]:
        """Return the image rows (size,) and columns (size,) that ``cut`` samples; some may lie outside the
        image.
        """
        return self._source(self.top, size), self._source(self.left, size)

    def _source(self, start: int, size: int) -> Index:
        return start + (np.arange(size) * self.side + self.side // 2) // size

    def paste(self, patch: NDArray[Any], shape: tuple[int, int], fill: int | float) -> NDArray[Any]:
        """Return an image (h, w, ...), ``fill`` outside the square, with a patch (size, size, ...) resampled
        into the square; inverse of ``cut``.
        """
        result = np.full((*shape, *patch.shape[2:]), fill, patch.dtype)
        (rows, row), (columns, column) = (
            self._within(start, length, patch.shape[0])
            for start, length in zip((self.top, self.left), shape, strict=True)
        )
        result[rows, columns] = patch[row][:, column]
        return result

    def _within(self, start: int, length: int, size: int) -> tuple[slice, Index]:
        """Return the slice of an image axis that the square covers, and the patch index of each pixel in it.

        start: first pixel of the square on this axis. length: pixels of the axis. size: side of the patch.
        """
        first, end = max(start, 0), max(0, start, min(start + self.side, length))
        return slice(first, end), ((np.arange(first, end) - start) * size + size // 2) // self.side

    def camera(self, camera: Intrinsics, size: int = SIZE) -> Intrinsics:
        """Return the pinhole camera of the square that ``cut`` returns. camera: undistorted, of the whole
        image.
        """
        scale = size / self.side
        cx, cy = ((c + 0.5) * scale - 0.5 for c in (camera.cx - self.left, camera.cy - self.top))
        return Intrinsics(size, size, camera.fx * scale, camera.fy * scale, cx, cy)


def crop_from_note(note: object, name: str) -> Crop:
    """Return the square in a frame's note ``name``: [top, left, side], integer pixels.

    Raises FormatError for a malformed note, and for a square far outside any image.
    """
    if (
        not isinstance(note, list)
        or [type(number) for number in note] != [int] * 3
        or not 0 < note[2] <= 2 * MAX_IMAGE_SIDE
        or max(map(abs, note)) > 2 * MAX_IMAGE_SIDE
    ):
        raise FormatError(
            f"field notes.{name} of the frame is malformed ({str(note)[:60]}); give [top, left, side], or "
            "label the frame again"
        )
    return Crop(*note)


def window_of(mask: Bool, margin_px: int = 0) -> tuple[slice, slice]:
    """Return the slices of rows and columns that bound a mask (h, w), with a margin; empty for an empty mask.

    Slices may pass the bottom and right of the image.
    """
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return slice(0, 0), slice(0, 0)
    top, left = (max(0, int(run[0]) - margin_px) for run in (rows, columns))
    return np.s_[top : int(rows[-1]) + margin_px + 1, left : int(columns[-1]) + margin_px + 1]


def crop_around(mask: Bool, margin: float = MARGIN) -> Crop:
    """Return the square around a person's mask (h, w). margin: free border on each side, share of the
    person's larger extent.

    Raises CloudError on an empty mask.
    """
    rows, columns = window_of(mask)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    if not height:
        raise CloudError("the frame shows no person; check the temperature window or the depth range")
    side = max(8, round(max(height, width) * (1 + 2 * margin)))
    return Crop(rows.start + height // 2 - side // 2, columns.start + width // 2 - side // 2, side)


def network_crop(mask: Bool) -> Crop:
    """Return the square around a person's mask (h, w) for a network; the whole image if it has the network's
    size.

    Raises CloudError on an empty mask.
    """
    return Crop(0, 0, SIZE) if mask.shape == (SIZE, SIZE) and mask.any() else crop_around(mask)


def normalize(depth_mm: UInt16, mask: Bool) -> Float32:
    """Scale depth uint16 (h, w) to float32 in [0, 1] on a person's mask, 0 elsewhere.

    The person's median depth becomes 0.5; the range spans ``RANGE_MM``.
    """
    person = mask & (depth_mm > 0)
    if not person.any():
        return np.zeros(depth_mm.shape, np.float32)
    middle = float(np.median(depth_mm[person]))
    scaled = (depth_mm.astype(np.float32) - (middle - RANGE_MM / 2)) / RANGE_MM
    return np.where(person, np.clip(scaled, LEAST_VALUE, 1), 0).astype(np.float32)


def person_of(parts: UInt8, scheme: Scheme = PAPER) -> Bool:
    """Return the mask (h, w) of the body's parts and of undefined pixels; things are not the person."""
    return scheme.on_person(parts)


def nearest_seen(seen: Bool) -> Index:
    """Return for each pixel (h, w) the flat index of the nearest True pixel of ``seen`` (h, w)."""
    if not seen.any():
        return np.arange(seen.size).reshape(seen.shape)
    import cv2  # here, because info and refusals do not need it

    _, label = cv2.distanceTransformWithLabels(
        (~seen).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    index = np.zeros(int(label.max()) + 1, np.intp)
    index[label[seen]] = np.flatnonzero(seen)
    return np.asarray(index[label])
