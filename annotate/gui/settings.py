"""Settings of the window in an ini file: geometry, looks, tool, frame orders, recordings."""

import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar
from urllib.parse import quote

from PySide6.QtCore import QByteArray, QSettings

from annotate.correction.correction import Correction

T = TypeVar("T")


class Memory:
    """Stored settings. path: of the ini file, None to store nothing. Invalid values count as missing."""

    def __init__(self, path: Path | None) -> None:
        self._file = QSettings(str(path), QSettings.Format.IniFormat) if path else None

    def choice(self, key: str, known: Iterable[T], default: T) -> T:
        """Return the stored value if it is among ``known``, else the default."""
        text = str(self._stored(key))
        return next((value for value in known if str(value) == text), default)

    def number(self, key: str, default: float) -> float:
        """Return the stored number if it is finite, else the default."""
        try:
            value = float(str(self._stored(key)))
        except ValueError:
            return default
        return value if math.isfinite(value) else default

    def state(self, key: str) -> QByteArray:
        """Return the stored state of a widget, empty if absent."""
        value = self._stored(key)
        return value if isinstance(value, QByteArray) else QByteArray()

    def recording(self, labels: Path) -> Path | None:
        """Return the stored recording of a label set, if it still exists."""
        path = self._stored(_named("recordings", labels.resolve()))
        return Path(path) if isinstance(path, str) and path and Path(path).exists() else None

    def put(self, key: str, value: object) -> None:
        """Store a value."""
        if self._file is not None:
            self._file.setValue(key, value if isinstance(value, QByteArray) else str(value))

    def put_recording(self, labels: Path, recording: Path) -> None:
        """Store the recording of a label set."""
        self.put(_named("recordings", labels.resolve()), recording.resolve())
        self.save()

    def save(self) -> None:
        """Write the file; an error of the disk is ignored."""
        if self._file is not None:
            self._file.sync()

    def _stored(self, key: str) -> object:
        return None if self._file is None else self._file.value(key)


def order_key(correction: Correction) -> str:
    """Return the settings key under which the frame order of one person and one label set is stored."""
    return _named("orders", f"{correction.labels.path.resolve()} {correction.who}")


def memory_path() -> Path:
    """Return window.ini in the user's folder for states (XDG Base Directory Specification 0.8)."""
    home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return (Path(home) / "annotate-cloud" / "window.ini").expanduser()


def _named(group: str, name: object) -> str:
    """Return a settings key for any name; slashes are escaped, because they would make groups."""
    return f"{group}/{quote(str(name), safe='')}"
