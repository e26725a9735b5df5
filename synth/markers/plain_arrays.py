"""Arrays of an ``.npz`` of known names and kinds: nothing is unpacked before its size is known and bounded.

Format: numpy.org, "numpy.lib.format"; PKWARE's APPNOTE for the archive.
"""

import io
import math
import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError

MAX_BYTES = 500_000_000
"""Of the file, of what it unpacks to, and of all its numbers at eight bytes each."""
MAX_TEXTS, MAX_TEXT_BYTES = 5000, 4000
MAX_DIRECTORY_BYTES = 65_536
"""Of an archive's list of members, of which ten take one kB."""
_END, _END_BYTES, _LOCATOR_64, _LOCATOR_BYTES = b"PK\5\6", 22, b"PK\6\7", 20
_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
UNREADABLE = (
    *(OSError, ValueError, TypeError, SyntaxError, TokenError, KeyError, OverflowError, MemoryError),
    *(RuntimeError, RecursionError, EOFError, zipfile.BadZipFile, zlib.error),
)
"""What damaged bytes make the libraries raise, to be named as the caller's own error."""

Arrays = dict[str, NDArray[Any]]


def load_arrays(path: Path, kinds: dict[str, str]) -> Arrays:
    """The arrays named, each of one of its dtype kinds ("f", "iu", "U"). Raises FormatError, UNREADABLE."""
    _check_directory(path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.getinfo(f"{name}.npy") for name in kinds}
        if sum(member.file_size for member in members.values()) > MAX_BYTES:
            raise FormatError(f"{path} unpacks to more than {MAX_BYTES} bytes; cut the recording")
        arrays = {name: _array(archive, member, kinds[name]) for name, member in members.items()}
    if sum(8 * array.size for array in arrays.values()) > MAX_BYTES:
        raise FormatError(f"{path} holds more than {MAX_BYTES // 8} numbers; cut the recording")
    return arrays


def _check_directory(path: Path) -> None:
    """zipfile makes an object of each member of the list, whose size is in the file's last bytes."""
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        if size > MAX_BYTES:
            raise FormatError(f"{path} is larger than {MAX_BYTES} bytes; cut the recording")
        file.seek(max(0, size - _END_BYTES - _LOCATOR_BYTES))
        tail = file.read()
    end = tail[-_END_BYTES:]
    # A comment behind, or lists beyond 4 GB, are nothing that numpy writes.
    if end[:4] != _END or end[-2:] != b"\0\0" or tail[:4] == _LOCATOR_64:
        raise ValueError("it is not an archive of arrays, or cut short")
    if int.from_bytes(end[12:16], "little") > MAX_DIRECTORY_BYTES:
        raise ValueError("its archive lists too many members")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, kinds: str) -> NDArray[Any]:
    name = member.filename[:60]
    if member.compress_type not in _PACKINGS:
        raise ValueError(f"{name!r} is packed by method {member.compress_type}")
    with archive.open(member) as file:
        data = file.read(member.file_size)
    stream = io.BytesIO(data)
    read_header = _HEADERS.get(np.lib.format.read_magic(stream))
    if read_header is None:
        raise ValueError(f"{name!r} is of an unknown format")
    shape, fortran, dtype = read_header(stream)
    if dtype.kind not in kinds or min(shape, default=0) < 0:
        raise ValueError(f"{name!r} is {dtype} {shape}")
    if dtype.kind == "U" and (len(shape) != 1 or shape[0] > MAX_TEXTS or dtype.itemsize > MAX_TEXT_BYTES):
        raise ValueError(f"{name!r} is {dtype} {shape}; at most {MAX_TEXTS} texts are read")
    order: Literal["F", "C"] = "F" if fortran else "C"
    if not math.prod(shape):  # frombuffer takes no empty ones
        return np.empty(shape, dtype, order)
    return np.frombuffer(data, dtype, math.prod(shape), stream.tell()).reshape(shape, order=order)
