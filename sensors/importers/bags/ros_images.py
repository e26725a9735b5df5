"""Conversion of image messages of ROS and Foxglove to depth arrays and encoded colour.

Encodings: sensor_msgs/image_encodings.hpp; compressed depth: compressed_depth_image_transport (ROS); Bayer
patterns: cv_bridge, src/cv_bridge.cpp.
"""

import io
import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.images import JPEG_MAGIC, PNG_MAGIC, decode_grey
from sensors.importers.bags.ros_messages import Picture

Depth = NDArray[np.uint16] | NDArray[np.float32]
"""Depth (h, w) as messages have it: whole units (millimetres by REP 118), or floats (metres)."""
DEPTHS = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}
COLORS = {
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, cv2.COLOR_GRAY2BGR),
    "YUYV": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
}
"""Encodings of colour that are read, with number of channels and OpenCV's conversion to its own order."""
PICTURE_MAGICS = (JPEG_MAGIC, PNG_MAGIC)
FINE_MM = 0.1  # depth unit of a RealSense D405, which realsense-ros publishes as it is
_CONFIG = struct.Struct("<iff")  # in front of compressed depth's PNG: format (1 = inverse), two numbers


def depth_from(picture: Picture) -> Depth:
    """Return depth (h, w). Raises FormatError for an encoding without depth, or broken data."""
    if picture.compressed:
        return _unpacked_depth(picture)
    kind = DEPTHS.get(picture.encoding)
    if kind is None:
        raise FormatError(f"depth image has encoding {picture.encoding[:40]!r}; record {', '.join(DEPTHS)}")
    values = pixels_of(picture, np.dtype(kind), 1)[..., 0]
    return values.astype(np.float32) if kind is np.float32 else values.astype(np.uint16)


def is_grey_png(picture: Picture) -> bool:
    """Return whether a compressed picture is a 16-bit one-channel PNG, which is lossless.

    image_transport's plain ``compressed`` transport and Foxglove's CompressedImage carry depth in this way.
    """
    # IHDR: bit depth, colour type (PNG specification, 11.2.2).
    return picture.compressed and picture.data.startswith(PNG_MAGIC) and picture.data[24:26] == b"\x10\0"


def picture_size(picture: Picture) -> tuple[int, int] | None:
    """Return (width, height) by the message or the header of its JPEG or PNG; None where it is damaged."""
    if not picture.compressed:
        return picture.width, picture.height
    start = max(0, picture.data[:64].find(PNG_MAGIC))  # compressed depth has numbers in front
    try:
        with Image.open(io.BytesIO(picture.data[start:]), formats=("JPEG", "PNG")) as header:
            return header.size
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None


def grey_from(picture: Picture) -> NDArray[np.uint16]:
    """Return an infrared image (h, w) of 8 or 16 bits. Raises FormatError for broken data."""
    if picture.compressed:
        return decode_grey(picture.data, np.uint8, "infrared").astype(np.uint16)
    dtype = np.dtype(np.uint8 if picture.encoding in ("mono8", "8UC1") else np.uint16)
    return pixels_of(picture, dtype, 1)[..., 0].astype(np.uint16)


def color_encoded_from(picture: Picture) -> bytes:
    """Return JPEG or PNG bytes: the sender's own, or a raw image as lossless PNG. Raises FormatError."""
    if picture.compressed:
        if not picture.data.startswith(PICTURE_MAGICS):
            raise FormatError(f"colour image has format {picture.encoding[:40]!r}; record JPEG or PNG")
        return picture.data
    if picture.encoding not in COLORS:
        raise FormatError(f"colour image has encoding {picture.encoding[:40]!r}; record {', '.join(COLORS)}")
    channels, code = COLORS[picture.encoding]
    pixels = pixels_of(picture, np.dtype(np.uint8), channels)
    bgr = pixels if code is None else cv2.cvtColor(pixels, code)
    return bytes(cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def pixels_of(picture: Picture, dtype: np.dtype[Any], channels: int) -> NDArray[Any]:
    """Return the pixels (h, w, channels) of a raw picture, row padding removed. Raises FormatError for an
    impossible size or missing data.
    """
    height, width, step = picture.height, picture.width, picture.step
    row = width * channels * dtype.itemsize
    if not (0 < height <= MAX_IMAGE_SIDE and 0 < width <= MAX_IMAGE_SIDE):
        raise FormatError(f"image has {width}x{height} pixels; give 1 to {MAX_IMAGE_SIDE} a side")
    if step < row:
        raise FormatError(
            f"image of {width}x{height} has {step} bytes a row instead of {row} or more; record it again"
        )
    # The last row's padding may be missing.
    if len(picture.data) < step * (height - 1) + row or step > len(picture.data):
        raise FormatError(
            f"image of {width}x{height} holds {len(picture.data)} of {step * height} bytes; record it again"
        )
    data = picture.data[: step * height].ljust(step * height, b"\0")
    rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, :row]
    order = dtype.newbyteorder(">" if picture.big_endian else "<")
    return np.ascontiguousarray(rows).view(order).reshape(height, width, channels)


def _unpacked_depth(picture: Picture) -> Depth:
    start = picture.data[:64].find(PNG_MAGIC)
    if start < 0:
        raise FormatError(f"compressed depth has format {picture.encoding[:60]!r}; record PNG or raw depth")
    png = picture.data[start:]
    values: NDArray[np.uint16] = decode_grey(png, np.uint16, "compressed depth")
    if start != _CONFIG.size or "32FC1" not in picture.encoding:
        return values
    _, a, b = _CONFIG.unpack(picture.data[: _CONFIG.size])
    if not (np.isfinite(a) and np.isfinite(b) and a > 0):
        raise FormatError(
            f"compressed depth has quantisation {a} and {b}, not a positive and a finite number; "
            "record it again"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values > 0, a / (values.astype(np.float64) - b), np.nan).astype(np.float32)
