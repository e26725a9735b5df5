"""FLIR's radiometric JPEG images: temperatures and photograph, by flyr (extra ``flir``, EUPL 1.2)."""

import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE, read_bounded

_SEGMENT = re.compile(rb"\xff\xe1..FLIR\0", re.DOTALL)
"""What a JPEG's segment with FLIR's data begins with (ExifTool, FLIR tags)."""


class FlirImage(NamedTuple):
    """Contents of one file. celsius: float32 (h, w). photo: uint8 (h', w', 3) RGB of the camera beside, or
    None."""

    celsius: NDArray[np.float32]
    photo: NDArray[np.uint8] | None


def is_flir(path: Path) -> bool:
    """Whether a JPEG holds FLIR's data."""
    return _SEGMENT.search(read_bounded(path)) is not None


def read_flir(data: bytes, name: str) -> FlirImage:
    """Degrees Celsius with the emissivity and distance that the file states, and its photograph.

    Raises FormatError for another JPEG, and where flyr is not installed.
    """
    try:
        import flyr
    except ImportError as error:
        raise FormatError(f"{name} needs flyr to be read; pip install 'annotate-cloud[flir]'") from error
    try:
        found = flyr.unpack(io.BytesIO(data))
        celsius, photo = np.asarray(found.celsius, np.float32), found.optical
    # What flyr raises for a broken file is not documented.
    except Exception as error:
        raise FormatError(
            f"{name} holds no temperatures ({error}); give a FLIR camera's radiometric JPEG"
        ) from error
    if celsius.ndim != 2 or not 0 < max(celsius.shape) <= MAX_IMAGE_SIDE:
        raise FormatError(
            f"{name} states {celsius.shape} temperatures; give a file as the FLIR camera wrote it"
        )
    rgb = photo is not None and np.ndim(photo) == 3 and np.shape(photo)[2] == 3
    return FlirImage(celsius, np.asarray(photo, np.uint8) if rgb else None)
