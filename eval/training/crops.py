"""Persons' crops for a training, compressed in a temporary file: 14 kB each instead of 135."""

import zlib
from array import array
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile, gettempdir
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Int64, UInt8, UInt16
from annotate.crop import network_crop, normalize
from annotate.frame_labels import FrameLabels
from annotate.labelset.convert import in_scheme
from annotate.labelset.labelled_frames import LabelledFrames, open_frames
from annotate.parts import PAPER
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import BACKGROUND, Scheme
from eval.training.body_targets import ROW, body_targets
from eval.training.shared_bodies import bodies_in, held_out
from sensors.errors import CloudError, Setting

K = TypeVar("K", bound=np.generic)
UNKNOWN = "unknown"
DEPTH_STEPS = np.float32(65535)  # of a crop's depth range: 0.03 mm each


def to_crop(frame: FrameLabels) -> tuple[Float32, UInt8]:
    """Return a frame as the network's input and target (212, 212): depth in [0, 1] and part ids.

    Raises CloudError where the frame shows no person.
    """
    return person_crop(frame.depth_mm, frame.on_person, frame.parts)


def person_crop(depth_mm: UInt16, mask: Bool, parts: UInt8) -> tuple[Float32, UInt8]:
    """Return ``to_crop`` of a person's pixels in an image; depth, mask and parts are (h, w)."""
    crop = network_crop(mask & (depth_mm > 0))
    depth = normalize(crop.cut(depth_mm, 0), crop.cut(mask, False))
    return depth, crop.cut(parts, BACKGROUND)


@dataclass(frozen=True)
class Crops:
    """Compressed crops of one shape (h, w).

    packed: bytes in an unlinked temporary file, deleted with the process. places: int64 (N, 3), offsets of
    the start of a crop's depth, its end, and the end of its parts. wholes: float32 (N, ROW), targets of
    ``eval.training.body_targets``. crc32: checksum of these crops. bodies: (N,), of each crop's person, by
    ``eval.training.shared_bodies``. scheme: of the parts.
    """

    packed: UInt8
    places: Int64
    shape: tuple[int, int]
    wholes: Float32
    crc32: int
    bodies: tuple[frozenset[str], ...]
    scheme: Scheme = PAPER

    @classmethod
    def of(
        cls,
        crops: Iterable[tuple[UInt16, UInt8, Float32]],
        bodies: Sequence[frozenset[str]] | None = None,
        scheme: Scheme = PAPER,
    ) -> "Crops":
        """Compress crops: depth uint16 (h, w) in 1 / 65535 of its range, parts uint8 (h, w), targets (ROW,).

        bodies: of each crop, a list that may grow with ``crops``; None = unknown. scheme: of the parts.
        Raises CloudError without any crop, OSError on a full disk.
        """
        places, wholes, shape, crc32 = array("q"), array("f"), (0, 0), 0
        with TemporaryFile() as file:
            for depth, parts, whole in crops:
                shape = depth.shape[0], depth.shape[1]
                wholes.extend(whole.tolist())
                places.append(file.tell())
                for data in (depth.tobytes(), parts.tobytes()):
                    crc32 = zlib.crc32(data, crc32)
                    file.write(zlib.compress(data, 1))
                    places.append(file.tell())
            file.flush()
            if not places:
                raise CloudError("the training has 0 crops; give at least one image")
            packed = np.asarray(np.memmap(file, np.uint8, "r"))
        known = np.array(wholes, np.float32).reshape(-1, ROW)
        whose = (frozenset({UNKNOWN}),) * len(known) if bodies is None else tuple(bodies)
        crc32 = zlib.crc32(known.tobytes(), crc32)
        return cls(packed, np.array(places).reshape(-1, 3), shape, known, crc32, whose, scheme)

    def __len__(self) -> int:
        return len(self.places)

    def depth(self, index: int) -> UInt16:
        """Return the depth of crop ``index``, (h, w) in 1 / 65535 of its range."""
        start, end, _ = self.places[index].tolist()
        return self._image(start, end, np.uint16)

    def parts(self, index: int) -> UInt8:
        """Return the part ids of crop ``index``, (h, w)."""
        _, start, end = self.places[index].tolist()
        return self._image(start, end, np.uint8)

    def _image(self, start: int, end: int, kind: type[K]) -> NDArray[K]:
        image = bytearray(zlib.decompress(self.packed[start:end].data))
        return np.frombuffer(image, kind).reshape(self.shape)

    def image(self, index: int) -> tuple[Float32, UInt8]:
        """Return depth float32 (h, w) in [0, 1] and parts of crop ``index``."""
        return self.depth(index).astype(np.float32) / DEPTH_STEPS, self.parts(index)

    def batches(self, size: int) -> Iterator[tuple[Float32, UInt8]]:
        """Yield depth (B, h, w) and parts of all crops in order, ``size`` at a time."""
        for start in range(0, len(self), size):
            images = [self.image(i) for i in range(start, min(start + size, len(self)))]
            yield np.stack([depth for depth, _ in images]), np.stack([parts for _, parts in images])

    def spread(self, n: int) -> "Crops":
        """Return ``n`` evenly spread crops, because neighbours show one person; all crops if they are
        fewer.
        """
        return self.chosen(np.linspace(0, len(self) - 1, min(n, len(self))).astype(np.int64))

    def chosen(self, index: Int64) -> "Crops":
        """Return the crops at indices (m,), in this order; bytes are not copied."""
        return replace(
            self,
            places=self.places[index],
            wholes=self.wholes[index],
            crc32=zlib.crc32(index.tobytes(), self.crc32),
            bodies=tuple(self.bodies[i] for i in index.tolist()),
        )

    def showing(self, bodies: Collection[str]) -> Bool:
        """Return True (N,) for each crop whose person has one of ``bodies``."""
        return np.array([not own.isdisjoint(bodies) for own in self.bodies], np.bool_)


def load_crops(
    sources: list[Path],
    without: frozenset[str] = frozenset(),
    only: frozenset[str] | None = None,
    scheme: Scheme | None = None,
) -> Crops:
    """Return the persons' crops of label sets and datasets.

    without: subjects or bodies to leave out, with every image that shares a body with them. only: subjects or
    bodies to read; None = all. scheme: of the crops' parts; None = the sources'. Frames without a labelled
    part are left out. Raises CloudError where no frame remains, on a full disk, or where sources have several
    schemes or do not convert to ``scheme``.
    """
    names, bodies = ", ".join(map(str, sources)), list[frozenset[str]]()
    opened = [open_frames(path) for path in sources]
    scheme = scheme or common_scheme(opened)
    tables = {id(frames): conversion_table(frames.scheme, scheme) for frames in opened}
    taught = _labelled(opened, without, only)
    if (first := next(taught, None)) is None:
        whom = "" if only is None else f" of {', '.join(sorted(only))}"
        raise CloudError(f"{names} hold no labelled part{whom}; generate or label some first")

    def kept() -> Iterator[tuple[UInt16, UInt8, Float32]]:
        for source, frame in chain([first], taught):
            bodies.append(bodies_in(source, frame))
            depth, parts = to_crop(in_scheme(frame, scheme, tables[id(source)]))
            yield np.rint(depth * DEPTH_STEPS).astype(np.uint16), parts, body_targets(source, frame)

    try:
        return Crops.of(kept(), bodies, scheme)
    except OSError as error:
        raise CloudError(
            f"{names}: the images do not fit into {gettempdir()} ({error.strerror}); give fewer, or set "
            "TMPDIR"
        ) from error


def common_scheme(sources: Sequence[LabelledFrames]) -> Scheme:
    """Return the scheme of all sources. Raises CloudError where they differ."""
    first = sources[0]
    for other in sources[1:]:
        if other.scheme != first.scheme:
            raise CloudError(
                f"{first.path} has scheme {first.scheme.name!r}, {other.path} has {other.scheme.name!r}; "
                "give a scheme that both convert to",
                Setting.SCHEME,
            )
    return first.scheme


def _labelled(
    frames: list[LabelledFrames], without: frozenset[str], only: frozenset[str] | None
) -> Iterator[tuple[LabelledFrames, FrameLabels]]:
    left_out = held_out(frames, without)
    for source in frames:
        for frame in source:
            known = bodies_in(source, frame) | {frame.subject}
            if not known.isdisjoint(left_out) or (only is not None and known.isdisjoint(only)):
                continue
            if (frame.on_body & (frame.depth_mm > 0)).any():
                yield source, frame
