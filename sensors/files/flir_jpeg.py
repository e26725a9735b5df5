"""FLIR's radiometric JPEG images: temperatures, by flyr (extra ``flir``, EUPL 1.2)."""

import io

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError


def decode_flir(data: bytes, name: str) -> NDArray[np.float32]:
    """Degrees Celsius float32 (h, w), with the emissivity and distance that the file states.

    Raises FormatError for another JPEG, and where flyr is not installed.
    """
    try:
        import flyr
    except ImportError as error:
        raise FormatError(f"{name} needs flyr to be read; pip install 'annotate-cloud[flir]'") from error
    try:
        celsius = flyr.unpack(io.BytesIO(data)).celsius
    # What flyr raises for a broken file is not documented.
    except Exception as error:
        raise FormatError(
            f"{name} holds no temperatures ({error}); give a FLIR camera's radiometric JPEG"
        ) from error
    return np.asarray(celsius, np.float32)
