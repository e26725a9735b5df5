"""A FLIR camera's radiometric JPEG, packed from what ExifTool documents of its records (FLIR tags)."""

import io
import struct
from dataclasses import dataclass, field

import cv2
import numpy as np
from PIL import Image

PLANCK = {"r1": 14000.0, "r2": 0.0125, "b": 1400.0, "f": 1.0, "o": -4000}
"""Of the size of a real camera's."""
RAW, PHOTO, CAMERA = 1, 14, 32
"""Types of records."""
SEGMENT = 60_000
SPARE = 4
"""Empty entries at the directory's end, as cameras write some; flyr 5.1 does not find the last two."""


@dataclass(frozen=True)
class Written:
    """Layout of a file. order: of the FFF file's header and directory. record: of its records' numbers.
    raw: "words", or "png" with the bytes of each word swapped or "png-straight". photo: "jpg", or "png" in
    Y Cb Cr or "png-rgb". scene: fields of the camera's record by offset."""

    order: str = ">"
    record: str = "<"
    raw: str = "words"
    photo: str = "jpg"
    scene: dict[int, float] = field(default_factory=dict)


FLIR = Written()
DJI = Written(order="<")
"""A Zenmuse XT 2."""


def raw_of(celsius: np.ndarray) -> np.ndarray:
    """Words of a camera at distance 0 of a black body: Planck's law by its five constants."""
    r1, r2, b, f, o = PLANCK.values()
    return np.rint(r1 / (r2 * (np.exp(b / (celsius + 273.15)) - f)) - o).astype(np.uint16)


def camera_record(order: str = "<", scene: dict[int, float] | None = None) -> bytes:
    """Emissivity 1, distance 0, a window that lets all through, unless ``scene`` has other numbers."""
    record = bytearray(1000)
    struct.pack_into(f"{order}H", record, 0, 2)
    room_k = 293.15
    struct.pack_into(f"{order}ffffff", record, 32, 1.0, 0.0, room_k, room_k, room_k, 1.0)
    struct.pack_into(f"{order}f", record, 60, 0.5)
    struct.pack_into(f"{order}fff", record, 88, PLANCK["r1"], PLANCK["b"], PLANCK["f"])
    struct.pack_into(f"{order}fffff", record, 112, 0.006569, 0.01262, -0.002276, -0.00667, 1.9)
    struct.pack_into(f"{order}if", record, 776, PLANCK["o"], PLANCK["r2"])
    for at, number in (scene or {}).items():
        struct.pack_into(f"{order}{'f' if isinstance(number, float) else 'I'}", record, at, number)
    return bytes(record)


def image_record(width: int, height: int, content: bytes, order: str = "<", first: int = 2) -> bytes:
    return struct.pack(f"{order}HHH", first, width, height).ljust(32, b"\0") + content


def raw_content(words: np.ndarray, how: Written) -> bytes:
    if how.raw == "words":
        return words.astype(f"{how.record}u2").tobytes()
    image = words.byteswap() if how.raw == "png" else words
    return cv2.imencode(".png", image)[1].tobytes()


def photo_content(photo: np.ndarray, how: Written) -> bytes:
    if how.photo == "jpg":
        return cv2.imencode(".jpg", photo[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    stored = Image.fromarray(photo)
    if how.photo == "png":
        stored = Image.fromarray(np.asarray(stored.convert("YCbCr")))
    stream = io.BytesIO()
    stored.save(stream, "PNG")
    return stream.getvalue()


def flir_jpeg(celsius: np.ndarray, photo: np.ndarray | None = None, how: Written = FLIR) -> bytes:
    """A grey JPEG that holds temperatures (h, w), and a photograph (h', w', 3) RGB if there is one."""
    height, width = celsius.shape
    records = [
        (RAW, image_record(width, height, raw_content(raw_of(celsius), how), how.record)),
        (CAMERA, camera_record(how.record, how.scene)),
    ]
    if photo is not None:
        content = photo_content(photo, how)
        records.append((PHOTO, image_record(photo.shape[1], photo.shape[0], content, how.record, 3)))
    head, directory, content = 64, b"", b""
    start = head + 32 * (len(records) + SPARE)
    for kind, record in records:
        entry = struct.pack(f"{how.order}HHIIII", kind, 1, 100, 1, start + len(content), len(record))
        directory, content = directory + entry.ljust(32, b"\0"), content + record
    directory += bytes(32 * SPARE)
    fff = b"FFF\0" + b"MTX IR".ljust(16, b"\0")
    fff += struct.pack(f"{how.order}III", 100, head, len(records) + SPARE)
    fff = fff.ljust(head, b"\0") + directory + content
    pieces = [fff[at : at + SEGMENT] for at in range(0, len(fff), SEGMENT)]
    segments = b"".join(
        b"\xff\xe1" + struct.pack(">H", 10 + len(piece)) + b"FLIR\0\1" + bytes([n, len(pieces) - 1]) + piece
        for n, piece in enumerate(pieces)
    )
    shown = io.BytesIO()
    Image.new("L", (width, height), 128).save(shown, "JPEG")
    return shown.getvalue()[:2] + segments + shown.getvalue()[2:]
