"""Scheme of parts in a manifest. A manifest without the entry is of the scheme ``paper``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from annotate.scheme.scheme_file import scheme_from_fields, scheme_to_fields
from sensors.errors import FormatError

SCHEME = "scheme"
"""Manifest entry: the fields of a scheme file."""


def scheme_note(scheme: Scheme) -> dict[str, Any]:
    """Return the manifest entry that holds a scheme; empty for ``paper``."""
    return {} if scheme == PAPER else {SCHEME: scheme_to_fields(scheme)}


def scheme_in(info: Mapping[str, Any], manifest: Path) -> Scheme:
    """Return the scheme of a manifest. Raises FormatError naming the file."""
    if SCHEME not in info:
        return PAPER
    try:
        return scheme_from_fields(info[SCHEME])
    except FormatError as error:
        raise FormatError(f"{manifest}: field {SCHEME} is malformed: {error}") from error


def check_scheme(frame_id: str, scheme: Scheme, folder: Path, required: Scheme) -> None:
    """Raise FormatError for a frame of another scheme than its folder's."""
    if scheme != required:
        raise FormatError(
            f"frame {frame_id} has scheme {scheme.name!r}, {folder} has {required.name!r}; "
            "convert the frame's label set first"
        )
