"""Labelled frames as training tensors: normalised crops, flips, and extractions as bad as real ones."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from annotate.crop import NEAREST, SIZE, crop_around, normalize, person_of
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED, swap_left_right
from annotate.store import LabelSet
from sensors.errors import CloudError
from synth.dataset import MANIFEST, Dataset

Frames = LabelSet | Dataset
"""Whatever holds labelled frames: one reader serves both."""


def open_frames(path: Path) -> Frames:
    """Open a label set or a dataset. Raises FormatError when the folder is neither."""
    return Dataset.open(path) if (path / MANIFEST).is_file() else LabelSet.open(path)


def to_crop(frame: FrameLabels) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """A frame as the network's input and target, both (212, 212): depth in [0, 1] and part ids.

    Raises CloudError when the frame shows no person.
    """
    mask = person_of(frame.parts)
    if frame.depth_mm.shape == (SIZE, SIZE):
        return normalize(frame.depth_mm, mask), frame.parts
    crop = crop_around(mask & (frame.depth_mm > 0))
    depth = normalize(crop.cut(frame.depth_mm, 0), crop.cut(mask, False))
    return depth, crop.cut(frame.parts, BACKGROUND)


@dataclass(frozen=True)
class Crops:
    """All crops of a training in memory, compact: depth uint16 (N, 212, 212) in 1/65535, parts uint8."""

    depth: NDArray[np.uint16]
    parts: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.depth)

    def first(self, n: int) -> "Crops":
        """The first ``n`` of them."""
        return Crops(self.depth[:n], self.parts[:n])


def load_crops(sources: list[Path]) -> Crops:
    """Read the given label sets and datasets; frames without a named part teach nothing and are left out.

    Raises CloudError when none is left.
    """
    depth, parts = [], []
    for path in sources:
        for frame in open_frames(path):
            if not ((frame.parts < UNDEFINED) & (frame.parts > BACKGROUND) & (frame.depth_mm > 0)).any():
                continue
            x, y = to_crop(frame)
            depth.append(np.rint(x * 65535).astype(np.uint16))
            parts.append(y)
    if not depth:
        raise CloudError(
            f"{', '.join(map(str, sources))} hold no labelled part; generate or label some first"
        )
    return Crops(np.stack(depth), np.stack(parts))


def batches(
    crops: Crops, size: int, rng: np.random.Generator, augmented: bool = True
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.uint8]]]:
    """One epoch in random order: (B, 1, 212, 212) float32, (B, 212, 212) uint8; a short rest is dropped."""
    order = rng.permutation(len(crops))
    for start in range(0, len(order) - size + 1, size) if len(order) >= size else [0]:
        index = order[start : start + size]
        x = crops.depth[index].astype(np.float32) / np.float32(65535)
        y = crops.parts[index].copy()
        if augmented:
            for i in range(len(index)):
                x[i], y[i] = augment(x[i], y[i], rng)
        yield x[:, None], y


def augment(
    depth: NDArray[np.float32], parts: NDArray[np.uint8], rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """A random mirror image, scale, shift, missing blobs, holes and ragged border of one crop (h, w)."""
    if rng.random() < 0.5:
        depth, parts = depth[:, ::-1], swap_left_right(parts[:, ::-1])
    depth, parts = _zoom(depth, parts, rng)
    lost = rng.random(depth.shape, dtype=np.float32) < rng.uniform(0, 0.03)
    if rng.random() < 0.3:
        lost |= _blobs(depth.shape, depth > 0, rng)
    moved = np.clip(depth + np.float32(rng.normal(0, 0.02)), NEAREST, 1)
    depth = np.where((depth > 0) & ~lost, moved, 0).astype(np.float32)
    parts = parts.copy()
    # What nobody sees cannot be learnt or held against the network.
    parts[lost & (parts != BACKGROUND)] = UNDEFINED
    return depth, parts


def _zoom(
    depth: NDArray[np.float32], parts: NDArray[np.uint8], rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Resample about the middle: the extraction's box is never quite the same."""
    size = depth.shape[0]
    scale, (dv, du) = rng.uniform(0.9, 1.15), rng.uniform(-0.06, 0.06, 2) * size
    v = np.rint((np.arange(size) - size / 2) * scale + size / 2 + dv).astype(int)
    u = np.rint((np.arange(size) - size / 2) * scale + size / 2 + du).astype(int)
    inside = ((v >= 0) & (v < size))[:, None] & ((u >= 0) & (u < size))
    grid = np.ix_(np.clip(v, 0, size - 1), np.clip(u, 0, size - 1))
    return np.where(inside, depth[grid], 0).astype(np.float32), np.where(inside, parts[grid], 0).astype(
        np.uint8
    )


def _blobs(shape: tuple[int, ...], person: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """One to three discs or half planes that an occluder or a failed extraction takes away."""
    v, u = np.ogrid[: shape[0], : shape[1]]
    lost = np.zeros(shape, bool)
    where = np.argwhere(person)
    for _ in range(int(rng.integers(1, 4)) if len(where) else 0):
        centre = where[rng.integers(len(where))]
        radius = rng.uniform(5, 24)
        stretch = rng.uniform(0.5, 2)
        lost |= (v - centre[0]) ** 2 * stretch + (u - centre[1]) ** 2 / stretch < radius**2
    return lost
