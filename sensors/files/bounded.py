"""Files from outside, read whole only up to a size bound."""

import os
import stat
from pathlib import Path
from typing import Any

from sensors.errors import CloudError, FormatError

MAX_IMAGE_SIDE = 8192
"""Pixels of an image's side, which bound the memory a header can ask for; chosen by eye, twice a 4K image."""
MAX_IMAGE_BYTES = 1 << 28
"""Bytes of an image file: room for the largest image, 16 bits a pixel, twice over; chosen by eye."""


def read_bounded(
    path: Path,
    limit: int = MAX_IMAGE_BYTES,
    remedy: str = "restore it from a copy",
    error: type[CloudError] = FormatError,
) -> bytes:
    """A file's bytes. Raises ``error`` when it cannot be read, is no file, or is larger than ``limit``."""
    try:
        data = _read(path, limit)
    except (OSError, ValueError) as cause:
        why = getattr(cause, "strerror", None) or cause
        raise error(f"{path} cannot be read ({why}); {remedy}") from cause
    if data is None:
        raise error(f"{path} is not a file; {remedy}")
    if len(data) > limit:
        raise error(f"{path} is larger than {limit} bytes; {remedy}")
    return data


def _read(path: Path, limit: int) -> bytes | None:
    """At most ``limit`` + 1 bytes; None of what is no file: pipes may block and devices never end."""
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            return None
        # As much memory as the file needs, not as it may need.
        data = file.read(min(found.st_size, limit) + 1)
        if len(data) > found.st_size:
            # It has grown since, or is one of /proc, whose sizes are 0.
            data += file.read(limit + 1 - len(data))
        return data


def read_toml(path: Path, limit: int, remedy: str, error: type[CloudError] = FormatError) -> dict[str, Any]:
    """A TOML file's content. Raises ``error`` where it cannot be read, or is larger than ``limit`` bytes."""
    import tomllib

    data = read_bounded(path, limit, remedy, error)
    try:
        return tomllib.loads(data.decode())
    except (ValueError, RecursionError) as cause:
        # A key that stands twice is among these: tomllib says in which line.
        raise error(f"{path} cannot be read ({cause}); {remedy}") from cause
