"""Files that are either there in full or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sensors.errors import ExistsError, FormatError

# Nobody can put a link to another file where this process will write.
_TOKEN = os.urandom(4).hex()


def check_free(path: Path, overwrite: bool, *, folder: bool = False) -> None:
    """Raise ExistsError when something is there and may not be replaced: before long work, not after it.

    folder: the result is a folder. A file never replaces a folder.
    """
    if path.exists() and not overwrite:
        raise ExistsError(f"{path} already exists; choose another name or pass --overwrite")
    if path.is_dir() and not folder:
        raise ExistsError(f"{path} is a folder; give the name of a file")


def is_taken(folder: Path) -> bool:
    """Whether a new folder has no room there: something lies in it already, or it is a file."""
    return folder.exists() and (not folder.is_dir() or any(folder.iterdir()))


def check_there(*paths: Path) -> None:
    """Raise FormatError for the first that is not there: before what reads it is imported, not after it."""
    for path in paths:
        if not path.exists():
            raise FormatError(f"{path} cannot be read (No such file or directory); check the path")


@contextmanager
def replacing(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; on success it takes its place, on error it is removed.

    The bytes are flushed to the disk before the rename, so a power cut leaves the old or the new file.
    Raises OSError, e.g. when the disk is full, and ExistsError where a file has come to that name meanwhile
    and ``overwrite`` is False.
    """
    temporary = temporary_of(path)
    temporary.unlink(missing_ok=True)
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        check_free(path, overwrite)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Write ``data`` to ``path`` atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def temporary_of(path: Path) -> Path:
    """Name of ``path`` while this process writes it: hidden, beside it, not predictable."""
    return path.with_name(f".{path.name}{_ending()}")


def sweep(folder: Path, pattern: str = "**/.*.partial") -> None:
    """Remove the files and folders below ``folder`` that killed processes were making (``temporary_of``)."""
    for path in list(folder.glob(pattern)):
        if _is_left_over(path.name):
            with suppress(OSError):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _ending() -> str:
    # A forked process has the token of the one it came from.
    return f".{_TOKEN}.{os.getpid()}.partial"


def _is_left_over(name: str) -> bool:
    pid = name.split(".")[-2]
    if pid == str(os.getpid()):
        # In a container the next process often has the number of the killed one.
        return not name.endswith(_ending())
    return pid.isdigit() and not Path("/proc", pid).exists()
