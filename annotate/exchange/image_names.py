"""Names of images in annotation files: the place of the depth image, and the id of its frame."""

from collections import Counter
from pathlib import Path, PurePosixPath

from annotate.array_types import UInt16
from annotate.labelset.images import decode_depth
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

DEPTH, IMAGES = "depth", "images"
"""Folders of depth images: their own, beside coloured pictures of the same names; or the annotated ones."""


def frame_ids(names: list[str]) -> list[str]:
    """Return the frame id of each image: its name without folders, or with them where two would be the same.

    names: as annotation files have them, with slashes of either kind. Raises FormatError for a name that
    leads out of the folder, and for two of the same.
    """
    paths = [_inside(name) for name in names]
    stems = Counter(path.stem for path in paths)
    ids = [
        path.stem if stems[path.stem] == 1 else "_".join([*path.parent.parts, path.stem]) for path in paths
    ]
    twice = next((name for name, count in Counter(ids).items() if count > 1), None)
    if twice is not None:
        raise FormatError(f"two images are called {twice[:100]!r}; rename one")
    return ids


def read_depth(source: Path, name: str) -> UInt16:
    """Return the depth image (h, w), millimetres, of an annotated image. Raises FormatError."""
    file = _depth_file(source, name)
    data = read_bounded(file)
    try:
        return decode_depth(data)
    except FormatError as error:
        raise FormatError(
            f"{file} is no depth image ({error}); put depth PNGs of the same names into {source / DEPTH}"
        ) from error


def _depth_file(source: Path, name: str) -> Path:
    """Return the depth image of an annotated image. Raises FormatError where there is none."""
    path = _inside(name)
    depth = path.with_suffix(".png")
    tried = [
        source / DEPTH / depth,
        source / DEPTH / depth.name,
        source / IMAGES / path,
        source / path,
        source / IMAGES / path.name,
    ]
    found = next((file for file in tried if file.is_file()), None)
    if found is None:
        raise FormatError(
            f"image {str(path)[:100]!r} is neither in {IMAGES}/ nor in {DEPTH}/; export the annotations with "
            f"their images, or put 16-bit depth PNGs of the same names into {DEPTH}/"
        )
    return found


def _inside(name: str) -> PurePosixPath:
    path = PurePosixPath(name.replace("\\", "/"))
    if not path.name or path.is_absolute() or ".." in path.parts or "\0" in name or ":" in path.parts[0]:
        # A program's own absolute path: the file's name is what others have.
        path = PurePosixPath(path.name)
    if not path.name or path.name == ".." or "\0" in path.name:
        raise FormatError(f"{name[:100]!r} names no image; correct it")
    return path
