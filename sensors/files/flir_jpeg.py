"""Radiometric JPEGs of FLIR's cameras, and of others that write FLIR's data (DJI's Zenmuse XT 2).

The records of an FFF file are spread over APP1 segments. Layout: ExifTool, FLIR.pm ("FLIR FFF tag table",
"ProcessFLIR"). FLIR writes header and directory big-endian, DJI little-endian; each record states its own
order by its first word.
"""

import io
import struct
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.images import JPEG_MAGIC, PNG_MAGIC, decode_grey, png_shape
from sensors.files.planck import Radiometry

GAMUT = 0.25  # share of pixels outside RGB above which a PNG is not in Y Cb Cr; untuned
EARLIEST, LATEST = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in (2000, 2100))  # credible times
MAX_RECORDS = 10_000  # entries of a directory; cameras write some ten
SEGMENT = b"FLIR\0"
RAW, PHOTO, CAMERA = 0x01, 0x0E, 0x20  # types of records
IMAGE_AT = 32  # bytes in front of an image in its record
_VERSIONS = range(100, 200)  # of an FFF header; in the right byte order
_ENTRY_BYTES = 32  # of the directory


class FlirImage(NamedTuple):
    """Contents of one file. celsius: float32 (h, w). photo: bytes of the photograph, JPEG or PNG, or None.

    wide_deg: horizontal field of view, 0 = not stated. taken_ns: since 1970, 0 = not stated.
    """

    celsius: NDArray[np.float32]
    photo: bytes | None
    wide_deg: float = 0.0
    taken_ns: int = 0


class _Record(NamedTuple):
    """Record of an FFF file. order: byte order of its numbers, ``<`` or ``>``."""

    data: bytes
    order: str

    def numbers(self, layout: str, at: int) -> tuple[float, ...]:
        """Return numbers of a ``struct`` layout at an offset. Raises struct.error beyond the record's end."""
        return struct.unpack_from(self.order + layout, self.data, at)

    def size(self) -> tuple[int, int]:
        """Return the (height, width) that an image's record states."""
        width, height = (int(number) for number in self.numbers("HH", 2))
        if not 0 < min(width, height) <= max(width, height) <= MAX_IMAGE_SIDE:
            raise ValueError(f"an image has {width}x{height} pixels, not 1 to {MAX_IMAGE_SIDE} a side")
        return height, width


def read_flir(data: bytes, name: str) -> FlirImage:
    """Return temperatures, by the file's emissivity, distance and reflections, and the photograph.

    Raises FormatError for a JPEG without FLIR's data or without the camera's constants.
    """
    try:
        records = _records(list(_segments(io.BytesIO(data))))
        if RAW not in records:
            raise ValueError("it has no raw image")
        if CAMERA not in records:
            raise ValueError("it has no camera record")
        camera = records[CAMERA]
        celsius = _radiometry(camera).celsius(_words(records[RAW], name))
        photo = _photo(records[PHOTO], name) if PHOTO in records else None
        found = FlirImage(celsius, photo, _field_deg(camera), _taken_ns(camera))
    except (ValueError, struct.error, FormatError) as error:
        raise FormatError(
            f"{name} holds no temperatures ({str(error)[:100]}); give a FLIR camera's radiometric JPEG"
        ) from error
    if not np.isfinite(celsius).any():
        raise FormatError(
            f"{name} holds no temperatures (none is finite); give a file as the camera wrote it"
        )
    return found


def has_flir(path: Path) -> bool:
    """Return whether a JPEG holds FLIR's data; False for a file that cannot be read."""
    try:
        with path.open("rb") as file:
            return next(_segments(file), None) is not None
    except OSError:
        return False


def _segments(file: BinaryIO) -> Iterator[bytes]:
    """Yield the contents of a JPEG's FLIR segments up to the image data."""
    if file.read(2) != b"\xff\xd8":
        return
    while True:
        marker = file.read(2)
        while len(marker) == 2 and marker == b"\xff\xff":  # fill bytes
            marker = marker[1:] + file.read(1)
        if len(marker) < 2 or marker[0] != 0xFF or marker[1] in (0xD9, 0xDA):
            return
        if marker[1] == 0x01 or 0xD0 <= marker[1] <= 0xD8:
            continue
        length = file.read(2)
        size = int.from_bytes(length, "big") - 2
        if len(length) < 2 or size < 0:
            return
        if marker[1] != 0xE1:
            file.seek(size, 1)
        elif (content := file.read(size)).startswith(SEGMENT):
            yield content


def _records(segments: list[bytes]) -> dict[int, _Record]:
    """Return the first record of each type. Raises ValueError where the file is malformed or cut off."""
    if not segments:
        raise ValueError("it has no FLIR segment")
    # Segment: "FLIR", 0, 1, its number, number of the last.
    ordered = sorted((segment for segment in segments if len(segment) > 8), key=lambda segment: segment[6])
    if not ordered or len(ordered) <= ordered[0][7]:
        raise ValueError("some of its FLIR segments are missing")
    fff = b"".join(segment[8:] for segment in ordered)
    if len(fff) < 64 or fff[:4] not in (b"FFF\0", b"AFF\0"):
        raise ValueError("its FLIR data is not an FFF file")
    order = next((o for o in "><" if struct.unpack_from(f"{o}I", fff, 20)[0] in _VERSIONS), None)
    if order is None:
        raise ValueError("its FFF file has an unknown version")
    start, count = struct.unpack_from(f"{order}II", fff, 24)
    if count > MAX_RECORDS or start + count * _ENTRY_BYTES > len(fff):
        raise ValueError("its directory is cut off")
    records: dict[int, _Record] = {}
    for entry in range(start, start + count * _ENTRY_BYTES, _ENTRY_BYTES):
        (kind,) = struct.unpack_from(f"{order}H", fff, entry)
        at, size = struct.unpack_from(f"{order}II", fff, entry + 12)
        if kind in (RAW, PHOTO, CAMERA) and kind not in records and size >= IMAGE_AT:
            if at + size > len(fff):
                raise ValueError(f"its record {kind} is cut off")
            data = fff[at : at + size]
            # The first word is 2 or 3: 256 or more means the other order.
            records[kind] = _Record(data, "<" if data[0] and not data[1] else ">")
    return records


def _words(record: _Record, name: str) -> NDArray[np.uint16]:
    """Return the raw image (h, w): plain words in the record's order, or a 16-bit PNG in either."""
    height, width = record.size()
    content = record.data[IMAGE_AT:]
    if not content.startswith(PNG_MAGIC):
        if len(content) < 2 * width * height:
            raise ValueError(f"its {width}x{height} image has {len(content)} of {2 * width * height} bytes")
        words = np.frombuffer(content, f"{record.order}u2", width * height).reshape(height, width)
        return words.astype(np.uint16)
    image = decode_grey(content, np.uint16, name)
    if image.shape != (height, width):
        raise ValueError(f"its PNG has shape {image.shape}, its record states {(height, width)}")
    # Most cameras swap the bytes (ExifTool, FLIR RawData): scenes are smooth in the right order.
    swapped = image.byteswap()
    return swapped if _roughness(swapped) <= _roughness(image) else np.asarray(image, np.uint16)


def _roughness(image: NDArray[np.uint16]) -> float:
    return float(np.abs(np.diff(image.astype(np.int32), axis=1)).mean()) if image.shape[1] > 1 else 0.0


def _radiometry(camera: _Record) -> Radiometry:
    emissivity, distance, reflected, air, window_k, window, humidity = _finite(
        *camera.numbers("6f", 0x20), *camera.numbers("f", 0x3C)
    )
    r1, b, f = camera.numbers("3f", 0x58)
    alpha1, alpha2, beta1, beta2, x = _finite(*camera.numbers("5f", 0x70))
    o, r2 = camera.numbers("if", 0x308)
    if not (r1 > 0 and r2 > 0 and b > 0 and np.isfinite([r1, r2, b, f]).all()):
        raise ValueError("its camera states no constants of Planck's law")
    humidity = humidity / 100 if humidity > 2 else humidity  # some files state percents
    return Radiometry(
        emissivity, distance, reflected, air, window_k, window, humidity, r1, b, f, o, r2,
        (alpha1, alpha2), (beta1, beta2), x,
    )  # fmt: skip


def _finite(*numbers: float) -> list[float]:
    """Return the numbers; numbers that are not finite become 0."""
    return [number if np.isfinite(number) else 0.0 for number in numbers]


def _field_deg(camera: _Record) -> float:
    try:
        (wide,) = camera.numbers("f", 0x1B4)
    except struct.error:
        return 0.0
    return wide if 1 < wide < 170 else 0.0


def _taken_ns(camera: _Record) -> int:
    try:
        seconds, thousandths = camera.numbers("II", 0x384)
    except struct.error:
        return 0
    credible = EARLIEST < seconds < LATEST
    return int(seconds) * 10**9 + (int(thousandths) & 0xFFFF) % 1000 * 10**6 if credible else 0


def _photo(record: _Record, name: str) -> bytes | None:
    """Return the photograph as a file of RGB; None for other kinds of data."""
    content = record.data[IMAGE_AT:]
    if content.startswith(JPEG_MAGIC):
        return content
    if not content.startswith(PNG_MAGIC) or png_shape(content, name) != record.size():
        return None
    import cv2

    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        return None
    rgb = _rgb(np.asarray(image[..., ::-1], np.float32))
    return content if rgb is None else bytes(cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1])


def _rgb(channels: NDArray[np.float32]) -> NDArray[np.uint8] | None:
    """Return RGB of a PNG in Y, Cb, Cr (ExifTool, FLIR EmbeddedImage; JFIF's BT.601); None if it is RGB
    already.

    RGB data is recognised because its conversion leaves the range of colours.
    """
    y, cb, cr = channels[..., 0], channels[..., 1] - 128, channels[..., 2] - 128
    rgb = np.stack([y + 1.402 * cr, y - 0.344136 * cb - 0.714136 * cr, y + 1.772 * cb], axis=-1)
    outside = ((rgb < -16) | (rgb > 271)).any(axis=-1).mean()
    return None if outside > GAMUT else np.asarray(np.clip(np.rint(rgb), 0, 255), np.uint8)
