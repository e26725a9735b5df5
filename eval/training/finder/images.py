"""Training images of the person finder: scenes at its input's focal length, augmented, with true votes.

A vote is the vector from a person's pixel to the middle of that person. Constants are untuned.
"""

from pathlib import Path
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, UInt8, UInt16
from annotate.person.finder import FOCAL_PX, network_input
from eval.training.finder.scenes import Scene, rig_scenes, room_scenes
from eval.training.finder.warm import degraded_warmth, random_warmth
from sensors.files.atomic import replacing

HEIGHT, WIDTH = 192, 256  # of a training image
LEAST_PX, FARTHEST_M = 20, 2.0  # least pixels (at half the sides) of a voting person; longest vote on an axis
CUT_OUT, FAR_CLIP, NEAR_CLIP = 0.15, 0.3, 0.35  # cumulative shares: people only, nothing far, nothing near
NEARER, MOST_NEARER = 0.4, 0.9  # share of images from nearer, and the largest log factor
FEELABLE = 0.6  # share of rooms with random warmth; the others have none

Image: TypeAlias = tuple[UInt16, NDArray[np.float16], UInt8]
"""Depth in millimetres, warmth and people (h, w) of a scene at the finder's focal length."""


class SceneImages(NamedTuple):
    """Stored training images of the virtual rig and of random rooms."""

    rig: list[Image]
    rooms: list[Image]


class Batch(NamedTuple):
    """Images of one training step.

    inputs: (B, 24, h / 2, w / 2). person, known: (B, h, w), 0 or 1. votes: (B, 3, h / 2, w / 2), vectors
    to the middle of the person, for every second pixel.
    """

    inputs: Float32
    person: Float32
    votes: Float32
    known: Float32


def store_scenes(folder: Path, rigs: int, rooms: int) -> None:
    """Write training images once: recordings of the rig, ``rig_SEED.npz``, and random rooms,
    ``room_SEED.npz``; seeds from 1 on.
    """
    kinds = (("room", room_scenes, rooms), ("rig", rig_scenes, rigs))
    for kind, scenes, count in kinds:
        for seed in range(1, count + 1):
            path = folder / f"{kind}_{seed:06d}.npz"
            if not path.exists():
                images = map(_image_of, scenes(seed))
                arrays = {
                    f"{name}{i}": a
                    for i, image in enumerate(images)
                    for name, a in zip("dwp", image, strict=True)
                }
                with replacing(path) as temporary, temporary.open("wb") as file:
                    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def load_scenes(folder: Path) -> SceneImages:
    """Return all images that ``store_scenes`` wrote."""
    return SceneImages(*(_loaded(sorted(folder.glob(f"{kind}_*.npz"))) for kind in ("rig", "room")))


def _loaded(paths: list[Path]) -> list[Image]:
    images = []
    for path in paths:
        with np.load(path) as arrays:
            count = len(arrays.files) // 3
            images += [(arrays[f"d{i}"], arrays[f"w{i}"], arrays[f"p{i}"]) for i in range(count)]
    return images


def _image_of(scene: Scene) -> Image:
    """Return a scene resampled to the focal length ``FOCAL_PX`` of the finder's input."""
    scale = FOCAL_PX / scene.camera.fx
    v, u = (
        np.minimum(((np.arange(round(side * scale)) + 0.5) / scale).astype(int), side - 1)
        for side in scene.depth_mm.shape
    )
    small = np.ix_(v, u)
    return scene.depth_mm[small], scene.warmth[small].astype(np.float16), scene.persons[small]


def draw_batch(images: SceneImages, size: int, rng: np.random.Generator) -> Batch:
    """Return a batch of random, augmented images, every second one from the virtual rig."""
    kinds = [kind for kind in images if kind]
    drawn = (kinds[i % len(kinds)] for i in range(size))
    made = [_example(kind[int(rng.integers(len(kind)))], rng) for kind in drawn]
    return Batch(*(np.stack(arrays) for arrays in zip(*made, strict=True)))


def _example(image: Image, rng: np.random.Generator) -> Batch:
    """Return an augmented image with its targets, as a `Batch` without its first axis."""
    depth_mm, felt, whose = image
    warmth = felt.astype(np.float32)
    if not np.isfinite(warmth).any() and rng.random() < FEELABLE:
        warmth = random_warmth(depth_mm, whose, rng)
    depth, warmth, persons = _moved(depth_mm, warmth, whose, rng)
    depth = _worn(_cut(depth, persons, rng), rng)
    persons = np.where(depth > 0, persons, 0)
    votes = _votes(depth[::2, ::2], persons[::2, ::2])
    inputs = network_input(depth, degraded_warmth(warmth, rng))
    return Batch(inputs, (persons > 0).astype(np.float32), votes, (depth > 0).astype(np.float32))


def _moved(
    depth_mm: UInt16, warmth: Float32, persons: UInt8, rng: np.random.Generator
) -> tuple[Float32, Float32, UInt8]:
    """Return depth in metres, warmth and people after random zoom, turn, shift, flip and change of size."""
    nearer = np.exp(rng.uniform(0, MOST_NEARER)) if rng.random() < NEARER else 1.0
    zoom, turn = nearer * np.exp(rng.uniform(-0.22, 0.22)), np.radians(rng.normal(0, 5))
    c, s, mirror = np.cos(turn) / zoom, np.sin(turn) / zoom, rng.choice((-1, 1))
    linear = np.array([[c * mirror, -s], [s * mirror, c]])
    (height, width), shift = depth_mm.shape, rng.uniform((-33, -26), (33, 26))
    middle = np.array([width - 1, height - 1]) / 2 - linear @ (np.array([WIDTH - 1, HEIGHT - 1]) / 2 + shift)
    source_from_image = np.column_stack([linear, middle])
    flags = cv2.WARP_INVERSE_MAP | cv2.INTER_NEAREST
    depth, felt, whose = (
        cv2.warpAffine(plane, source_from_image, (WIDTH, HEIGHT), flags=flags)
        for plane in (depth_mm, warmth, persons)
    )
    size = 0.001 / nearer * np.exp(rng.uniform(-0.15, 0.15))
    return (depth * np.float32(size)).astype(np.float32), felt.astype(np.float32), whose.astype(np.uint8)


def _cut(depth: Float32, persons: UInt8, rng: np.random.Generator) -> Float32:
    """Return depth, in some images without the background, the far pixels or the near pixels."""
    kind, person = rng.random(), persons > 0
    if kind < CUT_OUT:
        rim = int(rng.integers(-2, 4))
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
    """Return depth with sensor faults: a missing rectangle, missing borders, holes and noise.

    Each fault occurs in some images only.
    """
    depth = depth.copy()
    if rng.random() < 0.15:
        top, left = rng.integers((HEIGHT, WIDTH))
        height, width = rng.integers(12, 90, 2)
        depth[top : top + height, left : left + width] = 0
    if rng.random() < 0.15:
        depth[rng.random(depth.shape) < rng.uniform(0, 0.2)] = 0
    if rng.random() < 0.15:
        noise = rng.normal(0, rng.uniform(0, 0.012), depth.shape)
        depth = np.where(depth > 0, np.maximum(depth + noise, 0), 0).astype(np.float32)
    if rng.random() < 0.15:
        cut, borders = int(rng.integers(15, 90)), (np.s_[:, :], np.s_[::-1], np.s_[:, ::-1])
        turned = depth.T if rng.random() < 0.5 else depth
        turned[borders[int(rng.integers(3))]][:cut] = 0
    return depth


def _votes(depth: Float32, persons: UInt8) -> Float32:
    """Return the vector (3, h, w) from each pixel of a person to the middle of the person, in metres.

    The axes are right, down, away. depth, persons: (h, w), every second pixel of an image.
    """
    votes = np.zeros((3, *depth.shape), np.float32)
    for number in range(1, int(persons.max(initial=0)) + 1):
        v, u = np.nonzero(persons == number)
        if len(v) < LEAST_PX:
            continue
        z = depth[v, u]
        votes[0, v, u] = (u.mean() - u) * z * (2 / FOCAL_PX)
        votes[1, v, u] = (v.mean() - v) * z * (2 / FOCAL_PX)
        votes[2, v, u] = z.mean() - z
    return votes.clip(-FARTHEST_M, FARTHEST_M)
