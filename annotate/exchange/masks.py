"""A frame's label images as named masks, as tools for instances keep them, and back."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, UInt8
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS, UNDEFINED
from sensors.errors import FormatError

PERSON = "person"
"""Name of the mask of a whole person."""
MASK_IDS = {**{part.name: part.id for part in BODY_PARTS}, "undefined": UNDEFINED}
"""Part id by the name of a mask of the parts image; the background is what no mask covers."""
_SEPARATORS = re.compile(r"[\s-]+")


@dataclass(frozen=True)
class Mask:
    """One mask: its category's name, the number of the person for PERSON, and its pixels (h, w)."""

    name: str
    person: int
    pixels: Bool


def masks_of(frame: FrameLabels) -> Iterator[Mask]:
    """One mask for each part in the frame, undefined included, then one for each person."""
    for name, part in MASK_IDS.items():
        pixels = frame.parts == part
        if pixels.any():
            yield Mask(name, 0, pixels)
    if frame.persons is not None:
        for person in np.unique(frame.persons[frame.persons > 0]):
            yield Mask(PERSON, int(person), frame.persons == person)


def images_from(masks: Iterable[Mask], shape: tuple[int, int]) -> tuple[UInt8, UInt8]:
    """Return parts and persons (h, w) of masks; where masks overlap, the later one wins.

    Letter case does not count in their names, and spaces and hyphens are underscores. Raises FormatError.
    """
    parts, persons = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for mask in masks:
        name = _SEPARATORS.sub("_", mask.name.strip().lower())
        if name == PERSON:
            if not 1 <= mask.person <= 255:
                raise FormatError(f"person number {mask.person} is impossible; use 1 to 255")
            persons[mask.pixels] = mask.person
        elif name in MASK_IDS:
            parts[mask.pixels] = MASK_IDS[name]
        else:
            raise FormatError(f"label {mask.name[:40]!r} is not a body part; use {', '.join(MASK_IDS)}")
    return parts, persons


def runs_of(flat: Bool) -> list[int]:
    """Run lengths of a flat mask (n,); the first run is of zeros and may be empty."""
    change = np.flatnonzero(np.diff(flat)) + 1
    bounds = np.concatenate([[0] if len(flat) and flat[0] else [], [0], change, [len(flat)]]).astype(np.int64)
    return [int(n) for n in np.diff(bounds)]


def mask_from_runs(runs: list[int], size: int) -> Bool:
    """Inverse of ``runs_of`` for a mask of ``size`` pixels. Raises FormatError."""
    lengths = np.array(runs, np.int64)
    if (lengths < 0).any() or (lengths > size).any() or int(lengths.sum()) != size:
        raise FormatError(f"a mask's runs do not add up to its {size} pixels; export it again")
    return np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)
