"""File names of a recording, and a kernel lock (flock) on the file while it is written.

The kernel releases the lock of a dead process.
"""

import fcntl
import os
import time
from pathlib import Path
from typing import BinaryIO

from sensors.errors import CloudError, FormatError

SUFFIX, PARTIAL = ".mcap", ".partial"
PATIENCE_S, PAUSE_S = 1.0, 0.01  # a writer waits for programs that check the lock, between two tries; untuned


class RecordingError(CloudError):
    """Error of a recording that is still being written."""


def partial_of(path: Path) -> Path:
    """Return the name of the session ``path`` until it is complete."""
    return path.with_name(path.name + PARTIAL)


def final_of(path: Path) -> Path:
    """Return the session's name once it is complete."""
    return path.with_name(path.name.removesuffix(PARTIAL))


def recording_at(path: Path) -> Path:
    """Return the path, or its unfinished recording where only that exists.

    Raises FormatError for pipes, which may block, and for devices, which may never end.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FormatError(f"{path} is a pipe or a device; give a file or a folder")
    return partial_of(path) if not path.exists() and partial_of(path).is_file() else path


def repaired_of(path: Path) -> Path:
    """Return the name of the repaired copy of the session ``path``."""
    return path.with_name(f"{path.name.removesuffix(SUFFIX)}.repaired{SUFFIX}")


def open_locked(path: Path, overwrite: bool) -> BinaryIO:
    """Create a file, or empty one with ``overwrite``, and lock it until it is closed.

    Raises RecordingError while another process writes or repairs it, FileExistsError without ``overwrite``.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | (0 if overwrite else os.O_EXCL)
    file = os.fdopen(os.open(path, flags, 0o666), "r+b" if path.is_file() else "wb")
    try:
        end_s = time.monotonic() + PATIENCE_S
        while not _locked(file, fcntl.LOCK_EX):
            if time.monotonic() > end_s:
                raise RecordingError(
                    f"{path} is in use by another program; end it first, or choose another name"
                )
            time.sleep(PAUSE_S)
        if os.fstat(file.fileno()).st_size:
            file.truncate(0)
    except BaseException:
        file.close()
        raise
    return file


def is_being_recorded(path: Path) -> bool:
    """Return whether a process holds the lock of ``open_locked`` on a file."""
    try:
        with path.open("rb") as file:
            return not _locked(file, fcntl.LOCK_SH)
    except OSError:
        return False


def check_ended(file: BinaryIO) -> None:
    """Lock an open file against writers until it is closed. Raises RecordingError while it is being
    recorded.
    """
    if not _locked(file, fcntl.LOCK_SH):
        raise RecordingError(f"{file.name} is being recorded; end the recording first")


def _locked(file: BinaryIO, kind: int) -> bool:
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True
