"""One-channel PNG images as bytes, bounded and checked on the way in."""

from typing import Any
from zlib import crc32

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.limits import MAX_IMAGE_SIDE

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def png_shape(data: bytes, name: str) -> tuple[int, int]:
    """(height, width) from a PNG's header, before anything is allocated. Raises FormatError."""
    if len(data) < 33 or data[:8] != PNG_MAGIC:
        raise FormatError(f"{name} image is not a PNG or is cut off; restore it from a copy")
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if not (0 < width <= MAX_IMAGE_SIDE and 0 < height <= MAX_IMAGE_SIDE):
        raise FormatError(
            f"{name} PNG claims {width}x{height} pixels; at most {MAX_IMAGE_SIDE} a side are read"
        )
    return height, width


def check_chunks(data: bytes, name: str) -> None:
    """Whether every chunk of a PNG lies within it and has the sum of its bytes that stands behind it.

    OpenCV allocates, and clears, what a chunk claims to hold, and libpng tells stderr of a wrong CRC.
    Only the first chunk may say the size (``png_shape``): Pillow obeys the last one that does.
    Raises FormatError.
    """
    view, offset, last, whole = memoryview(data), 8, b"", True
    while offset + 12 <= len(data) and last != b"IEND" and whole:
        end = offset + 12 + int.from_bytes(view[offset : offset + 4], "big")
        last = data[offset + 4 : offset + 8]
        whole = (
            end <= len(data)
            and (last == b"IHDR") == (offset == 8)
            and crc32(view[offset + 4 : end - 4]) == int.from_bytes(view[end - 4 : end])
        )
        offset = end
    if last != b"IEND" or not whole:
        raise FormatError(
            f"{name} PNG is cut off or corrupt: it holds nothing readable; restore it from a copy"
        )


def decode_grey(data: bytes, dtype: type[Any], name: str) -> NDArray[Any]:
    """Greyscale PNG of exactly ``dtype`` (uint8 or uint16) -> (h, w). Raises FormatError."""
    png_shape(data, name)
    check_chunks(data, name)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != dtype:
        found = "nothing readable" if image is None else f"{image.dtype} {image.shape}"
        raise FormatError(f"{name} PNG holds {found}; give one channel of {dtype.__name__}")
    return np.asarray(image, dtype)
