"""TOML files, read whole up to a bound."""

import tomllib
from pathlib import Path
from typing import Any

from sensors.errors import CloudError, FormatError
from sensors.files.bounded import read_bounded


def read_toml(path: Path, limit: int, remedy: str, error: type[CloudError] = FormatError) -> dict[str, Any]:
    """A TOML file's content. Raises ``error`` where it cannot be read, or is larger than ``limit`` bytes."""
    data = read_bounded(path, limit, remedy, error)
    try:
        return tomllib.loads(data.decode())
    except (ValueError, RecursionError) as cause:
        # A key that stands twice is among these: tomllib says in which line.
        raise error(f"{path} cannot be read ({cause}); {remedy}") from cause
