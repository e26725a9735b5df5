"""Depth, part, confidence and probability images as PNG bytes, bounded and checked on reading.

cv2 and Pillow are imported where used, because commands such as ``info`` do not need them.
"""

import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from annotate.array_types import Float32, UInt8, UInt16
from annotate.crop import SIZE, Crop, crop_from_note
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.files.images import PNG_MAGIC, decode_grey, png_shape

V = TypeVar("V")

NOTE = "probability_crop"
"""Name of the note on the crop's place in the frame: [top, left, side], pixels."""
PNG_LEVEL = 1  # of zlib; the highest takes ten times the time and saves little on noisy depth


def read_image(file: Path, decode: Callable[[bytes], V]) -> V:
    """Decode an image file. Raises FormatError naming it."""
    data = read_bounded(file)
    try:
        return decode(data)
    except FormatError as error:
        raise FormatError(f"{file}: {error}") from error


def decode_depth(data: bytes) -> UInt16:
    """Decode a 16-bit greyscale PNG to uint16 (h, w) millimetres. Raises FormatError.

    The last image is cached, because labels and their ground truth have the same depth image.
    """
    return _depth_in(data).copy()


@lru_cache(maxsize=1)
def _depth_in(data: bytes) -> UInt16:
    return decode_grey(data, np.uint16, "depth")


def encode_confidence(confidence: Float32) -> bytes:
    """Encode float (h, w) in [0, 1] as 8-bit greyscale PNG in steps of 1/255."""
    return encode_png(_steps(confidence))


def decode_confidence(data: bytes) -> Float32:
    """Decode a PNG of ``encode_confidence`` to float32 (h, w). Raises FormatError."""
    return decode_grey(data, np.uint8, "confidence").astype(np.float32) / np.float32(255)


def stored_confidence(confidence: Float32) -> Float32:
    """Return confidence (h, w) rounded to steps of 1/255, as stored."""
    return _steps(confidence).astype(np.float32) / np.float32(255)


def _steps(confidence: Float32) -> UInt8:
    """Return confidence (h, w) as bytes, ten times as fast as numpy."""
    import cv2

    return np.asarray(cv2.convertScaleAbs(np.maximum(confidence, 0, dtype=np.float32), alpha=255), np.uint8)


def encode_parts(parts: UInt8, scheme: Scheme = PAPER) -> bytes:
    """Encode uint8 (h, w) part ids as 8-bit palette PNG, so that any viewer shows the scheme's colours."""
    height, width = parts.shape
    rows = np.zeros((height, width + 1), np.uint8)  # Each begins with the number of its filter: none.
    rows[:, 1:] = parts
    packer = zlib.compressobj(PNG_LEVEL, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    size = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    data = packer.compress(rows.tobytes()) + packer.flush()
    chunks = (b"IHDR", size), (b"PLTE", _palette(scheme)), (b"IDAT", data)
    return PNG_MAGIC + b"".join(_chunk(*chunk) for chunk in (*chunks, (b"IEND", b"")))


@lru_cache(maxsize=16)
def _palette(scheme: Scheme) -> bytes:
    return scheme.palette_rgb().tobytes()


def _chunk(name: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG (ISO/IEC 15948): length, name, data, checksum."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def decode_parts(data: bytes) -> UInt8:
    """Decode a palette or greyscale 8-bit PNG to uint8 (h, w) part ids. Raises FormatError."""
    from PIL.PngImagePlugin import PngImageFile

    height, width = png_shape(data, "parts")
    try:
        with PngImageFile(io.BytesIO(data)) as image:
            mode, size, parts = image.mode, image.size, None
            # A second header would change the size: only the first one was checked.
            if mode in ("P", "L") and size == (width, height):
                parts = np.array(image, dtype=np.uint8)
    except Exception as error:  # Pillow's readers of odd chunks raise almost anything
        raise FormatError(f"parts PNG cannot be decoded ({error}); restore it from a copy") from error
    if parts is None or parts.shape != (height, width):
        raise FormatError(
            f"parts PNG has mode {mode} and {size[0]}x{size[1]} pixels; give part ids in 8 bits, as palette "
            f"or greyscale, {width}x{height}"
        )
    return parts


def decode_persons(data: bytes) -> UInt8:
    """Decode an 8-bit greyscale PNG to uint8 (h, w) person numbers. Raises FormatError."""
    return decode_grey(data, np.uint8, "persons")


def encode_png(image: UInt8 | UInt16, differences: bool = True) -> bytes:
    """Encode an image (h, w) as greyscale PNG with run-length compression.

    differences: encode differences to the row above instead of values. A person's depth crop takes 0.3 ms and
    8.6 kB, with OpenCV's default 0.75 ms and 10.2 kB.
    """
    import cv2

    filtering = cv2.IMWRITE_PNG_FILTER_UP if differences else cv2.IMWRITE_PNG_FILTER_NONE
    settings = [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL, cv2.IMWRITE_PNG_STRATEGY]
    settings += [cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER, filtering]
    ok, data = cv2.imencode(".png", image, settings)
    if not ok:
        raise FormatError(f"image {image.dtype} {image.shape} cannot be encoded as PNG; give uint8 or uint16")
    return bytes(data)


@dataclass(frozen=True)
class Probabilities:
    """Class probabilities float32 (n, 212, 212) of a crop, by part id; they add up to one at every pixel."""

    crop: Crop
    planes: Float32

    def note(self) -> dict[str, list[int]]:
        """Return the note that stores the crop's position with the frame."""
        return {NOTE: [self.crop.top, self.crop.left, self.crop.side]}


def encode_probabilities(probabilities: Probabilities) -> bytes:
    """Encode n planes, one below the other, in steps of 1/255, as a greyscale PNG (n * 212, 212)."""
    tall = np.rint(np.clip(probabilities.planes, 0, 1) * 255).astype(np.uint8).reshape(-1, SIZE)
    return encode_png(tall, differences=False)


def decode_probabilities(data: bytes, notes: dict[str, Any], n_classes: int) -> Probabilities:
    """Decode a PNG of ``encode_probabilities``; notes: the frame's, with the crop. Raises FormatError."""
    if (shape := png_shape(data, "probability")) != (n_classes * SIZE, SIZE):
        wanted = f"not {SIZE}x{n_classes * SIZE}"
        raise FormatError(f"probability PNG has {shape[1]}x{shape[0]} pixels, {wanted}; predict again")
    stored = decode_grey(data, np.uint8, "probability").reshape(n_classes, SIZE, SIZE)
    total = stored.sum(axis=0, dtype=np.int64)
    # Each plane was rounded by half a step at most.
    if np.abs(total - 255).max() > n_classes / 2:
        raise FormatError("probabilities do not add up to one; restore the PNG or predict again")
    return Probabilities(crop_from_note(notes.get(NOTE), NOTE), (stored / total).astype(np.float32))
