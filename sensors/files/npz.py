"""Arrays of an ``.npz`` file, unpacked only where their sizes together are bounded; pickles are refused."""

from collections.abc import Collection
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError


def array_sizes(path: Path, remedy: str) -> dict[str, int]:
    """Bytes of each array once unpacked, by name. Raises FormatError where the file is no archive."""
    try:
        with ZipFile(path) as archive:
            return {member.filename.removesuffix(".npy"): member.file_size for member in archive.infolist()}
    except Exception as error:  # zipfile raises a dozen kinds at damaged bytes
        raise FormatError(f"{path} cannot be read ({error}); {remedy}") from error


def load_arrays(
    path: Path, limit_bytes: int, remedy: str, names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Arrays by name: all of the file's, or those of ``names`` that it has.

    Raises FormatError where the file is damaged, an array is none or pickled, or they unpack to more than
    ``limit_bytes`` together; the message ends with ``remedy``.
    """
    sizes = {n: size for n, size in array_sizes(path, remedy).items() if names is None or n in names}
    if sum(sizes.values()) > limit_bytes:
        raise FormatError(f"{path} unpacks to {sum(sizes.values())} bytes, over {limit_bytes}; {remedy}")
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in sizes}
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds at damaged bytes
        raise FormatError(f"{path} cannot be read ({error}); {remedy}") from error
    for name, array in arrays.items():
        # Of a type of no bytes, such as empty texts, there may be any number.
        if not isinstance(array, np.ndarray) or array.size > limit_bytes:
            raise FormatError(f"{path}: {name[:60]!r} is not an array; {remedy}")
    return arrays
