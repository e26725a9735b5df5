"""Claims: one writer at a time for each folder of results, and the writer's name."""

import fcntl
import getpass
import json
import os
import socket
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from sensors.errors import CloudError
from sensors.files.atomic import sweep

CLAIM = "claim.json"
OWNER_BYTES = 4096
"""Bytes of the file that are written and read. Untuned."""
# Nothing is written through a link to a file outside the folder.
FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW


class ClaimedError(CloudError):
    """Somebody else is writing the folder."""


class Claim:
    """The right to write a label set, a dataset or a training, held while its process lives.

    The kernel's lock on ``claim.json`` (flock) is the claim, so a killed process leaves none behind; the
    file's content only names the owner.
    """

    def __init__(self, path: Path, file: int) -> None:
        self.path, self._file = path, file

    @classmethod
    def take(cls, folder: Path, who: str) -> Self:
        """Claim ``folder`` for ``who``, and sweep up what killed processes left in it.

        Raises ClaimedError naming the owner when it is taken, CloudError when the folder cannot be written.
        """
        path = folder / CLAIM
        try:
            while True:
                file = os.open(path, FLAGS, 0o644)
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if _is_at(file, path):
                        _write_owner(file, who)
                        sweep(folder)
                        return cls(path, file)
                except OSError:
                    os.close(file)
                    raise
                # The owner released and removed the file after it was opened here and before it was locked.
                os.close(file)
        except BlockingIOError as error:
            raise ClaimedError(
                f"{folder} is being written by {_owner(path)}; wait until it has finished, "
                "close its window, or open the set read-only"
            ) from error
        except OSError as error:
            raise CloudError(
                f"{folder} cannot be written to ({error.strerror}); open it read-only, or work on a copy"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the folder; idempotent.

        A folder that took this one's place keeps its claim file.
        """
        if self._file >= 0:
            with suppress(OSError):
                if _is_at(self._file, self.path):
                    self.path.unlink()
            os.close(self._file)
            self._file = -1


def login() -> str:
    """The name of the system's user."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "somebody"


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _write_owner(file: int, who: str) -> None:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    owner = {"who": who, "host": socket.gethostname(), "process": os.getpid(), "since": since}
    os.ftruncate(file, 0)
    # The lock itself needs no space: on a full disk only the name is missing.
    with suppress(OSError):
        os.pwrite(file, json.dumps(owner).encode()[:OWNER_BYTES], 0)


def _owner(path: Path) -> str:
    try:
        with path.open("rb") as file:
            owner = json.loads(file.read(OWNER_BYTES))
        who, host, process, since = (str(owner[k])[:60] for k in ("who", "host", "process", "since"))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return "another process"
    return f"{who}@{host} (process {process}, since {since})"
