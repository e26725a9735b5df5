"""Depth images with separate masks, as COCO and CVAT store them: names, folders, reading and writing."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from unicodedata import normalize
from urllib.parse import unquote

from annotate.array_types import UInt16
from annotate.exchange.companion import Companion, safe_id
from annotate.exchange.masks import Mask, images_from
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import decode_depth, encode_png
from sensors.errors import FormatError, fault_of
from sensors.files.bounded import read_bounded

DEPTH, IMAGES = "depth", "images"
"""Folders of depth images: beside coloured pictures of the same names, or the annotated images themselves."""
MAX_IMAGES = 2_000_000  # of an export searched for a name; untuned


class AnnotatedImage(NamedTuple):
    """Image of an annotation file.

    masks: function from the depth image's shape to the masks, later ones on top.
    """

    file: Path
    name: str
    masks: Callable[[tuple[int, int]], Iterable[Mask]]


def read_annotated(
    source: Path, images: Sequence[AnnotatedImage], companion: Companion
) -> Iterator[FrameLabels]:
    """Yield the frames of annotated images. Raises FormatError naming file and image."""
    names, depth = frame_ids([image.name for image in images]), DepthImages(source)
    ids = companion.ids_by_name
    for image, frame_id in zip(images, names, strict=True):
        try:
            depth_mm = depth.read(image.name)
            parts, persons = images_from(image.masks(depth_mm.shape), depth_mm.shape, ids)
        except (KeyError, ValueError, TypeError, IndexError, OverflowError, FormatError) as error:
            why = f"an annotation lacks {error}" if isinstance(error, KeyError) else fault_of(error)
            raise FormatError(f"{image.file}, image {image.name[:100]!r}: {why[:300]}") from error
        yield companion.labels(frame_id, depth_mm, parts, persons)


def write_image(out: Path, frame: FrameLabels) -> str:
    """Write a frame's depth image into the folder ``images``; return its name."""
    name = f"{frame.frame_id}.png"
    (out / IMAGES).mkdir(exist_ok=True)
    (out / IMAGES / name).write_bytes(encode_png(frame.depth_mm))
    return name


def check_size(stated: tuple[object, object], shape: tuple[int, int]) -> None:
    """Raise FormatError if (height, width), where stated, is not the depth image's."""
    height, width = (float(str(side)) if side else 0.0 for side in stated)
    if height and width and (height, width) != shape:
        raise FormatError(
            f"labels were drawn on an image of {width:g}x{height:g}, its depth image is "
            f"{shape[1]}x{shape[0]}; annotate images of the depth image's size"
        )


def frame_ids(names: list[str]) -> list[str]:
    """Return the frame id of each image: the file name, or the path where two names would be equal.

    Raises FormatError for a path outside the folder, and for two equal paths.
    """
    paths = [_inside(name) for name in names]
    stems = Counter(safe_id(path.stem) for path in paths)
    ids = [
        safe_id(path.stem if stems[safe_id(path.stem)] == 1 else "_".join([*path.parent.parts, path.stem]))
        for path in paths
    ]
    twice = next((name for name, count in Counter(ids).items() if count > 1), None)
    if twice is not None:
        raise FormatError(f"two images are called {twice[:100]!r}; rename one")
    return ids


class DepthImages:
    """Depth images of an export, by the names in its annotations."""

    def __init__(self, source: Path) -> None:
        self._source = source

    def read(self, name: str) -> UInt16:
        """Return the depth image (h, w), millimetres, of an annotated image. Raises FormatError where it is
        missing or broken.
        """
        file = self._file(name)
        data = read_bounded(file)
        try:
            return decode_depth(data)
        except FormatError as error:
            raise FormatError(
                f"{file} is not a depth image ({error}); put depth PNGs of the same names into "
                f"{self._source / DEPTH}"
            ) from error

    def _file(self, name: str) -> Path:
        for path in (_inside(name), _inside(unquote(name))):
            depth = path.with_suffix(".png")
            tried = [
                self._source / DEPTH / depth,
                self._source / DEPTH / depth.name,
                self._source / IMAGES / path,
                self._source / path,
                self._source / IMAGES / path.name,
            ]
            for file in tried:
                if file.is_file():
                    return file
        found = self._anywhere.get(normalize("NFC", path.name), [])
        if len(found) > 1:
            raise FormatError(f"two images are called {path.name[:100]!r}; put the right ones into {DEPTH}/")
        if not found:
            raise FormatError(
                f"image {str(path)[:100]!r} is neither in {IMAGES}/ nor in {DEPTH}/; export the annotations "
                f"with their images, or put 16-bit depth PNGs of the same names into {DEPTH}/"
            )
        return found[0]

    @cached_property
    def _anywhere(self) -> dict[str, list[Path]]:
        """Return the PNGs of all subfolders by name, such as FiftyOne's ``data/`` and COCO's
        ``train2017/``.
        """
        found: dict[str, list[Path]] = {}
        for path in islice(self._source.rglob("*.png"), MAX_IMAGES):
            found.setdefault(normalize("NFC", path.name), []).append(path)
        return found


def _inside(name: str) -> PurePosixPath:
    path = PurePosixPath(name.replace("\\", "/"))
    if not path.name or path.is_absolute() or ".." in path.parts or "\0" in name or ":" in path.parts[0]:
        # Of a program's own absolute path only the file's name is portable.
        path = PurePosixPath(path.name)
    if not path.name or path.name == ".." or "\0" in path.name:
        raise FormatError(f"image name {name[:100]!r} is not a file name; export the annotations again")
    return path
