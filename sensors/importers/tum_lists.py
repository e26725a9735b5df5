"""Lists of images in the TUM RGB-D format: ``depth.txt``, ``rgb.txt``, ``associations.txt``.

Lines are ``seconds path``, in associations two such pairs; ``#`` begins a comment. ICL-NUIM and others write
the image's number in place of the seconds. Sources: TUM RGB-D dataset, "File Formats" and its
``associate.py``; ICL-NUIM, "TUM RGB-D compatible PNGs"; ETH3D SLAM, ``associated.txt``; Bonn RGB-D Dynamic.
"""

import re
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.pairing import pair_stamps

ASSOCIATIONS = ("associations.txt", "associate.txt", "associated.txt", "assoc.txt", "association.txt")
DEPTH_LIST, COLOR_LIST = "depth.txt", "rgb.txt"
WINDOW_NS = 20_000_000  # associate.py's longest time between two images of a pair
TUM_UNIT_MM = 0.2  # 5000 steps a metre, as in TUM's, ETH3D's, ICL-NUIM's and Bonn's depth PNGs
MAX_BYTES = 64_000_000  # a million images; untuned
LAST_NUMBER = 10_000_000  # smaller whole numbers may be images' numbers, others are seconds; untuned

Image = tuple[int, str]
"""An image of a list: its stamp in ns, and its name without folders."""


class Listed(NamedTuple):
    """Contents of a folder's lists.

    file: name of a list; depth: images by time, each with the name of its colour image or "". counted: True
    if the list has image numbers instead of times.
    """

    file: str
    depth: list[tuple[Image, str]]
    counted: bool


def read_lists(folder: Path) -> Listed | None:
    """Read a folder's lists, associations before the others; None without any. Raises FormatError for a
    malformed list.
    """
    file = next((folder / name for name in ASSOCIATIONS if (folder / name).is_file()), None)
    if file is not None:
        depth = sorted((image, name) for image, (_, name) in read_associations(file))
    elif (file := folder / DEPTH_LIST).is_file():
        images = sorted(read_list(file))
        color = sorted(read_list(folder / COLOR_LIST)) if (folder / COLOR_LIST).is_file() else []
        depth_ns, color_ns = (np.array([stamp for stamp, _ in each], np.int64) for each in (images, color))
        pairs = pair_stamps(depth_ns, color_ns, WINDOW_NS).tolist()
        depth = [(image, color[at][1] if at >= 0 else "") for image, at in zip(images, pairs, strict=True)]
    else:
        return None
    return Listed(file.name, depth, _counted([stamp for (stamp, _), _ in depth]))


def is_tum(folder: Path) -> bool:
    """Return whether the folder has the lists of a TUM dataset, header included: depth is in TUM's unit."""
    return (folder / DEPTH_LIST).is_file() and _text(folder / DEPTH_LIST).startswith("# depth maps")


def read_list(file: Path) -> list[Image]:
    """Return the image of every line of a list. Raises FormatError for a malformed line."""
    return [_image(words, file) for words in _lines(file, 2)]


def read_associations(file: Path) -> list[tuple[Image, Image]]:
    """Return (depth image, colour image) of every line, in any order within a line. Raises FormatError for a
    malformed line.
    """
    pairs = []
    for words in _lines(file, 4):
        first, second = _image(words[:2], file), _image(words[2:], file)
        pairs.append((first, second) if "depth" in words[1].lower() else (second, first))
    return pairs


def _counted(stamps_ns: list[int]) -> bool:
    """Return whether the "seconds" are image numbers: small whole numbers, mostly in steps of one."""
    seconds = sorted({stamp / 1e9 for stamp in stamps_ns})
    if not all(second.is_integer() and second < LAST_NUMBER for second in seconds):
        return False
    return len(seconds) > 1 and float(np.median(np.diff(seconds))) == 1


def _lines(file: Path, words: int) -> list[list[str]]:
    lines = []
    for text in _text(file).splitlines():
        line = text.split(maxsplit=words)
        if not line or text.startswith("#"):
            continue
        if len(line) < words:
            raise FormatError(
                f"{file}: line {' '.join(line)[:60]!r} has fewer than {words} words; correct that line"
            )
        lines.append(line[:words])
    return lines


def _image(words: list[str], file: Path) -> Image:
    """Return the time, exact for any number of digits, and the file name of an image.

    The name has no folders, because images are searched in the folder's own subfolders.
    """
    # 64 bits hold nine billion seconds of nanoseconds.
    match = re.fullmatch(r"([0-8]?\d{1,9})(?:\.(\d*))?", words[0], re.ASCII)
    if match is None:
        raise FormatError(f"{file}: {words[0][:40]!r} is not a time in seconds; correct that line")
    name = PurePosixPath(words[1].replace("\\", "/")).name
    if not name or name == ".." or "\0" in name or len(name) > 200:
        raise FormatError(f"{file}: {words[1][:40]!r} is not the name of an image; correct that line")
    return int(match[1]) * 1_000_000_000 + int((match[2] or "").ljust(9, "0")[:9]), name


def _text(file: Path) -> str:
    return read_bounded(file, MAX_BYTES, "split it").decode(errors="replace")
