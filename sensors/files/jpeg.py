"""JPEG images mirrored left to right: without loss by libturbojpeg, else decoded and encoded again.

libturbojpeg moves the blocks of the compressed image (``tjTransform``, turbojpeg.h, versions 1.2 to 3).
"""

import ctypes
from ctypes import CDLL, POINTER, Structure, byref, c_int, c_ubyte, c_ulong, c_void_p
from ctypes.util import find_library
from functools import cache

import numpy as np
from numpy.typing import NDArray

HFLIP, PERFECT = 1, 1  # TJXOP_HFLIP; TJXOPT_PERFECT: fail where the last column of blocks is cut
QUALITY = 95  # of an image that is encoded again; untuned


class _Transform(Structure):
    """``tjtransform``; a region of zeros is the whole image."""

    _fields_ = (
        ("region", c_int * 4),
        ("op", c_int),
        ("options", c_int),
        ("data", c_void_p),
        ("custom_filter", c_void_p),
    )


def mirrored_jpeg(encoded: bytes) -> bytes:
    """Return the bytes of a mirrored JPEG; other bytes unchanged.

    An EXIF orientation is neither applied nor changed: the sensor's pixels are mirrored.
    """
    return _by_blocks(encoded) or _by_pixels(encoded)


def is_lossless() -> bool:
    """Return whether libturbojpeg is installed."""
    return _turbojpeg() is not None


def encoded_jpeg(image: NDArray[np.uint8]) -> bytes:
    """Encode an image (h, w, 3) in OpenCV's order of colours."""
    import cv2

    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1])


def _by_blocks(encoded: bytes) -> bytes | None:
    """Return the JPEG mirrored without loss; None where the library is missing or fails."""
    library = _turbojpeg()
    handle = library.tjInitTransform() if library is not None else None
    if library is None or not handle:
        return None
    wanted = _Transform(op=HFLIP, options=PERFECT)
    out, size = POINTER(c_ubyte)(), c_ulong()
    results = 1, byref(out), byref(size), byref(wanted)
    try:
        failed = library.tjTransform(handle, encoded, len(encoded), *results, 0)
        return None if failed else ctypes.string_at(out, size.value)
    finally:
        library.tjFree(out)
        library.tjDestroy(handle)


def _by_pixels(encoded: bytes) -> bytes:
    import cv2

    if not encoded:
        return encoded
    image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return encoded if image is None else encoded_jpeg(np.asarray(image[:, ::-1], np.uint8))


@cache
def _turbojpeg() -> CDLL | None:
    images = POINTER(POINTER(c_ubyte)), POINTER(c_ulong), POINTER(_Transform)
    try:
        library = CDLL(find_library("turbojpeg") or "libturbojpeg.so.0")
        library.tjInitTransform.restype = c_void_p
        library.tjTransform.argtypes = (c_void_p, ctypes.c_char_p, c_ulong, c_int, *images, c_int)
        library.tjFree.argtypes, library.tjFree.restype = (POINTER(c_ubyte),), None
        library.tjDestroy.argtypes = (c_void_p,)
    except (OSError, AttributeError):
        return None
    return library
