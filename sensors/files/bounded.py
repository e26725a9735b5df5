"""Files from outside, read up to a size limit."""

import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from sensors.errors import CloudError, FormatError

MAX_IMAGE_SIDE = 8192  # pixels; bounds the memory that a header can claim; twice a 4K image
MAX_IMAGE_BYTES = 1 << 28  # twice the largest image of 16 bits a pixel


def read_bounded(
    path: Path,
    limit: int = MAX_IMAGE_BYTES,
    remedy: str = "restore it from a copy",
    error: type[CloudError] = FormatError,
) -> bytes:
    """Return a file's bytes. Raises ``error`` where the path is not a readable file of ``limit`` bytes."""
    try:
        data = _read(path, limit)
    except IsADirectoryError as cause:
        raise error(f"{path} is a folder, not a file; {remedy}") from cause
    except (OSError, ValueError) as cause:
        why = getattr(cause, "strerror", None) or cause
        raise error(f"{path} cannot be read ({why}); {remedy}") from cause
    if data is None:
        raise error(f"{path} is not a file; {remedy}")
    if len(data) > limit:
        raise error(f"{path} is larger than {limit} bytes; {remedy}")
    return data


def check_file(path: Path, remedy: str) -> None:
    """Raise FormatError for a folder, for a pipe, which may block, and for a device, which may never end."""
    if path.is_dir():
        raise FormatError(f"{path} is a folder, not a file; {remedy}")
    if path.exists() and not path.is_file():
        raise FormatError(f"{path} is not a file; {remedy}")


def _read(path: Path, limit: int) -> bytes | None:
    """Return at most ``limit`` + 1 bytes; None for pipes, which may block, and devices, which never end."""
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            return None
        data = file.read(min(found.st_size, limit) + 1)
        if len(data) > found.st_size:  # the file has grown, or states a size of 0 (/proc)
            data += file.read(limit + 1 - len(data))
        return data


def read_toml(path: Path, limit: int, remedy: str, error: type[CloudError] = FormatError) -> dict[str, Any]:
    """Return a TOML file's content. Raises ``error`` where it is malformed or over ``limit`` bytes."""
    data = read_bounded(path, limit, remedy, error)
    try:
        return tomllib.loads(data.decode())
    except (ValueError, RecursionError) as cause:
        raise error(f"{path} cannot be read ({cause}); {remedy}") from cause
