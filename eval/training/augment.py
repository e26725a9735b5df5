"""Augmentation of training images: sensor faults, furniture, and errors of extraction, each switchable.

Extraction cuts the person out of the depth image. A crop is depth float32 (h, w) in [0, 1] (0 = no depth, 1 =
2000 mm, `annotate.crop`) and parts uint8 (h, w). One generator draws all: the same seed gives the same image.
About 6 ms a crop. Constants are untuned.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.crop import LEAST_VALUE, MARGIN, window_of
from annotate.parts import PAPER
from annotate.scheme.scheme import BACKGROUND, Scheme
from eval.training.body_targets import JOINTS, move_joints, swap_sides
from eval.training.occluders import add_blanket, add_board, random_shapes, sensor_noise, smooth_noise

MIN_LEFT, MIN_UNCOVERED = 0.6, 0.3  # share of a person's pixels left by occluders and cuts, under a blanket
BLANKETS, BOARDS = 0.3, 0.35  # shares of the images with a blanket, with a board in front of the person
WHOLE, CLEAN = 0.35, 0.2  # shares of the images without occlusion and cuts, without other noise too
FRAMED = 0.7  # share of the others that an image border cuts
BORDERS = (0.6, 0.15, 0.125, 0.125)  # shares that keep the upper, lower, left, right part
LEFT = (0.15, 0.98)  # share of the height or width that a border leaves: head to all but the feet
WIDTHS = (0.85, 1.2)  # factors of a person's width
BEHIND = 0.2  # most depth of an extra behind the person, share of 2000 mm: a seat just left
SMOOTH = 0.2  # share of the images without their sensor's noise, as some drivers filter


@dataclass(frozen=True)
class Augmentation:
    """Switches for the changes to training images; all are on by default.

    mirror: exchange left and right. place: zoom, shift, and move and stretch depth. turn: rotate in the image
    plane. noise: add sensor noise, and flying pixels at silhouettes. holes: remove depth at pixels and
    patches. occluders: put objects in front of the person, or a blanket on the person. cuts: remove parts of
    the person as a failing extraction does. borders: cut the person at an image border. extras: add furniture
    that the extraction keeps by mistake.
    """

    mirror: bool = True
    place: bool = True
    turn: bool = True
    noise: bool = True
    holes: bool = True
    occluders: bool = True
    cuts: bool = True
    borders: bool = True
    extras: bool = True


Image = tuple[Float32, UInt8]
Example = tuple[Float32, UInt8, Float32]
"""Depth (h, w), parts (h, w) and the row of ``eval.training.body_targets``."""


def augment(example: Example, how: Augmentation, rng: np.random.Generator, scheme: Scheme = PAPER) -> Example:
    """Return a randomly changed copy of a crop. scheme: of its parts.

    A removed pixel has depth 0 and is background; an added pixel has depth and is background. After a cut,
    the crop is fitted to the rest of the person, as around a real extraction.
    """
    depth, parts, whole = example
    if not (depth > 0).any():
        return depth.copy(), parts.copy(), whole
    ease = rng.random()
    if ease < WHOLE:
        how = replace(how, occluders=False, cuts=False, borders=False, extras=False)
    if ease < CLEAN:
        how = replace(how, noise=False, holes=False)
    if how.noise and rng.random() < SMOOTH:
        smooth = np.maximum(cv2.medianBlur(depth, 5), LEAST_VALUE)
        depth = np.where(depth > 0, smooth, depth).astype(np.float32)
    depth, parts = _incomplete(depth, parts, how, rng, scheme)
    if how.extras and rng.random() < 0.25:
        depth = _with_extras(depth, rng)
    if how.borders and rng.random() < FRAMED:
        depth, parts = _framed(depth, parts, rng)
    depth, parts, whole = _placed((depth, parts, whole), how, rng, scheme)
    seen = depth > 0
    middle = np.median(depth[seen]) if seen.any() else np.float32(0.5)
    stretch, shift = (rng.uniform(0.9, 1.1), rng.normal(0, 0.02)) if how.place else (1.0, 0.0)
    depth = (depth - middle) * np.float32(stretch) + np.float32(0.5 + shift)
    whole = whole.copy()
    whole[JOINTS][2::3] = (whole[JOINTS][2::3] - middle) * stretch + 0.5 + shift
    if how.noise and rng.random() < 0.7:
        depth += _noise(seen, rng)
    if how.holes and rng.random() < 0.7:
        seen &= ~_holes(seen.shape, rng)
    return (*_masked(seen, depth.clip(LEAST_VALUE, 1), parts), whole)


def _masked(kept: Bool, depth: Float32, parts: UInt8) -> Image:
    return np.where(kept, depth, np.float32(0)), np.where(kept, parts, np.uint8(BACKGROUND))


def _incomplete(
    depth: Float32, parts: UInt8, how: Augmentation, rng: np.random.Generator, scheme: Scheme = PAPER
) -> Image:
    """Return a crop with parts of the person hidden and cut, or unchanged where too little would be left."""
    least, whole = MIN_LEFT, (depth, parts)
    if how.occluders:
        if rng.random() < BLANKETS:
            depth, parts = add_blanket(depth, parts, rng, scheme)
            least = MIN_UNCOVERED
        if rng.random() < BOARDS:
            depth, parts = add_board(depth, parts, rng)
    kept = _uncut(depth > 0, how, rng)
    left = np.count_nonzero(kept & (parts != BACKGROUND))
    if left < max(1, least * np.count_nonzero(whole[1])):
        return whole
    return _masked(kept, depth, parts)


def _uncut(person: Bool, how: Augmentation, rng: np.random.Generator) -> Bool:
    """Return the person's pixels (h, w) that are left by occluders and a failing extraction."""
    from synth.images.view import cut

    kept = person
    if not person.any():
        return person
    if how.occluders and rng.random() < 0.2:
        kept = kept & ~random_shapes(person, int(rng.integers(1, 3)), (3.0, 45.0), rng)
    if how.cuts:
        if rng.random() < 0.3 and kept.any():
            kept = cut(kept, rng)
        if rng.random() < 0.2:
            kept = kept & _warm_enough(person, rng)
        if rng.random() < 0.4:
            kept = kept & _ragged(person, rng)
    return kept


def _warm_enough(person: Bool, rng: np.random.Generator) -> Bool:
    """Return the person's pixels (h, w) without random cold patches, which cover up to 30 % of the person.

    Patches stand for wet or thick clothes and cold limbs.
    """
    warmth = smooth_noise(person.shape, int(rng.integers(4, 10)), rng)
    return np.asarray(warmth > np.quantile(warmth[person], rng.uniform(0, 0.3)), np.bool_)


def _ragged(person: Bool, rng: np.random.Generator) -> Bool:
    """Return the person's pixels (h, w) without random pieces of the silhouette, 1 to 5 px wide.

    The pieces stand for the coarser pixels of a thermal camera.
    """
    side = 2 * int(rng.integers(1, 6)) + 1
    inside = cv2.erode(person.astype(np.uint8), np.ones((side, side), np.uint8))
    torn = smooth_noise(person.shape, int(rng.integers(15, 45)), rng) < rng.uniform(-0.7, 0.5)
    return np.asarray((inside > 0) | ~torn, np.bool_)


def _rim(person: Bool) -> Bool:
    return np.asarray(person & (cv2.erode(person.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0), np.bool_)


def _with_extras(depth: Float32, rng: np.random.Generator) -> Float32:
    """Add flat pieces of furniture beside the silhouette, as near as the person or farther."""
    person = depth > 0
    rim = _rim(person)
    result = depth.copy()
    noise, lost = sensor_noise(depth, rng)
    for _ in range(int(rng.integers(1, 4))):
        touching = random_shapes(rim, 1, (4.0, 30.0), rng)
        shared = depth[touching & person]
        slope = rng.normal(0, 0.002, 2)
        v, u = np.nonzero(touching & ~person & ~lost)
        if not len(v):
            continue
        away = rng.uniform(0, BEHIND) if rng.random() < 0.5 else rng.normal(0, 0.01)
        plane = np.median(shared) + away + (v - v.mean()) * slope[0] + (u - u.mean()) * slope[1]
        result[v, u] = (plane + noise[v, u]).clip(LEAST_VALUE, 1)
    return result


def _framed(depth: Float32, parts: UInt8, rng: np.random.Generator) -> Image:
    """Cut a person at an image border, unless less than a tenth would be left."""
    rows, columns = window_of(depth > 0)
    kept, share = np.zeros(depth.shape, np.bool_), rng.uniform(*LEFT)
    height, width = (round(share * (own.stop - own.start)) for own in (rows, columns))
    sides = (
        np.s_[: rows.start + height],
        np.s_[rows.stop - height :],
        np.s_[:, : columns.start + width],
        np.s_[:, columns.stop - width :],
    )
    kept[sides[int(rng.choice(4, p=BORDERS))]] = True
    if np.count_nonzero(parts[kept]) < 0.1 * np.count_nonzero(parts):
        return depth, parts
    return _masked(kept, depth, parts)


def _placed(example: Example, how: Augmentation, rng: np.random.Generator, scheme: Scheme) -> Example:
    """Mirror, rotate and stretch a crop, and fit its square roughly to the person, in one resampling."""
    depth, parts, whole = example
    size = depth.shape[0]
    mirror = -1.0 if how.mirror and rng.random() < 0.5 else 1.0
    turn = rng.normal(0, np.radians(8)) if how.turn else 0.0
    zoom, shift = (rng.uniform(0.92, 1.12), rng.uniform(-0.04, 0.04, 2)) if how.place else (1.0, np.zeros(2))
    width = rng.uniform(*WIDTHS) if how.place else 1.0
    c, s = np.cos(turn), np.sin(turn)
    source_from_crop = np.array([[c, -s], [s, c]]) @ np.diag([mirror / width, 1.0])
    at = np.argwhere(depth > 0)[:, ::-1] @ np.linalg.inv(source_from_crop).T
    low, high = at.min(axis=0), at.max(axis=0) + 1
    side = (high - low).max() * (1 + 2 * MARGIN) * zoom
    centre = source_from_crop @ ((low + high - 1) / 2 + shift * side)
    linear = source_from_crop * side / size
    matrix = np.column_stack([linear, centre - linear @ np.full(2, (size - 1) / 2)])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    placed = np.asarray(cv2.warpAffine(parts, matrix, (size, size), flags=flags), np.uint8)
    there = move_joints(whole, np.asarray(cv2.invertAffineTransform(matrix)), size)
    return (
        np.asarray(cv2.warpAffine(depth, matrix, (size, size), flags=flags), np.float32),
        scheme.swap_left_right(placed) if mirror < 0 else placed,
        swap_sides(there) if mirror < 0 else there,
    )


def _noise(seen: Bool, rng: np.random.Generator) -> Float32:
    """Return depth noise (h, w) to add to a crop, in its units (1 = 2000 mm).

    The noise is the sum of pixel noise, smooth noise of up to 6 mm, and flying pixels at the silhouette.
    """
    sigma, wave = rng.uniform(0, 0.003, 2)
    noise = rng.standard_normal(seen.shape, np.float32) * np.float32(sigma)
    noise += smooth_noise(seen.shape, int(rng.integers(6, 20)), rng) * np.float32(wave)
    rim = np.flatnonzero(_rim(seen))
    flying = rim[rng.random(len(rim)) < rng.uniform(0, 0.3)]
    noise.ravel()[flying] += rng.exponential(0.03, len(flying)).astype(np.float32)
    return noise


def _holes(shape: tuple[int, ...], rng: np.random.Generator) -> Bool:
    """Return a mask (h, w) of lost pixels: up to 4 % single pixels, and small patches in half of the
    draws.
    """
    holes = rng.random(shape, np.float32) < rng.uniform(0, 0.04)
    if rng.random() < 0.5:
        holes |= smooth_noise(shape, int(rng.integers(10, 30)), rng) > rng.uniform(1.3, 2.2)
    return np.asarray(holes, np.bool_)
