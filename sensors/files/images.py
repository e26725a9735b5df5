"""Images as bytes: sizes are read from headers before pixels are unpacked; one-channel images are decoded.

Supported formats are PNG, TIFF, PGM and NumPy arrays. EXR is not, because OpenCV switches its own decoder for
EXR off for security (``OPENCV_IO_ENABLE_OPENEXR``).
"""

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE

JPEG_MAGIC, PNG_MAGIC, NPY_MAGIC = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"\x93NUMPY"
SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".npy")
KINDS = ("uint16", "int32", "float32")
_ENDS = {True: b"\xff\xd9", False: b"IEND"}  # last marker of a JPEG (T.81, B.1), last chunk of a PNG
_PADDING_BYTES = 4096  # bytes behind the last marker that some cameras add; untuned


def _header(data: bytes, *formats: str) -> tuple[int, int, int]:
    """Return width, height and number of pages by Pillow. Raises FormatError."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data), formats=formats) as file:
            return *file.size, getattr(file, "n_frames", 1)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FormatError(str(error)) from error


def encoded_size(encoded: bytes) -> tuple[int, int]:
    """Return (width, height) of a JPEG or PNG by its header. Raises FormatError."""
    return _header(encoded, "JPEG", "PNG")[:2]


def size_of_encoded(encoded: bytes) -> tuple[int, int]:
    """Return (width, height) of a complete JPEG or PNG.

    Raises FormatError with the text "not a JPEG or PNG" for other data, and with "cut off" for a truncated
    image.
    """
    try:
        size = encoded_size(encoded)
    except FormatError as error:
        raise FormatError("not a JPEG or PNG") from error
    end = _ENDS[encoded.startswith(JPEG_MAGIC[:2])]
    if encoded.rfind(end, max(0, len(encoded) - _PADDING_BYTES)) < 0:
        raise FormatError("cut off")
    return size


def png_shape(data: bytes, name: str) -> tuple[int, int]:
    """Return (height, width) by a PNG's header. Raises FormatError."""
    if not PNG_MAGIC.startswith(data[: len(PNG_MAGIC)]):
        raise FormatError(f"{name} image is not a PNG; restore it from a copy")
    if len(data) < 33:
        raise FormatError(f"{name} image is cut off after {len(data)} bytes; restore it from a copy")
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if not (0 < width <= MAX_IMAGE_SIDE and 0 < height <= MAX_IMAGE_SIDE):
        raise FormatError(f"{name} PNG has {width}x{height} pixels; give at most {MAX_IMAGE_SIDE} a side")
    return height, width


def image_shape(data: bytes, name: str) -> tuple[int, int]:
    """Return (height, width) by the header of a PNG, JPEG, TIFF, PGM or .npy file. Raises FormatError."""
    if data.startswith(PNG_MAGIC):
        return png_shape(data, name)
    if data.startswith(NPY_MAGIC):
        height, width = _array(data, name).shape
        return height, width
    try:
        width, height, pages = _header(data, "JPEG", "PNG", "TIFF", "PPM")
    except FormatError as error:
        if name.lower().endswith(".png"):
            return png_shape(data, name)
        raise FormatError(
            f"{name} is not a readable PNG, JPEG, TIFF, PGM or .npy image; convert it to a 16-bit PNG"
        ) from error
    if pages != 1:
        raise FormatError(f"{name} holds {pages} images; store every image in a file of its own")
    if max(width, height) > MAX_IMAGE_SIDE:
        raise FormatError(f"{name} has {width}x{height} pixels; give at most {MAX_IMAGE_SIDE} a side")
    return height, width


def decode_grey(data: bytes, dtype: type[Any], name: str) -> NDArray[Any]:
    """Return the pixels (h, w) of a greyscale PNG of exactly ``dtype``, uint8 or uint16.

    Raises FormatError, for a wrong checksum of any chunk too.
    """
    shape, image = png_shape(data, name), _decoded(data)
    if image is None:
        raise FormatError(f"{name} PNG cannot be decoded; restore it from a copy")
    if image.shape != shape or image.dtype != dtype:
        held = f"{image.dtype} {image.shape}"
        raise FormatError(f"{name} PNG holds {held}; give one channel of {dtype.__name__}")
    return np.asarray(image, dtype)


def decode_depth(data: bytes, name: str) -> NDArray[Any]:
    """Return the pixels (h, w) of a PNG, TIFF, PGM or NumPy array of one channel. Raises FormatError for
    other or broken images.
    """
    if data.startswith(PNG_MAGIC) or name.lower().endswith(".png"):
        return decode_grey(data, np.uint16, name)
    if data.startswith(NPY_MAGIC):
        return _array(data, name)
    shape, image = image_shape(data, name), _decoded(data)
    if image is None:
        raise FormatError(f"{name} cannot be decoded; restore it from a copy, or convert it to a 16-bit PNG")
    if image.shape != shape or image.dtype.name not in KINDS:
        raise FormatError(
            f"{name} holds {image.dtype} {image.shape}; give one channel of {' or '.join(KINDS)}"
        )
    return np.asarray(image)


def _decoded(data: bytes) -> NDArray[Any] | None:
    import cv2

    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None


def _array(data: bytes, name: str) -> NDArray[Any]:
    """Return the array (h, w) of a .npy file without axes of length 1; objects are refused."""
    file, formats = io.BytesIO(data), np.lib.format
    readers = {(1, 0): formats.read_array_header_1_0, (2, 0): formats.read_array_header_2_0}
    try:
        shape, by_columns, kind = readers[formats.read_magic(file)](file)
    except (ValueError, KeyError, EOFError) as error:
        raise FormatError(f"{name} holds no plain array; save it with numpy.save") from error
    sides = tuple(side for side in shape if side != 1)
    if len(sides) != 2 or kind.kind not in "iuf" or max(sides) > MAX_IMAGE_SIDE:
        raise FormatError(f"{name} holds {kind} {shape}; give one image (h, w) of whole numbers or floats")
    if sides[0] * sides[1] * kind.itemsize != len(data) - file.tell():
        raise FormatError(f"{name} is cut off; restore it from a copy")
    return np.frombuffer(data, kind, offset=file.tell()).reshape(sides, order="F" if by_columns else "C")
