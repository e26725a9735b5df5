"""Files from outside are read whole only up to a bound: what is larger is not what it claims to be."""

from pathlib import Path

from sensors.errors import CloudError, FormatError

MAX_IMAGE_BYTES = 1 << 28


def read_bounded(
    path: Path,
    limit: int = MAX_IMAGE_BYTES,
    remedy: str = "restore it from a copy",
    error: type[CloudError] = FormatError,
) -> bytes:
    """A file's bytes. Raises ``error`` when it cannot be read or is larger than ``limit``."""
    try:
        if path.stat().st_size <= limit:
            return path.read_bytes()
    except (OSError, ValueError) as cause:
        why = getattr(cause, "strerror", None) or cause
        raise error(f"{path} cannot be read ({why}); {remedy}") from cause
    raise error(f"{path} is larger than {limit} bytes; {remedy}")
