"""Depth, colour and thermal images of a folder, and pairs of them by name or by the times in names.

Streams lie in folders of their own: ``depth/``, ``color/`` or ``rgb/``, ``thermal/``, in any letter case;
else the only folder whose name has the word (``depth_raw``, ``aligned_depth_to_color``, ``RGBImages``); for
colour also ``image/`` (SUN RGB-D). Or they lie beside each other with the stream in their names:
``depth_0001.png color_0001.png``, ``0001_depth.png``, ``MDepth-00000001.png`` (NTU RGB+D),
``frame-000000.depth.png frame-000000.color.png`` (7-Scenes), ``rs_Depth_1546.25.png rs_Color_1546.31.png``
(librealsense). Without such words, PNGs are depth and JPEGs of the same names colour. Hidden files, such as
``._0001.png`` of macOS, and pictures made of depth (``0001_depth_vis.png``) are left out. Names become an
order as people count: 2 before 10.
"""

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sensors.errors import FormatError
from sensors.files.images import SUFFIXES
from sensors.files.natural_order import paths_in_order
from sensors.files.own_files import own_file
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps

STREAMS = {"depth": ("depth",), "color": ("color", "colour", "rgb"), "thermal": ("thermal",)}
"""Names of a stream's folder, or words in the names of its files, in small letters."""
IMAGE = ("image", "images", "img", "imgs")  # folders of colour where depth has another folder
PICTURES = (".jpg", ".jpeg", ".png")
JPEGS = PICTURES[:2]
_STREAM = re.compile(
    r"(?:(?<![A-Za-z])((?i:depth|colou?r|rgb|thermal))|(Depth|Colou?r|RGB|Rgb|Thermal))"
    r"(?i:s|_?(?:maps?|images?|imgs?))?(?![a-z])"
)
_VIEW = re.compile(
    r"(?<![a-z])(?:vis|viz|visual\w*|colou?rmap\w*|colou?ri[sz]ed|preview|masks?|conf\w*|norm\w*)(?![a-z])"
)
"""Words of pictures that are made of depth images."""
_MILLISECONDS = re.compile(r"_(\d{1,15}\.\d{1,17})$", re.ASCII)
"""Of librealsense (tools/convert/converters/converter-png.hpp)."""
_SINCE_1970 = re.compile(r"(?:^|[^\d.])(\d{10})(?:\.(\d{1,9})|(\d{3}|\d{6}|\d{9}))$", re.ASCII)
"""In seconds, milliseconds, microseconds or nanoseconds (TUM's images, ROS recorders)."""
_REDWOOD = re.compile(r"^\d{7}-(\d{12})$", re.ASCII)
"""Frame and microseconds of Redwood's object scans."""
EARLIEST_S, LATEST_S = 1_000_000_000, 4_100_000_000  # numbers that count as times: 2001 to 2099

Files = dict[str, Path]
"""Images by name: without folder, suffix, and the stream's own name."""


class FolderImages(NamedTuple):
    """Images of a folder, in natural order.

    stamps_ns: of depth images whose names state them, else empty. notes: on images that are left out.
    """

    depth: Files
    color: Files
    thermal: Files
    stamps_ns: dict[str, int]
    notes: tuple[str, ...]


def find_images(path: Path) -> FolderImages:
    """Find the images of a folder. Raises FormatError without depth, or with several folders of it."""
    folder, flat = _stream_folder(path, "depth"), _by_stream(path)
    every = files_of(folder or path, SUFFIXES) if folder or not flat["depth"] else flat["depth"]
    plain = [file for file in every if not _VIEW.search(file.stem.lower())] or every
    depth: Files = {}
    for kinds in ((".png",), (".tif", ".tiff"), (".pgm",), (".npy",)):
        depth = depth or _named([file for file in plain if file.suffix.lower() in kinds])
    if not depth:
        raise FormatError(_no_depth(folder or path))
    color, thermal = _color(path, flat["color"], depth), _other(path, "thermal", flat["thermal"])
    stamps, others = stamps_of(depth), stamps_of(color)
    if stamps and others:
        color = _nearest(stamps, color, others)
    views = len(every) - len(plain)
    notes = (f"{views} images named like pictures of depth are left out",) if views else ()
    return FolderImages(depth, color, thermal, stamps, notes)


def files_of(folder: Path, suffixes: tuple[str, ...] = PICTURES) -> list[Path]:
    """Return the files of a folder with one of the suffixes, in natural order, without hidden ones."""
    found = (file for file in folder.iterdir() if file.suffix.lower() in suffixes and file.is_file())
    return paths_in_order(file for file in found if not file.name.startswith("."))


def matching(files: Files, depth: Files) -> Files:
    """Return the images that share their name with a depth image. Raises FormatError without any."""
    found = {name: file for name, file in files.items() if name in depth}
    if files and not found:
        other, first = next(iter(files.values())), next(iter(depth))
        raise FormatError(
            f"no image in {other.parent} is named like a depth image; name them alike, "
            f"e.g. {first}{other.suffix}"
        )
    return found


def stamps_of(names: Iterable[str]) -> dict[str, int]:
    """Return the times stated in names, in nanoseconds; empty where a name has no time, or two have the
    same.
    """
    found = {name: _stamp_ns(name) for name in names}
    stamps = {name: stamp for name, stamp in found.items() if stamp is not None}
    return stamps if len(set(stamps.values())) == len(found) else {}


def unread_colors(path: Path) -> tuple[str, ...]:
    """Return a note on colour images in unsupported formats, if no colour image is read."""
    folder = _subfolder(path, STREAMS["color"]) or _subfolder(path, IMAGE)
    if folder is not None:
        if files_of(folder) or not (held := _kinds(folder)):
            return ()
        return (f"{folder.name} holds {held} files, which are not read: convert them to JPEG or PNG",)
    named = [file for file in path.iterdir() if file.is_file() and _stream_of(file.stem) == "color"]
    if not named or any(file.suffix.lower() in PICTURES for file in named):
        return ()
    return (f"{len(named)} {named[0].suffix} colour images are not read: convert them to JPEG or PNG",)


def _stamp_ns(name: str) -> int | None:
    if at := _SINCE_1970.search(name):
        seconds, fraction = int(at[1]), at[2] or at[3] or ""
        return seconds * 10**9 + int(fraction.ljust(9, "0")) if EARLIEST_S <= seconds <= LATEST_S else None
    if at := _REDWOOD.search(name):
        return int(at[1]) * 1000
    at = _MILLISECONDS.search(name)
    return round(float(at[1]) * 1e6) if at else None


def _stream_of(name: str) -> str:
    """Return depth, color or thermal by the first of these words in a name; "" without one."""
    found = _STREAM.search(name)
    word = (found[1] or found[2]).lower() if found else ""
    return "color" if word in STREAMS["color"] else word


def _stream_folder(path: Path, stream: str) -> Path | None:
    """Return a stream's folder: the one with its plain name, else the only one whose name has the word."""
    if (plain := _subfolder(path, STREAMS[stream])) is not None:
        return plain
    found = [
        entry
        for entry in paths_in_order(path.iterdir())
        if entry.is_dir() and not entry.name.startswith(".") and not _VIEW.search(entry.name.lower())
        if _stream_of(entry.name) == stream and files_of(entry, SUFFIXES + JPEGS)
    ]
    if len(found) > 1:
        several = ", ".join(entry.name[:40] for entry in found[:4])
        raise FormatError(f"{path} has several folders of {stream}: {several}; rename the right one {stream}")
    return found[0] if found else None


def _color(path: Path, flat: list[Path], depth: Files) -> Files:
    """Return colour images: of their folder, by their names, or JPEGs that share the depth images' names."""
    if found := _other(path, "color", flat):
        return found
    folder = _subfolder(path, IMAGE)
    beside = _named(files_of(folder or path, PICTURES if folder else JPEGS))
    return beside if folder or set(beside) & set(depth) else {}


def _other(path: Path, stream: str, flat: list[Path]) -> Files:
    """Return the colour or thermal images of their folder, else the images with the stream in their names."""
    own = _stream_folder(path, stream)
    return _named(files_of(own, PICTURES if stream == "color" else (*PICTURES, *SUFFIXES)) if own else flat)


def _subfolder(path: Path, names: tuple[str, ...]) -> Path | None:
    """Return the subfolder with the first of ``names`` that exists, in any letter case."""
    there = {entry.name.lower(): entry for entry in paths_in_order(path.iterdir()) if entry.is_dir()}
    return next((there[name] for name in names if name in there), None)


def _named(files: list[Path]) -> Files:
    """Return the files by name, without the word for the stream (such as "depth").

    If two names would be equal, whole names are used.
    """
    keyed = {_key(file.stem): file for file in files}
    return keyed if len(keyed) == len({file.stem for file in files}) else {file.stem: file for file in files}


def _key(name: str) -> str:
    rest = _STREAM.sub("", name)
    return re.sub(r"([._ -])[._ -]+", r"\1", rest).strip("._ -") or name


def _by_stream(path: Path) -> dict[str, list[Path]]:
    """Return images in the folder itself by the stream that their names state; none without depth."""
    found: dict[str, list[Path]] = {stream: [] for stream in STREAMS}
    for file in files_of(path, (*PICTURES, *SUFFIXES)):
        if stream := _stream_of(file.stem):
            found[stream].append(file)
    return found if found["depth"] else {stream: [] for stream in found}


def _nearest(stamps_ns: dict[str, int], color: Files, color_ns: dict[str, int]) -> Files:
    """Return colour images by the name of the depth image that is nearest in time."""
    names, others = (sorted(stamps, key=stamps.__getitem__) for stamps in (stamps_ns, color_ns))
    depth_ns = np.array([stamps_ns[name] for name in names], np.int64)
    pairs = pair_stamps(depth_ns, np.array([color_ns[name] for name in others], np.int64), COLOR_WINDOW_NS)
    return {name: color[others[at]] for name, at in zip(names, pairs.tolist(), strict=True) if at >= 0}


def _kinds(folder: Path) -> str:
    """Return the numbers of a folder's files by suffix, as text; "" for none."""
    files = (file for file in folder.iterdir() if file.is_file() and not file.name.startswith("."))
    kinds = Counter(file.suffix.lower() or "nameless" for file in files)
    return ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(4))


def _no_depth(folder: Path) -> str:
    """Return the text of an error: contents of a folder without depth images, and the remedy."""
    if own := own_file(folder):
        return f"{folder} {own.instead_of('a recording')}"
    held = f" (it holds {kinds} files)" if (kinds := _kinds(folder)) else ""
    place = folder if folder.name.lower() in STREAMS["depth"] else folder / "depth"
    return f"{folder} holds no depth images{held}; put 16-bit PNGs into {place}"
