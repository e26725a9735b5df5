"""Radiometric JPEGs of FLIR's cameras, and of other cameras that write FLIR's data (DJI's Zenmuse XT 2)."""

import io
import struct
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.flir_records import CAMERA, IMAGE_AT, PHOTO, RAW, Record, flir_records, flir_segments
from sensors.files.jpeg import JPEG_MAGIC
from sensors.files.planck import Radiometry
from sensors.files.png import PNG_MAGIC, decode_grey, png_shape

GAMUT = 0.25
"""Share of pixels outside RGB above which a PNG is not in Y Cb Cr. Untuned."""
EARLIEST, LATEST = datetime(2000, 1, 1, tzinfo=UTC).timestamp(), datetime(2100, 1, 1, tzinfo=UTC).timestamp()
"""Seconds since 1970 between which a time stamp is credible: 2000 to 2100. Untuned."""


class FlirImage(NamedTuple):
    """Contents of one file. celsius: float32 (h, w). photo: bytes of the photograph, JPEG or PNG, or None.

    wide_deg: horizontal field of view, 0 = not stated. taken_ns: since 1970, 0 = not stated.
    """

    celsius: NDArray[np.float32]
    photo: bytes | None
    wide_deg: float = 0.0
    taken_ns: int = 0


def read_flir(data: bytes, name: str) -> FlirImage:
    """Read temperatures, by the file's emissivity, distance and reflections, and the photograph.

    Raises FormatError for another JPEG, and for one without a camera's constants.
    """
    try:
        records = flir_records(list(flir_segments(io.BytesIO(data))))
        if RAW not in records or CAMERA not in records:
            raise ValueError("it has no raw image or no camera record")
        camera = records[CAMERA]
        celsius = _radiometry(camera).celsius(_words(records[RAW], name))
        photo = _photo(records[PHOTO], name) if PHOTO in records else None
        wide, taken = _field(camera), _taken(camera)
    except (ValueError, struct.error, FormatError) as error:
        raise FormatError(
            f"{name} holds no temperatures ({str(error)[:100]}); give a FLIR camera's radiometric JPEG"
        ) from error
    if not np.isfinite(celsius).any():
        raise FormatError(
            f"{name} holds no temperatures (none is finite); give a file as the camera wrote it"
        )
    return FlirImage(celsius, photo, wide, taken)


def _size(record: Record) -> tuple[int, int]:
    """Return (height, width) that an image's record states."""
    width, height = (int(number) for number in record.numbers("HH", 2))
    if not 0 < min(width, height) <= max(width, height) <= MAX_IMAGE_SIDE:
        raise ValueError(f"an image of {width}x{height}")
    return height, width


def _words(record: Record, name: str) -> NDArray[np.uint16]:
    """Return the raw image (h, w): plain words in the record's order, or a 16-bit PNG in either."""
    height, width = _size(record)
    content = record.data[IMAGE_AT:]
    if not content.startswith(PNG_MAGIC):
        if len(content) < 2 * width * height:
            raise ValueError(f"{len(content)} bytes of a {width}x{height} image")
        words = np.frombuffer(content, f"{record.order}u2", width * height).reshape(height, width)
        return words.astype(np.uint16)
    image = decode_grey(content, np.uint16, name)
    if image.shape != (height, width):
        raise ValueError(f"a PNG of {image.shape}, stated {(height, width)}")
    # Most cameras swap the bytes (ExifTool, FLIR RawData): scenes are smooth in the right order.
    swapped = image.byteswap()
    return swapped if _rough(swapped) <= _rough(image) else np.asarray(image, np.uint16)


def _rough(image: NDArray[np.uint16]) -> float:
    return float(np.abs(np.diff(image.astype(np.int32), axis=1)).mean()) if image.shape[1] > 1 else 0.0


def _radiometry(camera: Record) -> Radiometry:
    emissivity, distance, reflected, air, window_k, window = camera.numbers("6f", 0x20)
    (humidity,) = camera.numbers("f", 0x3C)
    r1, b, f = camera.numbers("3f", 0x58)
    alpha1, alpha2, beta1, beta2, x = camera.numbers("5f", 0x70)
    o, r2 = camera.numbers("if", 0x308)
    if not (r1 > 0 and r2 > 0 and b > 0 and np.isfinite([r1, r2, b, f]).all()):
        raise ValueError("its camera states no constants of Planck's law")
    stated = emissivity, distance, reflected, air, window_k, window, humidity
    emissivity, distance, reflected, air, window_k, window, humidity = _finite(*stated)
    # Some files state percents.
    humidity = humidity / 100 if humidity > 2 else humidity
    alpha1, alpha2, beta1, beta2, x = _finite(alpha1, alpha2, beta1, beta2, x)
    return Radiometry(
        emissivity, distance, reflected, air, window_k, window, humidity, r1, b, f, o, r2,
        (alpha1, alpha2), (beta1, beta2), x,
    )  # fmt: skip


def _finite(*numbers: float) -> list[float]:
    """Return the numbers, with 0 in place of those that are not finite."""
    return [number if np.isfinite(number) else 0.0 for number in numbers]


def _field(camera: Record) -> float:
    try:
        (wide,) = camera.numbers("f", 0x1B4)
    except struct.error:
        return 0.0
    return wide if 1 < wide < 170 else 0.0


def _taken(camera: Record) -> int:
    try:
        seconds, thousandths = camera.numbers("II", 0x384)
    except struct.error:
        return 0
    if not EARLIEST < seconds < LATEST:
        return 0
    return int(seconds) * 10**9 + (int(thousandths) & 0xFFFF) % 1000 * 10**6


def _photo(record: Record, name: str) -> bytes | None:
    """Return the photograph as a file of RGB; None for other kinds of data."""
    content = record.data[IMAGE_AT:]
    if content.startswith(JPEG_MAGIC):
        return content
    if not content.startswith(PNG_MAGIC):
        return None
    if png_shape(content, name) != _size(record):
        return None
    import cv2

    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        return None
    rgb = _rgb(np.asarray(image[..., ::-1], np.float32))
    return content if rgb is None else bytes(cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1])


def _rgb(channels: NDArray[np.float32]) -> NDArray[np.uint8] | None:
    """Return RGB of a PNG in Y, Cb, Cr (ExifTool, FLIR EmbeddedImage; JFIF's BT.601); None for RGB.

    Photographs in RGB, converted as Y Cb Cr, leave the range of colours.
    """
    y, cb, cr = channels[..., 0], channels[..., 1] - 128, channels[..., 2] - 128
    rgb = np.stack([y + 1.402 * cr, y - 0.344136 * cb - 0.714136 * cr, y + 1.772 * cb], axis=-1)
    outside = ((rgb < -16) | (rgb > 271)).any(axis=-1).mean()
    return None if outside > GAMUT else np.asarray(np.clip(np.rint(rgb), 0, 255), np.uint8)
