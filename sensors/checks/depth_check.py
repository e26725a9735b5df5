"""Check of depth images: it accepts or refuses their numbers, and finds their unit and invalid codes.

The check uses physics, not names: the range of the scene, the agreement of neighbouring pixels, isolated
codes. A declared unit is always used, and doubts about it become notes. An assumed unit with an impossible
scene is refused, and the error lists possible units. In a room the floor in front is nearer than the wall
behind it. Therefore images whose lower part is farther are reported as turned upside down, or as disparity.
Constants are untuned unless a source is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.checks.depth_units import (
    LEAST_PIXELS,
    MEDIAN_M,
    Range,
    impossible,
    metres,
    range_of,
    remedy,
    unit_of,
)
from sensors.errors import FormatError, Note, Setting
from sensors.rig.frame import mm_from_units

Image = NDArray[Any]

SATURATED = 65535  # of 16 bits; OAK cameras and others write it for no reading
CODES = tuple(2**bits - 1 for bits in (11, 12, 13, 14, 15))  # of sensors of 11 to 15 bits (Kinect v1: 2047)
ROUND_M, WORDS = 4.0, (65535, 65534)  # m from which whole ones may be a code; words, / 1000 in floats
BEYOND = 1e9  # values from here on are never depth
LEAST_SHARE, GAP = 0.001, 0.1  # of pixels with such a code; free range below it, as its share
MANY, MANY_GAP = 0.01, 0.02  # the same of round values, and of codes close to the farthest readings
CUT_OUT = 0.5  # share of pixels without a reading from which a person is cut out of the background
FAR_M, SHORT_M = 13.0, 0.8  # where a hundredth is farther (TUM's end at 13.1 m), or nothing is: a doubt
FLAT = 1.2  # farthest over nearest of what may be a wall alone
SMOOTHER = 8  # by which neighbours agree better after a swap of bytes, which multiplies steps by 256
ROUGH_M, ROUGH = 0.5, 0.125  # m, and share of the median: neighbours in other data differ by more
MOST_PIXELS = 100_000  # of a sample that are examined
FARTHER = 1.4  # lower over upper quarter, in all images; upright rooms have 0.1 to 1.15, turned ones 1.9
FILLED = 0.25  # share of a quarter's pixels with a reading from which it is compared
SAMPLES = 5  # frames of a source that are examined
BYTES = (
    "depth of 8 bits has no known unit; store 16-bit integers in millimetres, or give the millimetres of "
    "a step"
)
JUDGED = "depth:"  # first word of the judge's note
UPSIDE_DOWN = "doubtful depth: the lower quarter"  # first words of the note


@dataclass(frozen=True)
class DepthReading:
    """Rule for reading a source's depth images.

    unit_mm: millimetres of a step. invalid: codes for no reading besides 0, negative and non-finite ones.
    swapped: True if the two bytes of a word are exchanged. range_m: range of the samples, None with too few
    readings. notes: assumptions and doubts, one sentence each.
    """

    unit_mm: float
    invalid: tuple[float, ...] = ()
    swapped: bool = False
    range_m: Range | None = None
    notes: tuple[str, ...] = ()

    def to_mm(self, image: Image) -> NDArray[np.uint16]:
        """Return a stored image in whole millimetres (h, w), 0 = no reading or beyond 16 bits."""
        words = image.byteswap() if self.swapped else image
        if not self.invalid:
            return mm_from_units(words, self.unit_mm)
        bad = np.isin(words, self.invalid) if len(self.invalid) > 1 else words == self.invalid[0]
        return mm_from_units(np.where(bad, words.dtype.type(0), words), self.unit_mm)


def spread(count: int, most: int = SAMPLES) -> list[int]:
    """Return at most ``most`` indices of ``count`` frames, evenly spread from the first to the last."""
    return [int(at) for at in np.unique(np.linspace(0, max(count - 1, 0), min(most, count)).round())]


def judge_depth(
    samples: Sequence[Image], unit_mm: float | None, where: str, likely_mm: float | None = None
) -> DepthReading:
    """Judge depth images (h, w) as a source stores them, integers or floats.

    unit_mm: millimetres of a step if declared, None = assumed: 1 for integers, 1000 for floats. likely_mm:
    the unit of files of this kind, which replaces an impossible assumed one. where: the source in messages.
    Raises FormatError where the images are not depth, or the assumed unit gives an impossible scene.
    """
    images = [_thinned(np.asarray(sample)) for sample in samples if np.size(sample)]
    kind = images[0].dtype if images else np.dtype(np.uint16)
    if kind.itemsize == 1 and unit_mm is None:
        raise FormatError(f"{where}: {BYTES}", Setting.DEPTH_UNIT)
    swapped = kind.kind in "iu" and kind.itemsize == 2 and _swapped(images)
    words = [image.byteswap() if swapped else image for image in images]
    invalid = _codes(words, unit_mm or 1.0)
    values = np.concatenate([np.zeros(0), *(_valid(image, invalid) for image in words)])
    unit, notes = unit_of(values, kind.kind == "f", unit_mm, where, likely_mm)
    total = sum(image.size for image in images)
    if len(values) < LEAST_PIXELS:
        few = [f"only {len(values)} depth readings in the {len(images)} images looked at"]
        lines = (*notes, *(few if total > 4 * LEAST_PIXELS else []))
        return DepthReading(unit, invalid, swapped, None, lines)
    found = range_of(values, unit)
    if found.far <= 0 or found.near > SATURATED / 1000:
        raise FormatError(
            f"{where}: depth has no reading within 65 m with {unit:g} mm a step (1st, 50th and 99th "
            f"percentile: {found}); {remedy(values, unit)}",
            Setting.DEPTH_UNIT,
        )
    source = "assumed" if unit_mm is None else "declared"
    first = (
        f"{JUDGED} {unit:g} mm a step ({source}), {found} at the 1st, 50th and 99th percentile; "
        f"no reading: {1 - len(values) / total:.1%} of the pixels"
    )
    turned = ["bytes of the depth words are swapped: read the other way round"] if swapped else []
    doubts = _doubts(found, words, unit, assumed=unit_mm is None) + upside_down(words, invalid, unit)
    return DepthReading(
        unit, invalid, swapped, found, (first, *turned, *_seen_codes(words, invalid), *notes, *doubts)
    )


def _thinned(image: Image) -> Image:
    """Return evenly spaced rows of a large image; neighbours along a row stay neighbours."""
    return image[:: max(1, image.size // MOST_PIXELS)] if image.ndim == 2 else image


def _valid(image: Image, invalid: tuple[float, ...]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore", over="ignore"):
        values = image.astype(np.float64).ravel()
    return values[np.isfinite(values) & (values > 0) & (values < BEYOND) & ~np.isin(values, invalid)]


def _swapped(images: Sequence[Image]) -> bool:
    """Return whether neighbours differ far less after the bytes of every word are exchanged."""
    steps, other = (_steps(each) for each in (images, [image.byteswap() for image in images]))
    return len(steps) >= LEAST_PIXELS and float(other.mean()) * SMOOTHER < float(steps.mean())


def _steps(images: Sequence[Image]) -> NDArray[np.float64]:
    """Return the differences of neighbours in a row, both of which have a reading."""
    steps = [np.zeros(0)]
    for image in images:
        with np.errstate(invalid="ignore"):
            wide = np.where(np.isfinite(image), image, 0).astype(np.float64)
        good = (wide > 0) & (wide != SATURATED)
        steps.append(np.abs(np.diff(wide, axis=1))[good[:, 1:] & good[:, :-1]])
    return np.concatenate(steps)


def _codes(images: Sequence[Image], unit_mm: float) -> tuple[float, ...]:
    """Return the codes that stand for no reading. unit_mm: of integers, declared or 1."""
    if not images:
        return ()
    whole = images[0].dtype.kind in "iu"
    always = (SATURATED,) if whole and images[0].dtype.itemsize >= 2 else ()
    values = _valid(np.concatenate([image.ravel() for image in images]), (SATURATED,) if whole else ())
    if len(values) < LEAST_PIXELS:
        return always
    top = float(values.max())
    below, share = values[values < top], np.count_nonzero(values == top) / len(values)
    gap = 1 - float(below.max(initial=0)) / top
    if not whole:
        code = (top >= ROUND_M and top == round(top)) or any(np.isclose(top, word / 1000) for word in WORDS)
        return (top,) if len(below) and code and gap >= GAP and share > MANY else ()
    known = top in (*CODES, 65536) and gap >= GAP and share > LEAST_SHARE
    round_m = top * unit_mm / 1000
    is_round = ROUND_M <= round_m == round(round_m)
    many = (top in (*CODES, *WORDS) or is_round) and gap >= MANY_GAP and share > MANY
    return (*always, int(top)) if len(below) and (known or many) else always


def _seen_codes(images: Sequence[Image], invalid: tuple[float, ...]) -> list[str]:
    total = sum(image.size for image in images)
    shares = {code: sum(np.count_nonzero(image == code) for image in images) / total for code in invalid}
    return [
        f"depth of {code:g} means no reading: {share:.1%} of the pixels"
        for code, share in shares.items()
        if share
    ]


def _doubts(found: Range, images: Sequence[Image], unit_mm: float, *, assumed: bool) -> list[str]:
    """Return doubts about a scene that is accepted nevertheless, one sentence each."""
    why = impossible(found)
    if not why and found.median > MEDIAN_M:
        why = f"half of the scene is farther than {metres(found.median)}"
    if not why and assumed and (found.far > FAR_M or found.far < SHORT_M):
        side = "a part of the scene is farther" if found.far > FAR_M else "nothing is farther"
        why = f"{side} than {metres(found.far)}"
    doubts = list[str]()
    if why:
        doubt = f"doubtful depth: {why} with {unit_mm:g} mm a step; give the unit if that is wrong"
        doubts.append(Note(doubt, Setting.DEPTH_UNIT))
    empty = np.mean([np.count_nonzero(image == 0) / image.size for image in images])
    if found.far < FLAT * found.near and empty < CUT_OUT:
        span = f"all depth is from {metres(found.near)} to {metres(found.far)}"
        return [*doubts, f"{span}: a wall, or not a depth image"]
    steps = _steps(images)
    step_m = float(np.median(steps)) * unit_mm / 1000 if len(steps) >= LEAST_PIXELS else 0.0
    if step_m > max(ROUGH_M, found.median * ROUGH):
        doubts.append(
            f"doubtful depth: neighbouring pixels differ by {metres(step_m)}: perhaps not a depth image"
        )
    return doubts


def upside_down(images: Sequence[Image], invalid: tuple[float, ...], unit_mm: float) -> list[str]:
    """Return a note if all comparable images (h, w) look upside down, else an empty list."""
    pairs = [pair for image in images if (pair := _quarters(image, invalid)) is not None]
    if not pairs or min(lower / upper for upper, lower in pairs) < FARTHER:
        return []
    upper, lower = np.median(pairs, axis=0) * unit_mm / 1000
    doubt = (
        f"{UPSIDE_DOWN} of the images is farther ({metres(lower)}) than the upper ({metres(upper)}): "
        "they hold disparity, or are upside down; turn them by 180 degrees"
    )
    return [Note(doubt, Setting.TURN)]


def _quarters(image: Image, invalid: tuple[float, ...]) -> tuple[float, float] | None:
    """Return the medians of the upper and the lower quarter of an image; None without enough readings."""
    rows = len(image) // 4
    medians = []
    for part in (image[:rows], image[len(image) - rows :]):
        with np.errstate(invalid="ignore"):
            good = part[np.isfinite(part) & (part > 0) & ~np.isin(part, invalid)]
        if not rows or good.size < FILLED * part.size:
            return None
        medians.append(float(np.median(good)))
    return medians[0], medians[1]
