"""Depth, colour and thermal images of a folder, and pairs of them by name.

Streams lie in folders of their own (``depth/``, ``color/`` or ``rgb/``, ``thermal/``, in any letter case), or
beside each other with the stream in their names: ``depth_0001.png color_0001.png``, ``0001_depth.png``,
``frame-000000.depth.png frame-000000.color.png`` (7-Scenes), ``rs_Depth_1546.25.png rs_Color_1546.31.png``,
whose numbers are milliseconds (librealsense, tools/convert/converters/converter-png.hpp). Hidden files, such
as ``._0001.png`` of macOS, are left out. Names become an order as people count: 2 before 10.
"""

import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sensors.errors import FormatError
from sensors.files.grey_image import SUFFIXES
from sensors.files.natural_order import paths_in_order
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps

DEPTH, COLOR, THERMAL = ("depth",), ("color", "colour", "rgb"), ("thermal",)
"""Names of a stream's folder, or in the names of its files, in small letters."""
JPEGS = (".jpg", ".jpeg")
PICTURES = (*JPEGS, ".png")
_STREAM = re.compile(rf"(?<![a-z])({'|'.join((*DEPTH, *COLOR, *THERMAL))})(?![a-z])", re.IGNORECASE)
_MILLISECONDS = re.compile(r"_(\d{1,15}\.\d{1,17})$", re.ASCII)

Files = dict[str, Path]
"""Images by name: without folder, suffix, and the stream's own name."""


class FolderImages(NamedTuple):
    """Images of a folder, in natural order. stamps_ns: of depth images whose names state them, else empty."""

    depth: Files
    color: Files
    thermal: Files
    stamps_ns: dict[str, int]


def find_images(path: Path) -> FolderImages:
    """Find the images of a folder. Raises FormatError where there is no depth."""
    folder, flat = subfolder(path, DEPTH), _by_stream(path)
    depth = _depth(folder) if folder else _depth(path, flat["depth"])
    if not depth:
        raise FormatError(_no_depth(folder or path))
    stamps = _stamps_ns(depth) if not folder else {}
    color, thermal = (
        _named(files_of(own, suffixes)) if (own := subfolder(path, names)) else _named(flat[names[0]])
        for names, suffixes in ((COLOR, PICTURES), (THERMAL, (*PICTURES, *SUFFIXES)))
    )
    if stamps and not set(color) & set(depth):
        color = _nearest(stamps, color)
    return FolderImages(depth, color, thermal, stamps)


def subfolder(path: Path, names: tuple[str, ...]) -> Path | None:
    """Return the folder in ``path`` that has the first possible of the names, in any letter case."""
    there = {entry.name.lower(): entry for entry in paths_in_order(path.iterdir()) if entry.is_dir()}
    return next((there[name] for name in names if name in there), None)


def files_of(folder: Path, suffixes: tuple[str, ...] = PICTURES) -> list[Path]:
    """Return the files of a folder with one of the suffixes, in natural order, without hidden ones."""
    found = (file for file in folder.iterdir() if file.suffix.lower() in suffixes and file.is_file())
    return paths_in_order(file for file in found if not file.name.startswith("."))


def key_of(name: str) -> str:
    """Return an image's name (without suffix) without the stream's."""
    rest = _STREAM.sub("", name)
    return re.sub(r"([._ -])[._ -]+", r"\1", rest).strip("._ -") or name


def matching(files: Files, depth: Files) -> Files:
    """Return the images that are named like a depth image. Raises FormatError where none of them is."""
    found = {name: file for name, file in files.items() if name in depth}
    if files and not found:
        other, first = next(iter(files.values())), next(iter(depth))
        raise FormatError(
            f"no image in {other.parent} is named like a depth image; name them alike, "
            f"e.g. {first}{other.suffix}"
        )
    return found


def _named(files: list[Path]) -> Files:
    """Return the files by their keys; by their whole names where two have one key."""
    keyed = {key_of(file.stem): file for file in files}
    return keyed if len(keyed) == len({file.stem for file in files}) else {file.stem: file for file in files}


def _depth(folder: Path, flat: list[Path] | None = None) -> Files:
    """Return depth images of one kind: PNG before TIFF before PGM."""
    every = flat or files_of(folder, SUFFIXES)
    for kinds in ((".png",), (".tif", ".tiff"), (".pgm",)):
        if files := [file for file in every if file.suffix.lower() in kinds]:
            return _named(files)
    return {}


def _by_stream(path: Path) -> dict[str, list[Path]]:
    """Return images in the folder itself by the stream that their names state."""
    found: dict[str, list[Path]] = {"depth": [], "color": [], "thermal": []}
    for file in files_of(path, (*PICTURES, *SUFFIXES)):
        stream = _STREAM.search(file.stem)
        if stream is not None:
            name = stream[1].lower()
            found["color" if name in COLOR else name].append(file)
    if not found["depth"]:
        return {"depth": [], "color": [], "thermal": []}
    return found


def _stamps_ns(files: Files) -> dict[str, int]:
    """Return the milliseconds at the end of all names, as nanoseconds; nothing where one name has none."""
    found = {name: _MILLISECONDS.search(name) for name in files}
    if not all(found.values()):
        return {}
    return {name: round(float(at[1]) * 1e6) for name, at in found.items() if at}


def _nearest(stamps_ns: dict[str, int], color: Files) -> Files:
    """Return colour images by the name of the depth image that is nearest in time."""
    names, color_ns = sorted(stamps_ns, key=lambda name: stamps_ns[name]), _stamps_ns(color)
    others = sorted(color_ns, key=lambda name: color_ns[name])
    depth_ns = np.array([stamps_ns[name] for name in names], np.int64)
    pairs = pair_stamps(depth_ns, np.array([color_ns[name] for name in others], np.int64), COLOR_WINDOW_NS)
    return {name: color[others[at]] for name, at in zip(names, pairs.tolist(), strict=True) if at >= 0}


def unread_colors(path: Path) -> tuple[str, ...]:
    """Return a note on a folder of colour images none of which is read."""
    folder = subfolder(path, COLOR)
    if folder is None or files_of(folder) or not (seen := _kinds(folder)):
        return ()
    return (f"{folder.name} holds {seen} files, which are not read: convert them to JPEG or PNG",)


def _kinds(folder: Path) -> str:
    """Return the numbers of a folder's files by suffix, in words; "" for none."""
    kinds = Counter(
        file.suffix.lower() or "nameless"
        for file in folder.iterdir()
        if file.is_file() and not file.name.startswith(".")
    )
    return ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(4))


def _no_depth(folder: Path) -> str:
    """Return the contents of a folder without depth images, in words, and the remedy."""
    seen = _kinds(folder)
    place = folder if folder.name.lower() in DEPTH else folder / "depth"
    held = f" (it holds {seen} files)" if seen else ""
    return f"{folder} holds no depth images{held}; put 16-bit PNGs into {place}"
