"""A FLIR camera's radiometric JPEG, built from what ExifTool documents of its records (FLIR tags)."""

import io
import struct

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


def raw_of(celsius: np.ndarray) -> np.ndarray:
    """Words of a camera at distance 0 of a black body: Planck's law by its five constants."""
    r1, r2, b, f, o = PLANCK.values()
    return np.rint(r1 / (r2 * (np.exp(b / (celsius + 273.15)) - f)) - o).astype(np.uint16)


def camera_record() -> bytes:
    """Emissivity 1, distance 0, a window that lets all through."""
    record = bytearray(900)
    room_k = 293.15
    struct.pack_into("<ffffff", record, 32, 1.0, 0.0, room_k, room_k, room_k, 1.0)
    struct.pack_into("<f", record, 60, 0.5)
    struct.pack_into("<fff", record, 88, PLANCK["r1"], PLANCK["b"], PLANCK["f"])
    struct.pack_into("<fffff", record, 112, 0.006569, 0.01262, -0.002276, -0.00667, 1.9)
    struct.pack_into("<if", record, 776, PLANCK["o"], PLANCK["r2"])
    return bytes(record)


def image_record(width: int, height: int, content: bytes) -> bytes:
    return struct.pack("<HHH", 2, width, height).ljust(32, b"\0") + content


def flir_jpeg(celsius: np.ndarray, photo: np.ndarray | None = None) -> bytes:
    """A grey JPEG that holds temperatures (h, w), and a photograph (h', w', 3) RGB if there is one."""
    height, width = celsius.shape
    records = [
        (RAW, image_record(width, height, raw_of(celsius).astype("<u2").tobytes())),
        (CAMERA, camera_record()),
    ]
    if photo is not None:
        jpeg = cv2.imencode(".jpg", photo[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
        records.append((PHOTO, image_record(photo.shape[1], photo.shape[0], jpeg)))
    head, directory, content = 64, b"", b""
    start = head + 32 * (len(records) + SPARE)
    for kind, record in records:
        entry = struct.pack(">HHIIII", kind, 1, 100, 1, start + len(content), len(record))
        directory, content = directory + entry.ljust(32, b"\0"), content + record
    directory += bytes(32 * SPARE)
    fff = b"FFF\0" + b"MTX IR".ljust(16, b"\0") + struct.pack(">III", 100, head, len(records) + SPARE)
    fff = fff.ljust(head, b"\0") + directory + content
    pieces = [fff[at : at + SEGMENT] for at in range(0, len(fff), SEGMENT)]
    segments = b"".join(
        b"\xff\xe1" + struct.pack(">H", 10 + len(piece)) + b"FLIR\0\1" + bytes([n, len(pieces) - 1]) + piece
        for n, piece in enumerate(pieces)
    )
    shown = io.BytesIO()
    Image.new("L", (width, height), 128).save(shown, "JPEG")
    return shown.getvalue()[:2] + segments + shown.getvalue()[2:]
