"""A disk that takes so many bytes a second, in real time."""

import time

from sensors.session.writer import SessionWriter


def on_disk_of(bytes_per_s: float) -> type[SessionWriter]:
    """A writer of sessions that waits after each chunk until such a disk would have taken it."""

    class OnSlowDisk(SessionWriter):
        _taken, _free_s = 0, 0.0

        def flush(self) -> None:
            super().flush()
            written = self._file.tell()
            self._free_s = max(self._free_s, time.monotonic()) + (written - self._taken) / bytes_per_s
            self._taken = written
            time.sleep(max(0.0, self._free_s - time.monotonic()))

    return OnSlowDisk
