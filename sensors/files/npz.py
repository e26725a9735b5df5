"""Arrays of an ``.npz`` file, unpacked up to a bound on their total size; pickles are refused."""

from collections.abc import Collection
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import check_file


def array_sizes(path: Path, remedy: str) -> dict[str, int]:
    """Return the unpacked bytes of each array. Raises FormatError where the file is not an archive."""
    check_file(path, remedy)
    try:
        with ZipFile(path) as archive:
            return {member.filename.removesuffix(".npy"): member.file_size for member in archive.infolist()}
    except Exception as error:  # zipfile raises a dozen kinds at damaged bytes
        raise FormatError(f"{path} cannot be read ({error}); {remedy}") from error


def load_arrays(
    path: Path, limit_bytes: int, remedy: str, names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Return all arrays of a file by name, or the ones in ``names`` that it has.

    Raises FormatError where the file is damaged, holds anything but arrays, or unpacks to more than
    ``limit_bytes``; the message ends with ``remedy``.
    """
    sizes = {n: size for n, size in array_sizes(path, remedy).items() if names is None or n in names}
    if sum(sizes.values()) > limit_bytes:
        raise FormatError(f"{path} unpacks to {sum(sizes.values())} bytes, limit {limit_bytes}; {remedy}")
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in sizes}
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds at damaged bytes
        raise FormatError(f"{path} cannot be read ({error}); {remedy}") from error
    for name, array in arrays.items():
        # Items of no bytes, such as empty texts, may be of any number.
        if not isinstance(array, np.ndarray) or array.size > limit_bytes:
            raise FormatError(f"{path}: {name[:60]!r} is not an array; {remedy}")
    return arrays
