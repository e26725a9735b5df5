"""Labels as named masks, run lengths and polygons, as annotation programs store them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, Float64, UInt8
from annotate.exchange.class_names import PERSON, PERSON_ID, mask_ids, plain
from annotate.frame_labels import FrameLabels
from sensors.errors import FormatError

POLYGONS = "polygons are filled: their borders are approximate"  # remark
FEW_CORNERS = "polygons of fewer than three corners are not read"
FARTHEST_PX = 1e5  # of a corner from the origin, because programs let corners lie outside the image
CELLS = 1 << 22  # crossings of edges and rows computed at once: bounds memory


@dataclass(frozen=True)
class Mask:
    """Mask (h, w) with the name of its category. person: person number, for the category PERSON."""

    name: str
    person: int
    pixels: Bool


def masks_of(frame: FrameLabels) -> Iterator[Mask]:
    """Yield a mask for each part in the frame, undefined included, then for each person."""
    for name, part in mask_ids(frame.scheme).items():
        pixels = frame.parts == part
        if pixels.any():
            yield Mask(name, 0, pixels)
    if frame.persons is not None:
        for person in np.unique(frame.persons[frame.persons > 0]):
            yield Mask(PERSON, int(person), frame.persons == person)


def images_from(masks: Iterable[Mask], shape: tuple[int, int], ids: Mapping[str, int]) -> tuple[UInt8, UInt8]:
    """Return parts and persons (h, w) of masks; later masks win. ids: by plain name.

    Raises FormatError for a person number that does not fit 8 bits.
    """
    parts, persons = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for mask in masks:
        part = ids[plain(mask.name)]
        if part == PERSON_ID:
            if not 1 <= mask.person <= 255:
                raise FormatError(f"person number {mask.person} is impossible; use 1 to 255")
            persons[mask.pixels] = mask.person
        else:
            parts[mask.pixels] = part
    return parts, persons


def runs_of(flat: Bool) -> list[int]:
    """Return the run lengths of a flat mask (n,); the first run is of zeros and may be empty."""
    change = np.flatnonzero(np.diff(flat)) + 1
    bounds = np.concatenate([[0] if len(flat) and flat[0] else [], [0], change, [len(flat)]]).astype(np.int64)
    return [int(n) for n in np.diff(bounds)]


def mask_from_runs(runs: list[int], size: int) -> Bool:
    """Return the mask (size,) of the run lengths of ``runs_of``. Raises FormatError where their sum is not
    ``size``.
    """
    lengths = np.array(runs, np.int64)
    if (lengths < 0).any() or (lengths > size).any() or int(lengths.sum()) != size:
        raise FormatError(f"a mask's runs do not add up to its {size} pixels; export it again")
    return np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)


def polygon_pixels(corners: Float64, shape: tuple[int, int]) -> Bool:
    """Return the pixels (h, w) with their centre inside a polygon with corners (n, 2), x and y.

    Pixel centres lie at halves, as in COCO and CVAT. By the even-odd rule a polygon that overlaps itself has
    a hole. Raises FormatError for fewer than three corners, or corners far outside.
    """
    if corners.shape[1:] != (2,) or len(corners) < 3:
        raise FormatError(f"a polygon has corners of shape {corners.shape}; export 3 or more (x, y)")
    if not (np.abs(corners) < FARTHEST_PX).all():
        raise FormatError(f"a polygon has a corner over {FARTHEST_PX:g} pixels away; export it again")
    height, width = shape
    crossed = np.zeros(height * (width + 1), np.int64)
    rows, step = np.arange(height) + 0.5, max(1, CELLS // height)
    ends = np.roll(corners, -1, axis=0)
    for at in range(0, len(corners), step):
        (x0, y0), (x1, y1) = corners[at : at + step].T, ends[at : at + step].T
        edge, row = np.nonzero((y0[:, None] <= rows) != (y1[:, None] <= rows))
        share = (rows[row] - y0[edge]) / (y1 - y0)[edge]
        x = x0[edge] + share * (x1 - x0)[edge]
        column = np.clip(np.ceil(x - 0.5), 0, width).astype(np.intp)
        crossed += np.bincount(row * (width + 1) + column, minlength=crossed.size)
    return np.asarray(np.cumsum(crossed.reshape(height, width + 1), axis=1)[:, :width] % 2 == 1)
