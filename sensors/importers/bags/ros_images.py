"""Pictures of ROS 2 and Foxglove messages as depth in millimetres and as encoded colour.

Encodings: sensor_msgs/image_encodings.hpp; compressed depth: compressed_depth_image_transport (ROS).
"""

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.png import PNG_MAGIC, decode_grey
from sensors.importers.bags.ros_messages import Picture
from sensors.rig.frame import mm_from_metres

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
}
"""Encodings that are read; of colours, number of channels and OpenCV's way to its own order."""
_CONFIG = struct.Struct("<iff")
"""What stands before the PNG of a compressed depth image: format (1 = inverse depth), and its two numbers."""


def depth_mm_from(picture: Picture) -> NDArray[np.uint16]:
    """Depth (h, w) in millimetres. Raises FormatError."""
    if picture.compressed:
        return _unpacked_depth(picture)
    kind = DEPTHS.get(picture.encoding)
    if kind is None:
        raise FormatError(f"depth image is {picture.encoding[:40]!r}; only {', '.join(DEPTHS)} are read")
    values = pixels_of(picture, np.dtype(kind), 1)[..., 0]
    return mm_from_metres(values) if kind is np.float32 else values.astype(np.uint16)


def grey_from(picture: Picture) -> NDArray[np.uint16]:
    """An infrared image (h, w) of 8 or 16 bits. Raises FormatError."""
    if picture.compressed:
        return decode_grey(picture.data, np.uint8, "infrared").astype(np.uint16)
    dtype = np.dtype(np.uint8 if picture.encoding in ("mono8", "8UC1") else np.uint16)
    return pixels_of(picture, dtype, 1)[..., 0].astype(np.uint16)


def color_encoded_from(picture: Picture) -> bytes:
    """JPEG or PNG bytes: the sender's own, or a raw image as PNG, which loses nothing. Raises FormatError."""
    if picture.compressed:
        if not picture.data.startswith((b"\xff\xd8\xff", PNG_MAGIC)):
            raise FormatError(f"colour image is {picture.encoding[:40]!r}; only JPEG and PNG are read")
        return picture.data
    if picture.encoding not in COLORS:
        raise FormatError(f"colour image is {picture.encoding[:40]!r}; only {', '.join(COLORS)} are read")
    channels, code = COLORS[picture.encoding]
    pixels = pixels_of(picture, np.dtype(np.uint8), channels)
    bgr = pixels if code is None else cv2.cvtColor(pixels, code)
    return bytes(cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def pixels_of(picture: Picture, dtype: np.dtype[Any], channels: int) -> NDArray[Any]:
    """Pixels (h, w, channels) of a raw picture, row padding removed. Raises FormatError."""
    height, width, step = picture.height, picture.width, picture.step
    row = width * channels * dtype.itemsize
    if not (0 < height <= MAX_IMAGE_SIDE and 0 < width <= MAX_IMAGE_SIDE) or step < row:
        raise FormatError(
            f"image is {width}x{height}, {step} bytes a row; give at most {MAX_IMAGE_SIDE} a side"
        )
    # The last row's padding may be missing.
    if len(picture.data) < step * (height - 1) + row or step > len(picture.data):
        raise FormatError(f"image of {width}x{height} holds {len(picture.data)} bytes; record it again")
    data = picture.data[: step * height].ljust(step * height, b"\0")
    rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, :row]
    order = dtype.newbyteorder(">" if picture.big_endian else "<")
    return np.ascontiguousarray(rows).view(order).reshape(height, width, channels)


def _unpacked_depth(picture: Picture) -> NDArray[np.uint16]:
    start = picture.data[:64].find(PNG_MAGIC)
    if start < 0:
        raise FormatError(
            f"compressed depth has format {picture.encoding[:60]!r}; only PNG is read, not RVL: record it raw"
        )
    png = picture.data[start:]
    values: NDArray[np.uint16] = decode_grey(png, np.uint16, "compressed depth")
    if start != _CONFIG.size or "32FC1" not in picture.encoding:
        return values
    _, a, b = _CONFIG.unpack(picture.data[: _CONFIG.size])
    if not (np.isfinite(a) and np.isfinite(b) and a > 0):
        raise FormatError(f"compressed depth is quantised by {a} and {b}; record it again")
    with np.errstate(divide="ignore", invalid="ignore"):
        return mm_from_metres(np.where(values > 0, a / (values.astype(np.float64) - b), np.nan))
