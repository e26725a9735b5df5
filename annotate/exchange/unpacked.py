"""An export of another tool as a folder: the folder itself, an archive (.zip), or its annotation file."""

import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from zipfile import BadZipFile, LargeZipFile, ZipFile, is_zipfile

from sensors.errors import FormatError

MAX_FILES = 2_000_000
"""Files of an archive at most: a million frames have two each. Untuned."""
FREE_SHARE = 0.8
"""Share of the free disk that an unpacked archive takes at most. Untuned."""
OF_FOLDERS = "annotations"
"""Folder in which COCO's layout keeps its annotation files."""


@contextmanager
def unpacked(source: Path) -> Iterator[Path]:
    """Yield the folder of an export, which is temporary for an archive. Raises FormatError."""
    if source.is_file() and is_zipfile(source):
        with TemporaryDirectory() as name:
            yield _extracted(source, Path(name))
    elif source.is_file() and source.suffix.lower() in (".json", ".xml"):
        folder = source.resolve().parent
        yield folder.parent if folder.name == OF_FOLDERS else folder
    else:
        yield source


def _extracted(archive: Path, folder: Path) -> Path:
    """Unpack an archive; return its own only folder, where it has no other entry."""
    try:
        with ZipFile(archive) as file:
            entries = file.infolist()
            size, room = sum(entry.file_size for entry in entries), shutil.disk_usage(folder).free
            if len(entries) > MAX_FILES or size > FREE_SHARE * room:
                raise FormatError(
                    f"{archive} unpacks to {len(entries)} files of {size} bytes; {gettempdir()} has "
                    f"{room} bytes free: unpack it elsewhere and give the folder"
                )
            # extractall keeps every entry inside the folder, and writes links as files.
            file.extractall(folder)
    except (BadZipFile, LargeZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise FormatError(f"{archive} cannot be unpacked ({error}); download it again") from error
    inside = [path for path in folder.iterdir() if path.name != "__MACOSX"]
    return inside[0] if len(inside) == 1 and inside[0].is_dir() and inside[0].name != OF_FOLDERS else folder
