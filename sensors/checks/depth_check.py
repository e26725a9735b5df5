"""Judge of depth images: it accepts or refuses their numbers, and finds their unit and invalid codes.

The judge uses physics, not names: the range of the scene, the agreement of neighbouring pixels, codes that
stand apart. A declared unit is obeyed, and doubts about it are notes. An assumed unit that gives
an impossible scene is refused, with the units that give a possible one.
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
from sensors.checks.upright_check import upside_down
from sensors.errors import FormatError
from sensors.rig.frame import mm_from_units

Image = NDArray[Any]

SATURATED = 65535
"""Largest word of 16 bits: saturated, or how OAK cameras and others write that there is no reading."""
CODES = tuple(2**bits - 1 for bits in (11, 12, 13, 14, 15))
"""Largest words of sensors of 11 to 15 bits (2047: Kinect v1). They are no reading where they stand apart."""
ROUND_M, WORDS = 4.0, (65535, 65534)
"""Metres from which whole ones may be what programs write beyond the range instead of 0 (few rooms end
there); and words that programs write so, in floats divided by 1000."""
BEYOND = 1e9
"""Values from here on are never depth."""
LEAST_SHARE, GAP = 0.001, 0.1
"""Share of pixels that such a code has at least, and the free range below it, as its share. Untuned."""
MANY, MANY_GAP = 0.01, 0.02
"""The same of round values, and of codes close to the farthest readings. A wall's readings spread by their
noise. Untuned."""
CUT_OUT = 0.5
"""Share of pixels without a reading from which somebody is cut out of the background. Untuned."""

FAR_M = 13.0
"""Metres: where more than a hundredth is farther, an assumed unit is doubtful (TUM's end at 13.1 m)."""
SHORT_M = 0.8
"""Metres: where nothing is farther, an assumed unit is doubtful: centimetres, or inverse depth. Untuned."""
FLAT = 1.2
"""Times by which the farthest is farther than the nearest in what may be a wall alone. Untuned."""
SMOOTHER = 8
"""Times by which neighbours agree better after a swap of bytes, where bytes are swapped. A swap multiplies
steps of a few units by 256. Untuned."""
ROUGH_M, ROUGH = 0.5, 0.125
"""Metres, and share of the scene's median: neighbours in what is no image differ by more. Untuned."""
MOST_PIXELS = 100_000
"""Pixels of a sample that are looked at. Untuned."""
BYTES = (
    "depth of 8 bits has no known unit; store 16-bit integers in millimetres, or give the millimetres of a "
    "step with --depth-unit"
)
JUDGED = "depth:"
"""First word of the judge's note."""
SAMPLES = 5
"""Frames of a source that are looked at, spread over all of it. Untuned."""


@dataclass(frozen=True)
class DepthReading:
    """Rule by which the numbers of a source's depth images are read.

    unit_mm: millimetres of a step. invalid: codes that are no reading besides 0, negative and non-finite
    ones. swapped: whether the two bytes of a word are. range_m: of the samples, None where they hold too
    little. notes: what was assumed and what is doubtful, one sentence each.
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
    the unit that is taken where the assumed one is impossible, because files of this kind have it. where:
    names the source in messages. Raises FormatError where the images are no depth, or the assumed unit gives
    an impossible scene.
    """
    images = [_thinned(np.asarray(sample)) for sample in samples if np.size(sample)]
    kind = images[0].dtype if images else np.dtype(np.uint16)
    if kind.itemsize == 1 and unit_mm is None:
        raise FormatError(f"{where}: {BYTES}")
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
            f"{where}: no depth within 65 m with {unit:g} mm a step (range {found}); {remedy(values, unit)}"
        )
    source = "assumed" if unit_mm is None else "declared"
    first = (
        f"{JUDGED} {unit:g} mm a step ({source}), {found} at the 1st, 50th and 99th percentile; "
        f"no reading: {1 - len(values) / total:.1%} of the pixels"
    )
    doubts = _doubts(found, words, unit, assumed=unit_mm is None)
    turned = ["bytes of the depth words are swapped: read the other way round"] if swapped else []
    doubts += upside_down(words, invalid, unit)
    lines = (first, *turned, *_seen_codes(words, invalid), *notes, *doubts)
    return DepthReading(unit, invalid, swapped, found, lines)


def _thinned(image: Image) -> Image:
    """Return every n-th row of an image: neighbours along rows stay neighbours."""
    return image[:: max(1, image.size // MOST_PIXELS)] if image.ndim == 2 else image


def _valid(image: Image, invalid: tuple[float, ...]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore", over="ignore"):
        values = image.astype(np.float64).ravel()
    return values[np.isfinite(values) & (values > 0) & (values < BEYOND) & ~np.isin(values, invalid)]


def _swapped(images: Sequence[Image]) -> bool:
    """Return whether neighbours agree far better once the bytes of every word are exchanged."""
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
    values = np.concatenate([image.ravel() for image in images]).astype(np.float64)
    values = values[np.isfinite(values) & (values > 0) & (values < BEYOND)]
    values = values[values != SATURATED] if whole else values
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
        f"depth of {code:g} is no reading: {share:.1%} of the pixels"
        for code, share in shares.items()
        if share
    ]


def _doubts(found: Range, images: Sequence[Image], unit_mm: float, *, assumed: bool) -> list[str]:
    """Return the doubts about a scene that is read nevertheless."""
    why = impossible(found)
    if not why and found.median > MEDIAN_M:
        why = f"half of the scene is farther than {metres(found.median)}"
    if not why and assumed and (found.far > FAR_M or found.far < SHORT_M):
        side = "a part of the scene is farther" if found.far > FAR_M else "nothing is farther"
        why = f"{side} than {metres(found.far)}"
    doubts = (
        [f"doubtful depth: {why} with {unit_mm:g} mm a step; give --depth-unit if that is wrong"]
        if why
        else []
    )
    empty = np.mean([np.count_nonzero(image == 0) / image.size for image in images])
    if found.far < FLAT * found.near and empty < CUT_OUT:
        return [
            *doubts,
            f"all depth is from {metres(found.near)} to {metres(found.far)}: a wall, or no depth image",
        ]
    steps = _steps(images)
    step_m = float(np.median(steps)) * unit_mm / 1000 if len(steps) >= LEAST_PIXELS else 0.0
    if step_m > max(ROUGH_M, found.median * ROUGH):
        doubts.append(
            f"doubtful depth: neighbouring pixels differ by {metres(step_m)}: perhaps no depth image"
        )
    return doubts
