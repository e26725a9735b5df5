"""One-channel images of other kinds than PNG: TIFF, PGM and NumPy arrays, whole numbers or floats.

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

SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".npy")
KINDS = ("uint16", "int32", "float32")
NPY_MAGIC = b"\x93NUMPY"
_FORMATS = ("JPEG", "PNG", "TIFF", "PPM")


def image_shape(data: bytes, name: str) -> tuple[int, int]:
    """Return (height, width) by the header of a PNG, JPEG, TIFF or PGM. Raises FormatError."""
    if data.startswith(PNG_MAGIC):
        return png_shape(data, name)
    if data.startswith(NPY_MAGIC):
        height, width = _array(data, name).shape
        return height, width
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=_FORMATS) as file:
            width, height = file.size
            pages = getattr(file, "n_frames", 1)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        if name.lower().endswith(".png"):
            return png_shape(data, name)
        raise FormatError(
            f"{name} cannot be read: it is no image, cut off, or of another kind; convert it to a 16-bit PNG"
        ) from error
    if pages != 1:
        raise FormatError(f"{name} holds {pages} images; store every image in a file of its own")
    if max(width, height) > MAX_IMAGE_SIDE:
        raise FormatError(f"{name} claims {width}x{height} pixels; give at most {MAX_IMAGE_SIDE} a side")
    return height, width


def decode_depth(data: bytes, name: str) -> NDArray[Any]:
    """Return pixels (h, w) of a PNG, TIFF, PGM or NumPy array of one channel. Raises FormatError."""
    if data.startswith(PNG_MAGIC) or name.lower().endswith(".png"):
        return decode_grey(data, np.uint16, name)
    if data.startswith(NPY_MAGIC):
        return _array(data, name)
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


def _array(data: bytes, name: str) -> NDArray[Any]:
    """Return the array (h, w), without axes of length 1, of a .npy file; nothing in it is executed."""
    file = io.BytesIO(data)
    try:
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[np.lib.format.read_magic(file)]
        shape, by_columns, kind = read_header(file)
    except (ValueError, KeyError, EOFError) as error:
        raise FormatError(f"{name} holds no plain array; save it with numpy.save") from error
    sides = tuple(side for side in shape if side != 1)
    if len(sides) != 2 or kind.kind not in "iuf" or max(sides) > MAX_IMAGE_SIDE:
        raise FormatError(f"{name} holds {kind} {shape}; give one image (h, w) of whole numbers or floats")
    if sides[0] * sides[1] * kind.itemsize != len(data) - file.tell():
        raise FormatError(f"{name} is cut off; restore it from a copy")
    return np.frombuffer(data, kind, offset=file.tell()).reshape(sides, order="F" if by_columns else "C")
