"""Journal of a label set: each stroke (a person's action) is a line, on disk before the next stroke
begins.
"""

import os
import stat
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from annotate.labelset.stroke import Stroke, check_ids, from_line, to_line
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import replacing
from sensors.files.natural_order import in_order

JOURNAL = "journal.jsonl"
MAX_BYTES = 4_000_000_000  # a stroke takes one or two kilobytes
# Links to files outside the set and pipes are refused.
FLAGS = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
REMEDY = "restore it from a copy, or move it and original/ away to continue from the last saved labels"


class NotSavedError(CloudError):
    """Error of a write that the disk refused. The strokes stay in memory and are written later."""


@contextmanager
def nothing_changed(path: Path) -> Iterator[None]:
    """Raise NotSavedError instead of OSError, for a failed write that changed no file."""
    try:
        yield
    except OSError as error:
        raise NotSavedError(
            f"{error.filename or path} cannot be written ({error.strerror}); nothing was changed: free some "
            "space or repair the disk, and do it again"
        ) from error


class Journal:
    """Append-only file of strokes. Only the process with the ``Claim`` may append; any may read.

    A line is complete with its newline. Bytes after the last newline are from a crash: they are ignored, and
    removed by the next append.
    """

    def __init__(self, path: Path, scheme: Scheme = PAPER) -> None:
        """Read the journal at ``path``; an absent file is an empty one. scheme: of the label set.

        Raises FormatError naming the first invalid line.
        """
        self.path = path
        self._by_frame: defaultdict[str, list[Stroke]] = defaultdict(list)
        self._pending: list[Stroke] = []
        self._end = 0
        for number, line in enumerate(self._lines(), 1):
            try:
                stroke = from_line(line)
                check_ids(stroke, scheme)
            except FormatError as error:
                raise FormatError(f"{path} line {number}: {error}; {REMEDY}") from error
            self._by_frame[stroke.frame_id].append(stroke)
            self._end += len(line)

    @classmethod
    def of(cls, folder: Path, scheme: Scheme = PAPER) -> Self:
        """Open the journal of a label set's folder. scheme: of the label set."""
        return cls(folder / JOURNAL, scheme)

    def __len__(self) -> int:
        return sum(map(len, self._by_frame.values()))

    def strokes(self, frame_id: str) -> Sequence[Stroke]:
        """Return a frame's entries, the oldest first, including unwritten ones."""
        return self._by_frame.get(frame_id, ())

    @property
    def frame_ids(self) -> list[str]:
        """Return the ids of the frames with entries, in natural order."""
        return in_order(self._by_frame)

    @property
    def pending(self) -> Sequence[Stroke]:
        """Return the entries that are not on the disk yet."""
        return self._pending

    def add(self, stroke: Stroke) -> None:
        """Add an entry in memory; ``flush`` writes it to the disk."""
        self._by_frame[stroke.frame_id].append(stroke)
        self._pending.append(stroke)

    def flush(self) -> None:
        """Append the pending entries and wait for the disk.

        Raises NotSavedError; the entries stay pending and a half-written line is removed.
        """
        if not self._pending:
            return
        lines = b"".join(to_line(stroke) for stroke in self._pending)
        try:
            self._append(lines)
        except OSError as error:
            raise NotSavedError(
                f"{self.path} cannot be written ({error.strerror}); {len(self._pending)} strokes are kept in "
                "memory: free some space or repair the disk, and continue"
            ) from error
        self._end += len(lines)
        self._pending.clear()

    def add_together(self, strokes: Sequence[Stroke]) -> None:
        """Write entries to the disk atomically: all or none. Raises NotSavedError when the disk refuses."""
        self.flush()
        lines = b"".join(to_line(stroke) for stroke in strokes)
        with (
            nothing_changed(self.path),
            replacing(self.path) as temporary,
            temporary.open("xb") as file,
        ):
            file.writelines(self._lines())
            file.write(lines)
        self._end += len(lines)
        for stroke in strokes:
            self._by_frame[stroke.frame_id].append(stroke)

    def _append(self, lines: bytes) -> None:
        file = os.open(self.path, os.O_WRONLY | os.O_CREAT | FLAGS, 0o644)
        try:
            size = os.fstat(file).st_size
            if size < self._end:
                raise OSError(0, "another program has shortened it")
            if size > self._end:
                os.ftruncate(file, self._end)
            _write(file, lines, self._end)
            os.fdatasync(file)
        except OSError:
            with suppress(OSError):
                if os.fstat(file).st_size > self._end:
                    os.ftruncate(file, self._end)
            raise
        finally:
            os.close(file)

    def _lines(self) -> Iterator[bytes]:
        """Yield the complete lines; lines appended during the iteration are left out."""
        try:
            with open(self.path, "rb", opener=lambda name, flags: os.open(name, flags | FLAGS)) as file:
                found = os.fstat(file.fileno())
                if not stat.S_ISREG(found.st_mode):
                    raise FormatError(f"{self.path} is not a file; {REMEDY}")
                if found.st_size > MAX_BYTES:
                    raise FormatError(f"{self.path} is larger than {MAX_BYTES} bytes; {REMEDY}")
                left = found.st_size
                for line in file:
                    left -= len(line)
                    # A line appended meanwhile may begin within a truncated one.
                    if left < 0 or not line.endswith(b"\n"):
                        return
                    yield line
        except FileNotFoundError:
            return
        except OSError as error:
            raise FormatError(f"{self.path} cannot be read ({error.strerror}); {REMEDY}") from error


def _write(file: int, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while len(view):
        written = os.pwrite(file, view, offset)
        view, offset = view[written:], offset + written
