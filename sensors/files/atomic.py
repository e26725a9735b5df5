"""Atomic files: a file exists in full or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sensors.errors import CloudError, ExistsError, FormatError, Setting

FILE_SUFFIXES = (".mcap", ".onnx", ".safetensors", ".npz", ".toml", ".json", ".html", ".tar")
"""Suffixes of files that this program writes."""
_TOKEN = os.urandom(4).hex()  # unpredictable, so that no link can wait at a temporary name


def check_suffix(path: Path, *suffixes: str) -> None:
    """Raise CloudError where a result's name ends in none of the suffixes; "" = a name without suffix."""
    if path.suffix.lower() not in suffixes:
        has = f"has the suffix {path.suffix!r}" if path.suffix else "has no suffix"
        raise CloudError(f"{path} {has}; give a name that ends in {' or '.join(filter(None, suffixes))}")


def check_free(path: Path, overwrite: bool, *, folder: bool = False, suffix: str = "") -> None:
    """Raise ExistsError where a result exists and ``overwrite`` is False, or where it is a folder and
    ``folder`` is False; CloudError where its name has another suffix than ``suffix``, if any.
    """
    if suffix:
        check_suffix(path, suffix, "")
    if path.is_dir() and not folder:
        raise ExistsError(f"{path} is a folder; give the name of a file")
    if os.path.lexists(path) and not overwrite:  # a dangling link too
        raise ExistsError(f"{path} already exists; choose another name", Setting.OVERWRITE)


def check_folder_name(path: Path) -> None:
    """Raise CloudError where a new folder has the name of a file that this program writes."""
    if path.suffix.lower() in FILE_SUFFIXES and not path.exists():
        raise CloudError(f"{path} has the suffix {path.suffix!r} of a file; give the name of a folder")


def is_taken(folder: Path) -> bool:
    """Return whether the path of a new folder is a file or a folder with content."""
    return folder.exists() and (not folder.is_dir() or any(folder.iterdir()))


def check_there(*paths: Path) -> None:
    """Raise FormatError for the first path that does not exist."""
    for path in paths:
        if not path.exists():
            raise FormatError(f"{path} cannot be read (No such file or directory); check the path")


@contextmanager
def replacing(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` and rename it on success, remove it on error.

    The bytes are flushed first, so a power cut leaves the old or the new file. Raises OSError, and
    ExistsError where ``path`` has come to exist and ``overwrite`` is False.
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
    """Return the hidden name beside ``path`` under which this process writes it."""
    return path.with_name(f".{path.name}{_ending()}")


def sweep(folder: Path, pattern: str = "**/.*.partial") -> None:
    """Remove the temporary files and folders of killed processes below ``folder``."""
    for path in list(folder.glob(pattern)):
        if _is_left_over(path.name):
            with suppress(OSError):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _ending() -> str:
    return f".{_TOKEN}.{os.getpid()}.partial"


def _is_left_over(name: str) -> bool:
    pid = name.split(".")[-2]
    if pid == str(os.getpid()):  # in a container the next process often has the number of the killed one
        return not name.endswith(_ending())
    return pid.isdigit() and not Path("/proc", pid).exists()
