"""Export of another tool (folder, archive .zip, or annotation file), opened as a folder."""

import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import NamedTuple
from zipfile import BadZipFile, LargeZipFile, ZipFile, is_zipfile

from sensors.errors import CalibrationError, FormatError

MAX_FILES = 2_000_000  # of an archive; a million frames have two each; untuned
FREE_SHARE = 0.8  # of the free disk that an unpacked archive may take; untuned
ENCRYPTED = 1  # bit of an entry's flags (APPNOTE 4.4.4)
OF_FOLDERS = "annotations"  # where COCO's layout keeps its annotation files


class Export(NamedTuple):
    """Export of another tool, opened as a folder. annotations: the given annotation file, or None for the
    folder's.
    """

    folder: Path
    annotations: Path | None = None


@contextmanager
def unpacked(source: Path) -> Iterator[Export]:
    """Yield an export as a folder, temporary for an archive. Raises FormatError."""
    if source.is_file() and is_zipfile(source):
        with TemporaryDirectory() as name, _named(source, name):
            yield Export(_extracted(source, Path(name)))
    elif source.is_file() and source.suffix.lower() in (".json", ".xml"):
        file = source.resolve()
        folder = file.parent
        yield Export(folder.parent if folder.name == OF_FOLDERS else folder, file)
    else:
        yield Export(source)


@contextmanager
def _named(archive: Path, folder: str) -> Iterator[None]:
    """Name the archive instead of the temporary folder in error messages."""
    try:
        yield
    except (FormatError, CalibrationError) as error:
        raise type(error)(str(error).replace(folder, str(archive)), *error.settings) from error


def _extracted(archive: Path, folder: Path) -> Path:
    """Unpack an archive into a folder; return the folder, without outer folders that hold only one folder."""
    try:
        with ZipFile(archive) as file:
            entries = file.infolist()
            size, room = sum(entry.file_size for entry in entries), shutil.disk_usage(folder).free
            if len(entries) > MAX_FILES:
                raise FormatError(
                    f"{archive} has {len(entries)} files, over {MAX_FILES}; unpack it and give the folder"
                )
            if size > FREE_SHARE * room:
                raise FormatError(
                    f"{archive} unpacks to {size} bytes, too many for {gettempdir()}, which has {room} free; "
                    "unpack it elsewhere and give the folder"
                )
            if any(entry.flag_bits & ENCRYPTED for entry in entries):
                raise FormatError(f"{archive} is encrypted; unpack it with its password and give the folder")
            for entry in entries:
                # Some programs for Windows write their own slash, against the format (APPNOTE 4.4.17).
                entry.filename = entry.filename.replace("\\", "/")
                # extract keeps every entry inside the folder, and writes links as files.
                file.extract(entry, folder)
    except OSError as error:
        raise FormatError(
            f"{archive} cannot be unpacked ({error.strerror}); unpack it yourself and give the folder"
        ) from error
    except (BadZipFile, LargeZipFile, zlib.error, RuntimeError, EOFError) as error:
        raise FormatError(f"{archive} cannot be unpacked ({error}); download it again") from error
    return _innermost(folder)


def _innermost(folder: Path) -> Path:
    while True:
        inside = [path for path in folder.iterdir() if path.name != "__MACOSX"]
        if len(inside) != 1 or not inside[0].is_dir() or inside[0].name == OF_FOLDERS:
            return folder
        folder = inside[0]
