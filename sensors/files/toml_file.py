"""TOML files from outside, of bounded size, keys and depth."""

import tomllib
from pathlib import Path
from typing import Any

from sensors.errors import CloudError, FormatError
from sensors.files.bounded import read_bounded

MAX_DOTS = 100
"""Full stops a line may have: time and memory of ``tomllib`` grow with the square of a dotted key's."""
MAX_DEPTH = 5
_INTEGERS = range(-(1 << 63), 1 << 63)
"""TOML's; Python refuses to print much larger ones."""


def read_toml(path: Path, limit: int, remedy: str, error: type[CloudError] = FormatError) -> dict[str, Any]:
    """A TOML file's content. Raises ``error`` where it cannot be read, or is large, deep or no TOML."""
    data = read_bounded(path, limit, remedy, error)
    try:
        return _shallow(tomllib.loads(_plain(data.decode())))
    except (ValueError, RecursionError, OverflowError) as cause:
        # A key that stands twice is among these: tomllib says in which line.
        raise error(f"{path} cannot be read ({cause}); {remedy}") from cause


def _plain(text: str) -> str:
    # Those in quotes count as well: what is quoted depends on the lines before. A key ends with its line,
    # and of all line ends only this one is TOML's.
    if any(line.count(".") > MAX_DOTS for line in text.split("\n")):
        raise ValueError(f"a line has more than {MAX_DOTS} full stops")
    return text


def _shallow(fields: dict[str, Any]) -> dict[str, Any]:
    """The fields, where any of them can be printed. Raises ValueError."""
    level: list[Any] = [fields]
    for _ in range(MAX_DEPTH):
        inner = [v for c in level for v in (c.values() if isinstance(c, dict) else c)]
        if any(isinstance(value, int) and value not in _INTEGERS for value in inner):
            raise ValueError("a number has more than 64 bits")
        level = [value for value in inner if isinstance(value, dict | list)]
    if level:
        raise ValueError(f"tables are more than {MAX_DEPTH} deep")
    return fields
