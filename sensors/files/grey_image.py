"""One-channel images of other kinds than PNG: TIFF and PGM, whole numbers of 16 bits or floats of 32.

Sides are bounded by the header before pixels are unpacked. EXR is not read, because OpenCV's own decoder for
EXR is switched off for its security (OpenCV, ``OPENCV_IO_ENABLE_OPENEXR``).
"""

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.png import PNG_MAGIC, decode_grey, png_shape

SUFFIXES = (".png", ".tif", ".tiff", ".pgm")
KINDS = ("uint16", "float32")
_FORMATS = ("JPEG", "PNG", "TIFF", "PPM")


def image_shape(data: bytes, name: str) -> tuple[int, int]:
    """Return (height, width) by the header of a PNG, JPEG, TIFF or PGM. Raises FormatError."""
    if data.startswith(PNG_MAGIC):
        return png_shape(data, name)
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=_FORMATS) as file:
            width, height = file.size
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        if name.lower().endswith(".png"):
            return png_shape(data, name)
        raise FormatError(f"{name} is no image or is cut off; restore it from a copy") from error
    if max(width, height) > MAX_IMAGE_SIDE:
        raise FormatError(f"{name} claims {width}x{height} pixels; give at most {MAX_IMAGE_SIDE} a side")
    return height, width


def decode_depth(data: bytes, name: str) -> NDArray[Any]:
    """Return pixels (h, w), uint16 or float32, of a PNG, TIFF or PGM of one channel. Raises FormatError."""
    if data.startswith(PNG_MAGIC) or name.lower().endswith(".png"):
        return decode_grey(data, np.uint16, name)
    shape = image_shape(data, name)
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise FormatError(f"{name} cannot be decoded; restore it from a copy, or convert it to a 16-bit PNG")
    if image.shape != shape or image.dtype.name not in KINDS:
        raise FormatError(
            f"{name} holds {image.dtype} {image.shape}; give one channel of {' or '.join(KINDS)}"
        )
    return np.asarray(image)
