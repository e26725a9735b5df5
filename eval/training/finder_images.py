"""Training images of the person finder: scenes at its focal length, altered, with the votes to learn."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.person.depth_finder import FOCAL_PX, network_input
from eval.training.finder_scenes import Scene, rig_scenes, room_scenes

STORED_PX = 183.0
"""Focal length in pixels of stored images, so that zoom and rotation still find pixels between."""
HEIGHT, WIDTH = 128, 160
"""Of a training image."""
LEAST_PX, FARTHEST_M = 20, 2.0
"""Pixels of a person below which nothing votes, and longest vote along an axis. Chosen by eye."""
CUT_OUT, FAR_CLIP, NEAR_CLIP = 0.2, 0.35, 0.42
"""Share of images of cut-out people, with these those without what is far, and with both those without what
is near. Chosen by eye."""


class Batch(NamedTuple):
    """Images of one training step.

    inputs: (B, 3, h, w). person, known: (B, h, w), 0 or 1. votes: (B, 3, h, w), as of ``_votes``.
    """

    inputs: Float32
    person: Float32
    votes: Float32
    known: Float32


def store_scenes(folder: Path, seed: int) -> None:
    """Write one subject of the rig and one row of rooms, ``SEED.npz``, if not there yet."""
    path = folder / f"{seed:06d}.npz"
    if path.exists():
        return
    images = [_stored(scene) for scene in (*rig_scenes(seed), *room_scenes(seed))]
    arrays = {f"{name}{i}": a for i, pair in enumerate(images) for name, a in zip("dp", pair, strict=True)}
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def load_scenes(folder: Path) -> list[tuple[UInt16, UInt8]]:
    """Depth and people (h, w) of all stored images."""
    images = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as arrays:
            images += [(arrays[f"d{i}"], arrays[f"p{i}"]) for i in range(len(arrays.files) // 2)]
    return images


def _stored(scene: Scene) -> tuple[UInt16, UInt8]:
    """Depth and people of a scene at the stored focal length."""
    scale = STORED_PX / scene.camera.fx
    v, u = (
        np.minimum(((np.arange(round(side * scale)) + 0.5) / scale).astype(int), side - 1)
        for side in scene.depth_mm.shape
    )
    return scene.depth_mm[np.ix_(v, u)], scene.persons[np.ix_(v, u)]


def draw_batch(images: list[tuple[UInt16, UInt8]], size: int, rng: np.random.Generator) -> Batch:
    """A batch of images drawn and altered at random."""
    made = [_example(images[i], rng) for i in rng.integers(len(images), size=size)]
    return Batch(*(np.stack(arrays) for arrays in zip(*made, strict=True)))


def _example(image: tuple[UInt16, UInt8], rng: np.random.Generator) -> Batch:
    """One image as a batch without its first axis."""
    depth, persons = _moved(*image, rng)
    depth = _worn(_cut(depth, persons, rng), rng)
    persons = np.where(depth > 0, persons, 0)
    votes = _votes(depth, persons)
    return Batch(network_input(depth), _ones(persons > 0), votes, _ones(depth > 0))


def _ones(flags: Bool) -> Float32:
    return flags.astype(np.float32)


def _moved(depth_mm: UInt16, persons: UInt8, rng: np.random.Generator) -> tuple[Float32, UInt8]:
    """Depth in metres and people after zoom, turn, shift, mirror and another size of everything."""
    zoom = FOCAL_PX / STORED_PX * np.exp(rng.uniform(-0.22, 0.22))
    turn, (down, right) = np.radians(rng.normal(0, 5)), rng.uniform((-16, -20), (16, 20))
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    v, u = v - (HEIGHT - 1) / 2 - down, (u - (WIDTH - 1) / 2 - right) * rng.choice((-1, 1))
    c, s = np.cos(turn) / zoom, np.sin(turn) / zoom
    (height, width) = depth_mm.shape
    row = np.rint(s * u + c * v + (height - 1) / 2).astype(int)
    column = np.rint(c * u - s * v + (width - 1) / 2).astype(int)
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    at = np.where(inside, row * width + column, 0)
    size = 0.001 * np.exp(rng.uniform(-0.15, 0.15))
    depth, whose = (np.where(inside, image.ravel()[at], 0) for image in (depth_mm, persons))
    return (depth * size).astype(np.float32), whose.astype(np.uint8)


def _cut(depth: Float32, persons: UInt8, rng: np.random.Generator) -> Float32:
    """Depth without the background, without what is far, or without what is near; mostly as it is."""
    kind, person = rng.random(), persons > 0
    if kind < CUT_OUT:
        rim = int(rng.integers(-1, 3))
        change = cv2.dilate if rim > 0 else cv2.erode
        kept = change(person.astype(np.uint8), np.ones((abs(rim) + 1,) * 2, np.uint8)) > 0
    elif kind < FAR_CLIP:
        middle = np.median(depth[person]) if person.any() else 2.0
        kept = depth < middle + rng.uniform(0.15, 2.5)
    elif kind < NEAR_CLIP:
        kept = depth > rng.uniform(0.3, 2.5)
    else:
        return depth
    return np.where(kept, depth, np.float32(0))


def _worn(depth: Float32, rng: np.random.Generator) -> Float32:
    """Depth with a missing rectangle, missing borders, holes and noise, each in some images."""
    depth = depth.copy()
    if rng.random() < 0.15:
        top, left = rng.integers((HEIGHT, WIDTH))
        height, width = rng.integers(8, 60, 2)
        depth[top : top + height, left : left + width] = 0
    if rng.random() < 0.2:
        depth[rng.random(depth.shape) < rng.uniform(0, 0.2)] = 0
    if rng.random() < 0.2:
        noise = rng.normal(0, rng.uniform(0, 0.012), depth.shape)
        depth = np.where(depth > 0, np.maximum(depth + noise, 0), 0).astype(np.float32)
    if rng.random() < 0.15:
        cut, borders = int(rng.integers(10, 60)), (np.s_[:, :], np.s_[::-1], np.s_[:, ::-1])
        turned = depth.T if rng.random() < 0.5 else depth
        turned[borders[int(rng.integers(3))]][:cut] = 0
    return depth


def _votes(depth: Float32, persons: UInt8) -> Float32:
    """Way (3, h, w) from a person's pixels to the middle of what is seen of them: right, down, away."""
    votes = np.zeros((3, *depth.shape), np.float32)
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    for number in range(1, int(persons.max(initial=0)) + 1):
        own = persons == number
        if np.count_nonzero(own) < LEAST_PX:
            continue
        z = depth[own]
        votes[0][own] = (u[own].mean() - u[own]) * z / FOCAL_PX
        votes[1][own] = (v[own].mean() - v[own]) * z / FOCAL_PX
        votes[2][own] = z.mean() - z
    return votes.clip(-FARTHEST_M, FARTHEST_M)
