"""JPEG images mirrored left to right: without loss by libturbojpeg, else decoded and encoded again.

libturbojpeg moves the blocks of the compressed image (``tjTransform``, turbojpeg.h of libjpeg-turbo; its
versions 1.2 to 3 have the same names). libfreenect2 needs the same library on Linux.
"""

import ctypes
from ctypes import CDLL, POINTER, Structure, byref, c_int, c_ubyte, c_ulong, c_void_p
from ctypes.util import find_library
from functools import cache

import numpy as np
from numpy.typing import NDArray

JPEG_MAGIC = b"\xff\xd8\xff"
HFLIP, PERFECT = 1, 1
"""``TJXOP_HFLIP``; ``TJXOPT_PERFECT``: fail where the last column of blocks is cut and would not move."""
QUALITY = 95
"""JPEG quality of an image that is encoded again: a second compression loses little (untuned)."""


class _Transform(Structure):
    """``tjtransform``: the part to keep (all zero: the whole image), what to do, and two unused pointers."""

    _fields_ = (
        ("region", c_int * 4),
        ("op", c_int),
        ("options", c_int),
        ("data", c_void_p),
        ("custom_filter", c_void_p),
    )


def mirrored_jpeg(encoded: bytes) -> bytes:
    """Mirror a JPEG left to right, its bytes in and out; bytes of no image stay as they are.

    An EXIF orientation is neither obeyed nor changed: the sensor's pixels are mirrored.
    """
    return _by_blocks(encoded) or _by_pixels(encoded)


def is_lossless() -> bool:
    """Return whether libturbojpeg is installed."""
    return _turbojpeg() is not None


def _by_blocks(encoded: bytes) -> bytes | None:
    """Return the mirrored JPEG, without loss.

    None without the library, or for an image that it cannot mirror.
    """
    library = _turbojpeg()
    handle = library.tjInitTransform() if library is not None else None
    if library is None or not handle:
        return None
    wanted = _Transform(op=HFLIP, options=PERFECT)
    out, size = POINTER(c_ubyte)(), c_ulong()
    try:
        failed = library.tjTransform(
            handle, encoded, len(encoded), 1, byref(out), byref(size), byref(wanted), 0
        )
        return None if failed else ctypes.string_at(out, size.value)
    finally:
        library.tjFree(out)
        library.tjDestroy(handle)


def _by_pixels(encoded: bytes) -> bytes:
    import cv2

    if not encoded:
        return encoded
    image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        return encoded
    return encoded_jpeg(np.asarray(image[:, ::-1], np.uint8))


def encoded_jpeg(image: NDArray[np.uint8]) -> bytes:
    """Encode an image (h, w, 3) in OpenCV's order of colours."""
    import cv2

    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1])


@cache
def _turbojpeg() -> CDLL | None:
    try:
        library = CDLL(find_library("turbojpeg") or "libturbojpeg.so.0")
        library.tjInitTransform.restype = c_void_p
        library.tjTransform.argtypes = (
            c_void_p,
            ctypes.c_char_p,
            c_ulong,
            c_int,
            POINTER(POINTER(c_ubyte)),
            POINTER(c_ulong),
            POINTER(_Transform),
            c_int,
        )
        library.tjFree.argtypes = (POINTER(c_ubyte),)
        library.tjFree.restype = None
        library.tjDestroy.argtypes = (c_void_p,)
    except (OSError, AttributeError):
        return None
    return library
