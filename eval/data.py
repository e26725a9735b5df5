"""Labelled frames of any origin: who saw them, and as training tensors: the person's crop, many in memory."""

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile, gettempdir
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from annotate.crop import SIZE, crop_from_note, network_crop, normalize, person_of
from annotate.labels import FrameLabels
from annotate.labelset.store import LabelSet
from annotate.parts import BACKGROUND, on_body
from sensors.camera import Intrinsics
from sensors.errors import CloudError, FormatError
from synth.dataset import MANIFEST, Dataset
from synth.view import CAMERA

MAX_IN_MEMORY = 2_000_000_000
"""Bytes of depth, or of parts, that are held in memory: 22,000 images. What the system reads from a file, it
can give back when memory is short."""

K = TypeVar("K", bound=np.generic)

Frames = LabelSet | Dataset
"""Whatever holds labelled frames: one reader serves both."""

DEPTH_STEPS = np.float32(65535)
"""Crops are kept with depth in 1 / 65535 of its range: 0.03 mm."""


def open_frames(path: Path) -> Frames:
    """Open a label set or a dataset. Raises FormatError when the folder is neither."""
    return Dataset.open(path) if (path / MANIFEST).is_file() else LabelSet.open(path)


def camera_of(frames: Frames, frame: FrameLabels) -> Intrinsics:
    """The undistorted depth camera of the whole image that a set's frame is, or by its notes is a crop of."""
    if isinstance(frames, LabelSet) and "crop" not in frame.notes:
        return frames.intrinsics.undistorted()
    return CAMERA


def pinhole_of(frame: FrameLabels, camera: Intrinsics) -> Intrinsics:
    """The pinhole of a frame's own pixels: ``camera``, or the part of it that the frame is a crop of.

    Raises FormatError when the note on the crop is malformed.
    """
    if "crop" not in frame.notes:
        return camera
    return crop_from_note(frame.notes["crop"], "crop").camera(camera, frame.depth_mm.shape[0])


def to_crop(frame: FrameLabels) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """A frame as the network's input and target, both (212, 212): depth in [0, 1] and part ids.

    Raises CloudError when the frame shows no person.
    """
    mask = person_of(frame.parts)
    crop = network_crop(mask & (frame.depth_mm > 0))
    depth = normalize(crop.cut(frame.depth_mm, 0), crop.cut(mask, False))
    return depth, crop.cut(frame.parts, BACKGROUND)


@dataclass(frozen=True)
class Crops:
    """Crops at hand, compact: depth uint16 (N, 212, 212) in 1 / 65535, parts uint8; 135 kB each."""

    depth: NDArray[np.uint16]
    parts: NDArray[np.uint8]

    def __post_init__(self) -> None:
        if self.depth.shape != self.parts.shape or self.depth.ndim != 3 or not len(self.depth):
            raise CloudError(f"crops are {self.depth.shape} and {self.parts.shape}; give at least one image")

    def __len__(self) -> int:
        return len(self.depth)

    def image(self, index: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Crop ``index``: depth float32 (212, 212) in [0, 1], parts."""
        return self.depth[index].astype(np.float32) / DEPTH_STEPS, self.parts[index]

    def spread(self, n: int) -> "Crops":
        """``n`` of them, evenly spread (neighbours show one person), or all when there are fewer."""
        index = np.linspace(0, len(self) - 1, min(n, len(self))).astype(int)
        return Crops(self.depth[index], self.parts[index])


def load_crops(
    sources: list[Path], without: frozenset[str] = frozenset(), only: frozenset[str] | None = None
) -> Crops:
    """Read label sets and datasets, all subjects but ``without``, or ``only`` some.

    Frames without a named part teach nothing and are left out. Raises CloudError when none is left, or when
    they do not fit into memory and the disk.
    """
    frames = [open_frames(path) for path in sources]
    names = ", ".join(map(str, sources))
    try:
        total = sum(map(len, frames))
        depth: NDArray[np.uint16] = _room(total, np.uint16)
        parts: NDArray[np.uint8] = _room(total, np.uint8)
    except (MemoryError, ValueError, OverflowError, OSError) as error:
        raise CloudError(
            f"{names}: so many images do not fit into memory and {gettempdir()}; give fewer, or set TMPDIR"
        ) from error
    n = 0
    for frame in _teaching(frames, without, only):
        if n == total:
            raise FormatError(
                f"{names} hold more than the {total} images of their manifests; make them again"
            )
        x, parts[n] = to_crop(frame)
        depth[n] = np.rint(x * DEPTH_STEPS)
        n += 1
    if not n:
        whom = "" if only is None else f" of {', '.join(sorted(only))}"
        raise CloudError(f"{names} hold no labelled part{whom}; generate or label some first")
    return Crops(depth[:n], parts[:n])


def _room(images: int, kind: type[K]) -> NDArray[K]:
    """Zeros for so many crops: in memory, or of many in a nameless file that goes with the process.

    Raises OSError where the disk has no room.
    """
    shape = (images, SIZE, SIZE)
    size = math.prod(shape) * np.dtype(kind).itemsize
    if size <= MAX_IN_MEMORY:
        return np.zeros(shape, kind)
    with TemporaryFile() as file:
        # Or a full disk would end the process in the middle of a training.
        os.posix_fallocate(file.fileno(), 0, size)
        return np.memmap(file, kind, "r+", shape=shape)


def _teaching(
    frames: list[Frames], without: frozenset[str], only: frozenset[str] | None
) -> Iterator[FrameLabels]:
    for source in frames:
        for frame in source:
            if frame.subject in without or (only is not None and frame.subject not in only):
                continue
            if (on_body(frame.parts) & (frame.depth_mm > 0)).any():
                yield frame
