"""Faults of JPEG and PNG bytes that show without decoding."""

import io

from sensors.errors import FormatError

JPEG, JPEG_END = b"\xff\xd8", b"\xff\xd9"
"""First and last marker of a JPEG (ITU-T T.81, table B.1)."""
PNG_END = b"IEND"
"""Name of a PNG's last chunk (W3C PNG, 11.2.5)."""
PADDING_BYTES = 4096
"""Bytes after the last marker that some cameras pad their images with (untuned)."""


def size_of_encoded(encoded: bytes) -> tuple[int, int]:
    """Return width and height of a JPEG or PNG image.

    Raises FormatError, whose text is "none" for bytes that are no image, "cut off" for the beginning of one.
    """
    from PIL import Image

    try:
        with Image.open(io.BytesIO(encoded), formats=("JPEG", "PNG")) as header:
            size = header.size
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FormatError("none") from error
    end = JPEG_END if encoded.startswith(JPEG) else PNG_END
    if encoded.rfind(end, max(0, len(encoded) - PADDING_BYTES)) < 0:
        raise FormatError("cut off")
    return size
