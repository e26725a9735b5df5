"""Examples for the second stage: the finder's candidates in augmented images, with the truth.

A candidate is true if at least half of its pixels show one person and no other candidate shows more of that
person. It is false if less than a fifth show people, or if it is a smaller piece of a person. Other
candidates are left out.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.person.detection.candidates import Candidates
from annotate.person.detection.finder import candidates_in
from annotate.person.detection.finder_network import FOCAL_PX
from eval.training.finder.images import Image, augmented_depth
from eval.training.finder.verification import Examples
from sensors.rig.camera import Intrinsics, unproject

OF_ONE, OF_ANY = 0.5, 0.2  # shares of pixels: least of one person if true; of all people, below if false


def is_person(mask: Bool, persons: UInt8) -> bool | None:
    """Return whether a candidate shows a person, whatever other candidates show; None = left out.

    mask: its pixels (h, w), at least one. persons: person numbers (h, w), 0 = no person.
    """
    shares = np.bincount(persons[mask], minlength=2)[1:] / np.count_nonzero(mask)
    if shares.sum() >= OF_ANY and shares.max() < OF_ONE:
        return None
    return bool(shares.max() >= OF_ONE)


def truths(masks: Sequence[Bool], persons: UInt8) -> list[bool | None]:
    """Return for each candidate of an image whether the candidate is true; None = left out.

    masks: pixels (h, w) of each candidate, at least one. persons: person numbers (h, w), 0 = no person.
    """
    shown = np.array([np.bincount(persons[mask], minlength=256)[1:] for mask in masks])
    found: list[bool | None] = []
    for mask, pixels in zip(masks, shown, strict=True):
        truth, number = is_person(mask, persons), pixels.argmax()
        found.append(truth and bool(pixels[number] == shown[:, number].max()))
    return found


def examples_of(images: Iterable[Image], rng: np.random.Generator) -> Examples:
    """Return the candidates in each image, augmented once, with the truth."""
    rows = [row for image in images for row in _rows(image, rng)]
    crops, truth = zip(*rows, strict=True) if rows else ((), ())
    return Examples(np.array(crops, np.float16), np.array(truth, np.float32))


def _rows(image: Image, rng: np.random.Generator) -> Iterator[tuple[Float32, bool]]:
    depth_m, persons = augmented_depth(image, rng)
    candidates = candidates_in_depth(depth_m)
    masks = list(candidates.masks().values())
    for mask, truth in zip(masks, truths(masks, persons), strict=True):
        if truth is not None:
            yield candidates.crop(mask), truth


def candidates_in_depth(depth_m: Float32) -> Candidates:
    """Return the candidates in depth (h, w) at the finder's focal length, 0 = no reading."""
    height, width = depth_m.shape
    camera = Intrinsics(width, height, FOCAL_PX, FOCAL_PX, (width - 1) / 2, (height - 1) / 2)
    unfelt = np.full(depth_m.shape, np.nan, np.float32)
    return candidates_in(unproject(camera, depth_m), unfelt, (FOCAL_PX, FOCAL_PX))
