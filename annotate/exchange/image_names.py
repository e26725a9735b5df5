"""Names of images in annotation files: the place of the depth image, and the id of its frame."""

import re
from collections import Counter
from functools import cached_property
from itertools import islice
from pathlib import Path, PurePosixPath
from unicodedata import combining, normalize
from urllib.parse import unquote

from annotate.array_types import UInt16
from annotate.labelset.images import decode_depth
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded

DEPTH, IMAGES = "depth", "images"
"""Folders of depth images: their own, beside coloured pictures of the same names; or the annotated ones."""
LONGEST_ID = 100
"""Letters of a frame's id (``labelset.store``)."""
MAX_IMAGES = 2_000_000
"""Images of an export that are looked at for a name; untuned."""


def frame_ids(names: list[str]) -> list[str]:
    """Return the frame id of each image: its name without folders, or with them where two would be the same.

    names: as annotation files have them, with slashes of either kind. Letters that a frame id cannot have
    become plain ones or "_". Raises FormatError for a name that leads out of the folder, and for two of the
    same.
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


def safe_id(stem: str) -> str:
    """Return a name as the id of a frame: "Bän k 1" is "Ban_k_1"."""
    plain = normalize("NFKD", unquote(stem))
    kept = "".join(letter for letter in plain if not combining(letter))
    return re.sub(r"[^A-Za-z0-9_.-]", "_", kept).lstrip(".-")[:LONGEST_ID] or "_"


class DepthImages:
    """The depth images of an export, by the names that its annotations have."""

    def __init__(self, source: Path) -> None:
        self._source = source

    def read(self, name: str) -> UInt16:
        """Return the depth image (h, w), millimetres, of an annotated image. Raises FormatError."""
        file = self._file(name)
        data = read_bounded(file)
        try:
            return decode_depth(data)
        except FormatError as error:
            raise FormatError(
                f"{file} is no depth image ({error}); put depth PNGs of the same names into "
                f"{self._source / DEPTH}"
            ) from error

    def _file(self, name: str) -> Path:
        """Return the file of a depth image. Raises FormatError where there is none, or several may be it."""
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
        """The PNGs of the export's folders by name: FiftyOne's ``data/``, COCO's ``train2017/``."""
        found: dict[str, list[Path]] = {}
        for path in islice(self._source.rglob("*.png"), MAX_IMAGES):
            found.setdefault(normalize("NFC", path.name), []).append(path)
        return found


def _inside(name: str) -> PurePosixPath:
    path = PurePosixPath(name.replace("\\", "/"))
    if not path.name or path.is_absolute() or ".." in path.parts or "\0" in name or ":" in path.parts[0]:
        # A program's own absolute path: the file's name is what others have.
        path = PurePosixPath(path.name)
    if not path.name or path.name == ".." or "\0" in path.name:
        raise FormatError(f"{name[:100]!r} names no image; correct it")
    return path
