"""Claims: locks that allow one writer at a time for each folder of results, with the writer's name."""

import getpass
import json
import os
import socket
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from filelock import Timeout, UnixFileLock

from sensors.errors import CloudError
from sensors.files.atomic import sweep

CLAIM = "claim.json"
OWNER_BYTES = 4096  # of the note; untuned


class ClaimedError(CloudError):
    """Error of a folder that another process is writing."""


class Claim:
    """Lock for writing a label set, a dataset or a training run, held while its process lives.

    The kernel locks ``claim.json``, so a killed process leaves no claim. The file's content names the owner.
    """

    def __init__(self, path: Path, lock: UnixFileLock) -> None:
        self.path, self._lock, self._id = path, lock, _identity(path)

    @classmethod
    def take(cls, folder: Path, who: str) -> Self:
        """Claim ``folder`` for ``who``, and remove files that killed processes left in it.

        Raises ClaimedError naming the owner when the folder is taken, CloudError when it cannot be written.
        """
        path = folder / CLAIM
        lock = UnixFileLock(path, timeout=0, thread_local=False, mode=0o644, fallback_to_soft=False)
        try:
            folder.stat()  # because the lock would make an absent folder
            lock.acquire()
        except Timeout as error:
            raise ClaimedError(
                f"{folder} is being written by {_owner(path)}; wait until it has finished, "
                "close its window, or open the set read-only"
            ) from error
        except OSError as error:
            raise CloudError(
                f"{folder} cannot be written to ({error.strerror}); open it read-only, or work on a copy"
            ) from error
        claim = cls(path, lock)
        _write_owner(path, who)
        sweep(folder)
        return claim

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the folder; idempotent. A folder that replaced this one keeps its claim file."""
        if self._lock.is_locked:
            with suppress(OSError):
                # Removed while locked: a process that waits for the lock sees that and opens a new file.
                if _identity(self.path) == self._id:
                    self.path.unlink()
            self._lock.release()


def login() -> str:
    """Return the login name of the current user."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "unknown user"


def _identity(path: Path) -> tuple[int, int] | None:
    with suppress(OSError):
        found = path.lstat()
        return found.st_dev, found.st_ino
    return None


def _write_owner(path: Path, who: str) -> None:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    owner = {"who": who, "host": socket.gethostname(), "process": os.getpid(), "since": since}
    # The lock itself needs no space: on a full disk only the name is missing.
    with suppress(OSError), open(path, "wb", opener=_without_links) as file:
        file.write(json.dumps(owner).encode()[:OWNER_BYTES])


def _without_links(name: str, flags: int) -> int:
    return os.open(name, flags | os.O_NOFOLLOW)


def _owner(path: Path) -> str:
    try:
        with path.open("rb") as file:
            owner = json.loads(file.read(OWNER_BYTES))
        who, host, process, since = (str(owner[k])[:60] for k in ("who", "host", "process", "since"))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return "another process"
    return f"{who}@{host} (process {process}, since {since})"
