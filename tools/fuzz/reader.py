"""Reader of files from outside, and its faults on damaged files."""

import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sensors.errors import CloudError


@dataclass(frozen=True)
class Reader:
    """make: write a valid sample into an empty folder, return its path. read: read all of the sample."""

    make: Callable[[Path], Path]
    read: Callable[[Path], object]


class Sample:
    """A reader's sample in a folder, whose files can be replaced."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self._read = reader.read
        folder.mkdir(exist_ok=True)
        self._target = reader.make(folder)
        found = (path for path in sorted(folder.rglob("*")) if path.is_file())
        self.files = {path: path.read_bytes() for path in found}

    def fault(self, changed: dict[Path, bytes]) -> str:
        """Return the fault of reading these contents; "" for a good end or a refusal in one line."""
        for path, data in (self.files | changed).items():
            path.write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._read(self._target)
        except CloudError as error:
            return "" if str(error).isprintable() else f"message of several lines: {error!r}"
        except Exception:
            return traceback.format_exc()
        return ""
