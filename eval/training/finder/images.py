"""Training images of the person finder: augmented scenes at the focal length of its input, with true votes.

A vote is the vector from a person's pixel to the middle of that person. Constants are untuned.
"""

from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.person.detection.finder_network import FOCAL_PX, network_input
from eval.training.finder.warm import degraded_warmth, random_warmth

STORED_FOCAL_PX = 183.0  # of a stored image, about as of a coarse cloud
HEIGHT, WIDTH = 256, 320  # of a training image; multiples of the network's ``MULTIPLE``
MOST_SHIFT_PX = (41, 32)  # of a training image: right or left, down or up
LEAST_PX, FARTHEST_M = 45, 2.0  # least pixels (at half the sides) of a voting person; longest vote on an axis
CUT_OUT, FAR_CLIP, NEAR_CLIP = 0.2, 0.35, 0.4  # cumulative shares: people or a thing alone, nothing far, near
THING_ALONE = 0.5  # share of cut-outs with a thing in place of the people
LEAST_THING_PX = 900  # of such a thing
FIRST_THING = 32  # number of a thing's surface, less 1; people have lower ones
NEARER, MOST_NEARER = 0.4, 0.9  # share of images from nearer, and the largest log factor
PERSON_WEIGHT = 0.5  # extra weight of a person's pixels in the loss
USUAL_PX, MOST_MORE = 4500.0, 4.0  # person's pixels below which the weight grows by their root; most growth
FEELABLE = 0.6  # share of rooms with random warmth; the others have none

Image: TypeAlias = tuple[UInt16, NDArray[np.float16], UInt8]
"""Depth in millimetres, warmth and surfaces (h, w) of a scene at ``STORED_FOCAL_PX``.

Surfaces: number of a person from 1 on, of a thing from ``FIRST_THING`` on, 0 = neither.
"""


class SceneImages(NamedTuple):
    """Stored training images of the virtual rig, of random rooms, of close rooms and of empty rooms."""

    rig: list[Image]
    rooms: list[Image]
    close: list[Image] = []  # noqa: RUF012
    empty: list[Image] = []  # noqa: RUF012

    def in_turn(self) -> list[list[Image]]:
        """Return the kinds that have images, in the order of a batch; the finder uses no empty rooms."""
        return [kind for kind in (self.rig, self.rooms, self.rig, self.close, self.rig, self.rooms) if kind]


class Batch(NamedTuple):
    """Images of one training step.

    inputs: (B, 24, h / 2, w / 2). person: (B, h, w), 0 or 1. votes: (B, 3, h / 2, w / 2), vectors to the
    middle of the person, for every second pixel. weight: (B, h, w), of a pixel in the loss; 0 = no reading.
    """

    inputs: Float32
    person: Float32
    votes: Float32
    weight: Float32


def draw_batch(images: SceneImages, size: int, rng: np.random.Generator) -> Batch:
    """Return a batch of random, augmented images.

    Half of them are of the rig, because a finder trained on fewer lost people in bed.
    """
    kinds = images.in_turn()
    drawn = (kinds[i % len(kinds)] for i in range(size))
    made = [_example(kind[int(rng.integers(len(kind)))], rng) for kind in drawn]
    return Batch(*(np.stack(arrays) for arrays in zip(*made, strict=True)))


def _example(image: Image, rng: np.random.Generator) -> Batch:
    """Return an augmented image with its targets, as a `Batch` without its first axis."""
    depth_mm, felt, whose = image
    warmth = felt.astype(np.float32)
    if not np.isfinite(warmth).any() and rng.random() < FEELABLE:
        warmth = random_warmth(depth_mm, _persons(whose), rng)
    depth, persons, warmth = _augmented(depth_mm, warmth, whose, rng)
    votes = _votes(depth[::2, ::2], persons[::2, ::2])
    inputs = network_input(depth, degraded_warmth(warmth, rng))
    return Batch(inputs, (persons > 0).astype(np.float32), votes, _weights(depth, persons))


def _augmented(
    depth_mm: UInt16, warmth: Float32, whose: UInt8, rng: np.random.Generator
) -> tuple[Float32, UInt8, Float32]:
    """Return depth in metres, persons and warmth (h, w), moved, cut and worn at random."""
    depth, warmth, whose = _moved(depth_mm, warmth, whose, rng)
    depth = _worn(_cut(depth, whose, rng), rng)
    return depth, np.where(depth > 0, _persons(whose), np.uint8(0)), warmth


def augmented_depth(image: Image, rng: np.random.Generator) -> tuple[Float32, UInt8]:
    """Return an augmented image's depth in metres and its persons (h, w), 0 = none."""
    depth_mm, felt, whose = image
    return _augmented(depth_mm, felt.astype(np.float32), whose, rng)[:2]


def _weights(depth: Float32, persons: UInt8) -> Float32:
    """Return the weight (h, w) of pixels in the loss; a small person's pixels weigh more."""
    pixels = np.bincount(persons.ravel(), minlength=1)
    more = PERSON_WEIGHT * np.sqrt(USUAL_PX / np.maximum(pixels, 1)).clip(1, MOST_MORE)
    more[0] = 0
    return np.where(depth > 0, 1 + more[persons], 0).astype(np.float32)


def _persons(whose: UInt8) -> UInt8:
    return np.where(whose < FIRST_THING, whose, np.uint8(0))


def _moved(
    depth_mm: UInt16, warmth: Float32, whose: UInt8, rng: np.random.Generator
) -> tuple[Float32, Float32, UInt8]:
    """Return depth in metres, warmth and surfaces after random zoom, turn, shift, flip and change of size."""
    nearer = np.exp(rng.uniform(0, MOST_NEARER)) if rng.random() < NEARER else 1.0
    zoom = FOCAL_PX / STORED_FOCAL_PX * nearer * np.exp(rng.uniform(-0.22, 0.22))
    turn = np.radians(rng.normal(0, 5))
    c, s, mirror = np.cos(turn) / zoom, np.sin(turn) / zoom, rng.choice((-1, 1))
    linear = np.array([[c * mirror, -s], [s * mirror, c]])
    (height, width), shift = depth_mm.shape, rng.uniform(-1, 1, 2) * MOST_SHIFT_PX
    middle = np.array([width - 1, height - 1]) / 2 - linear @ (np.array([WIDTH - 1, HEIGHT - 1]) / 2 + shift)
    source_from_image = np.column_stack([linear, middle])
    flags = cv2.WARP_INVERSE_MAP | cv2.INTER_NEAREST
    depth, felt, moved = (
        cv2.warpAffine(plane, source_from_image, (WIDTH, HEIGHT), flags=flags)
        for plane in (depth_mm, warmth, whose)
    )
    size = 0.001 / nearer * np.exp(rng.uniform(-0.15, 0.15))
    return (depth * np.float32(size)).astype(np.float32), felt.astype(np.float32), moved.astype(np.uint8)


def _cut(depth: Float32, whose: UInt8, rng: np.random.Generator) -> Float32:
    """Return depth, in some images without the background, the far pixels or the near pixels."""
    kind, person = rng.random(), _persons(whose) > 0
    if kind < CUT_OUT:
        kept = _cut_out(whose, rng)
    elif kind < FAR_CLIP:
        middle = np.median(depth[person]) if person.any() else 2.0
        kept = depth < middle + rng.uniform(0.15, 2.5)
    elif kind < NEAR_CLIP:
        kept = depth > rng.uniform(0.3, 2.5)
    else:
        return depth
    return np.where(kept, depth, np.float32(0))


def _cut_out(whose: UInt8, rng: np.random.Generator) -> Bool:
    """Return the pixels (h, w) of people alone or of one thing alone, with a rim; all if there is neither.

    Things are cut out too, because otherwise whatever stands alone would be a person.
    """
    person = _persons(whose) > 0
    pixels = np.bincount(whose.ravel(), minlength=256)
    things = np.flatnonzero(pixels[FIRST_THING:] >= LEAST_THING_PX) + FIRST_THING
    rim = int(rng.integers(-3, 6))
    change, square = cv2.dilate if rim > 0 else cv2.erode, np.ones((abs(rim) + 1,) * 2, np.uint8)
    if len(things) and (not person.any() or rng.random() < THING_ALONE):
        thing = whose == things[int(rng.integers(len(things)))]
        return (change(thing.astype(np.uint8), square) > 0) & ~person
    return change(person.astype(np.uint8), square) > 0 if person.any() else np.ones(whose.shape, np.bool_)


def _worn(depth: Float32, rng: np.random.Generator) -> Float32:
    """Return depth with sensor faults: a missing rectangle, missing borders, holes and noise.

    Each fault occurs in some images only.
    """
    depth = depth.copy()
    if rng.random() < 0.15:
        top, left = rng.integers((HEIGHT, WIDTH))
        height, width = rng.integers(15, 112, 2)
        depth[top : top + height, left : left + width] = 0
    if rng.random() < 0.15:
        depth[rng.random(depth.shape) < rng.uniform(0, 0.2)] = 0
    if rng.random() < 0.15:
        noise = rng.normal(0, rng.uniform(0, 0.012), depth.shape)
        depth = np.where(depth > 0, np.maximum(depth + noise, 0), 0).astype(np.float32)
    if rng.random() < 0.15:
        cut, borders = int(rng.integers(19, 112)), (np.s_[:, :], np.s_[::-1], np.s_[:, ::-1])
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
