"""Lists of time-stamped images in the TUM RGB-D format: ``depth.txt``, ``rgb.txt``, ``associations.txt``.

Lines are ``seconds path``, in associations two such pairs; ``#`` begins a comment.
Source: TUM RGB-D dataset, "File Formats" and its ``associate.py``.
"""

import re
from pathlib import Path, PurePosixPath

from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

ASSOCIATIONS = ("associations.txt", "associate.txt", "assoc.txt", "association.txt")
WINDOW_NS = 20_000_000
"""``associate.py``'s longest time between two images that belong together."""
TUM_UNIT_MM = 0.2
"""Depth PNGs of the TUM datasets have 5000 steps a metre."""
MAX_BYTES = 64_000_000
"""Bytes of a list: a million images; chosen by eye."""

Image = tuple[int, str]
"""An image of a list: its stamp in ns, and its name without folders."""


def is_tum(folder: Path) -> bool:
    """Whether the folder has the lists of a TUM dataset, header included: then depth is in TUM's unit."""
    return (folder / "depth.txt").is_file() and _text(folder / "depth.txt").startswith("# depth maps")


def read_list(file: Path) -> list[Image]:
    """The image of every line of a list. Raises FormatError."""
    return [(_nanoseconds(words[0], file), _name(words[1], file)) for words in _lines(file, 2)]


def read_associations(file: Path) -> list[tuple[Image, Image]]:
    """(depth image, colour image) of every line, in whatever order a line has them. Raises FormatError."""
    pairs = []
    for words in _lines(file, 4):
        first, second = ((_nanoseconds(words[at], file), _name(words[at + 1], file)) for at in (0, 2))
        pairs.append((first, second) if "depth" in words[1].lower() else (second, first))
    return pairs


def _lines(file: Path, words: int) -> list[list[str]]:
    lines = []
    for text in _text(file).splitlines():
        line = text.split(maxsplit=words)
        if not line or text.startswith("#"):
            continue
        if len(line) < words:
            raise FormatError(f"{file}: line {' '.join(line)[:60]!r} has no {words} words; correct it")
        lines.append(line[:words])
    return lines


def _nanoseconds(text: str, file: Path) -> int:
    """Seconds with any number of digits as whole nanoseconds, without a float's rounding."""
    # 64 bits hold nine billion seconds of nanoseconds.
    match = re.fullmatch(r"([0-8]?\d{1,9})(?:\.(\d*))?", text, re.ASCII)
    if match is None:
        raise FormatError(f"{file}: {text[:40]!r} is not a time in seconds; correct it")
    return int(match[1]) * 1_000_000_000 + int((match[2] or "").ljust(9, "0")[:9])


def _name(path: str, file: Path) -> str:
    """An image's name without folders: images are looked for in the folder's own subfolders alone."""
    name = PurePosixPath(path.replace("\\", "/")).name
    if not name or name == ".." or "\0" in name or len(name) > 200:
        raise FormatError(f"{file}: {path[:40]!r} names no image; correct it")
    return name


def _text(file: Path) -> str:
    return read_bounded(file, MAX_BYTES, "split it").decode(errors="replace")
