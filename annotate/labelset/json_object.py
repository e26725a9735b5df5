"""JSON objects of a label set: manifests and frames, bounded on reading."""

import json
from pathlib import Path
from typing import Any

from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

MAX_JSON_BYTES = 16_000_000  # of a manifest or a frame


def encode_object(value: dict[str, Any]) -> bytes:
    """Encode an object with sorted keys, so that equal objects have equal bytes."""
    return (json.dumps(value, indent=1, sort_keys=True) + "\n").encode()


def read_object(path: Path) -> dict[str, Any]:
    """Read the object of a file. Raises FormatError naming the file."""
    data = read_bounded(path, MAX_JSON_BYTES)
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path} is corrupt ({error}); restore it from a copy") from error
    if not isinstance(value, dict):
        raise FormatError(f"{path} holds no JSON object; restore it from a copy")
    return value
