"""JSON of an export, of which every frame has a part: read whole, but not to any multiple of its size."""

import json
from pathlib import Path
from typing import Any

from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

MAX_VALUES = 30_000_000
"""Values of a file, as its brackets and commas tell: 64 to 120 bytes of memory each. COCO takes 240 for a
frame of eleven parts and a person."""
WIDE = 4
"""Bytes of memory of each character once one of them is beyond the first 65536."""


def load_bounded(path: Path, limit: int) -> Any:  # noqa: ANN401 - whatever is in it
    """A file's content. Raises FormatError when it is too large or of too many values, ValueError else."""
    data = read_bounded(path, limit)
    if not data.isascii() and len(data) > limit // WIDE:
        raise FormatError(f"{path} is larger than {limit // WIDE} bytes and no ASCII; export it in parts")
    if sum(map(data.count, (b"[", b"{", b","))) > MAX_VALUES:
        raise FormatError(f"{path} holds more than {MAX_VALUES} values; export it in parts")
    return json.loads(data)
