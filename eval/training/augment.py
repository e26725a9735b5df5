"""Augmentation: training images with the faults of sensors, furniture and extractions, each switchable.

A crop is depth float32 (h, w) in [0, 1] (0 = nothing, 1 = 2000 mm, `annotate.crop`) and parts uint8 (h, w).
All is drawn from one generator: the same seed gives the same image. About 6 ms a crop.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.crop import LEAST_VALUE, MARGIN, window_of
from annotate.parts import BACKGROUND, swap_left_right
from eval.training.body_targets import JOINTS, mirrored, moved
from eval.training.occluders import boarded, draped, field, noise_of, things

MIN_LEFT, MIN_UNCOVERED = 0.6, 0.3
"""Share of a person's pixels that occluders and cuts leave together, and a blanket with them; a worse draw is
not used; chosen by eye."""
BLANKETS, BOARDS = 0.3, 0.35
"""Shares of the images with a blanket and with a board before the person. A network that has never seen
feet apart from a trunk exchanges them, and gives parts to what lies on a person; chosen by eye."""
WHOLE, CLEAN = 0.35, 0.2
"""Shares of the images that nothing hides or cuts, and of those that have no other noise than their sensor's;
chosen by eye."""
FRAMED, BORDERS = 0.7, (0.6, 0.15, 0.125, 0.125)
"""Share of the others that a border cuts, and the shares in which their upper, lower, left and right part is
left; chosen by eye."""
LEFT = (0.15, 0.98)
"""Range of the shares of a person's height or width that a border leaves, from a head with shoulders to all
but the feet: a network that never saw legs without feet takes shins for thighs; chosen by eye."""
WIDTHS = (0.85, 1.2)
"""Range of the factors of a person's width; chosen by eye."""
BEHIND = 0.2
"""How far behind a person furniture stands that an extraction leaves with them, at most, as a share of the
crop's 2000 mm: the seat that somebody has just risen from; chosen by eye."""
SMOOTH = 0.2
"""Share of the images without their sensor's own noise: drivers filter more or less; chosen by eye."""


@dataclass(frozen=True)
class Augmentation:
    """Changes to training images; all by default.

    mirror: left and right exchanged. place: zoom, shift, depth moved and stretched. turn: in the image plane.
    noise: of the sensor, flying pixels at rims. holes: pixels and patches without depth. occluders: things in
    front of the person, blankets over them. cuts: what a failing extraction takes away. borders:
    of the image, which leave a part of the person. extras: what the extraction takes too much.
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


Example = tuple[Float32, UInt8, Float32]
"""Depth (h, w), parts (h, w) and the row of ``eval.training.body_targets``."""


def augment(example: Example, how: Augmentation, rng: np.random.Generator) -> Example:
    """A harder copy of a crop. What is taken away has depth 0 and is background; so are things, with depth.

    After a cut the crop is fitted anew to what is left, as it would be around a real extraction. A third of
    the images keep all of the person, more than half of these all of their sensor too.
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
    depth, parts = _incomplete(depth, parts, how, rng)
    if how.extras and rng.random() < 0.25:
        depth = _with_extras(depth, rng)
    if how.borders and rng.random() < FRAMED:
        depth, parts = _framed(depth, parts, rng)
    depth, parts, whole = _placed((depth, parts, whole), how, rng)
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
    return (
        np.where(seen, depth.clip(LEAST_VALUE, 1), np.float32(0)),
        np.where(seen, parts, np.uint8(BACKGROUND)),
        whole,
    )


def _incomplete(
    depth: Float32, parts: UInt8, how: Augmentation, rng: np.random.Generator
) -> tuple[Float32, UInt8]:
    """Hidden by things and cut by the extraction; as it was where too little would be left."""
    least, whole = MIN_LEFT, (depth, parts)
    if how.occluders:
        if rng.random() < BLANKETS:
            depth, parts = draped(depth, parts, rng)
            least = MIN_UNCOVERED
        if rng.random() < BOARDS:
            depth, parts = boarded(depth, parts, rng)
    kept = _taken_away(depth > 0, how, rng)
    left = np.count_nonzero(kept & (parts != BACKGROUND))
    if left < max(1, least * np.count_nonzero(whole[1])):
        return whole
    return np.where(kept, depth, np.float32(0)), np.where(kept, parts, np.uint8(BACKGROUND))


def _taken_away(person: Bool, how: Augmentation, rng: np.random.Generator) -> Bool:
    from synth.images.view import cut

    kept = person
    if not person.any():
        return person
    if how.occluders and rng.random() < 0.2:
        kept = kept & ~things(person, int(rng.integers(1, 3)), (3.0, 45.0), rng)
    if how.cuts:
        if rng.random() < 0.3 and kept.any():
            kept = cut(kept, rng)
        if rng.random() < 0.2:
            kept = kept & _warm_enough(person, rng)
        if rng.random() < 0.4:
            kept = kept & _ragged(person, rng)
    return kept


def _warm_enough(person: Bool, rng: np.random.Generator) -> Bool:
    """All but the coldest patches, up to 30 % of the person: wet or thick clothes, cold limbs."""
    warmth = field(person.shape, int(rng.integers(4, 10)), rng)
    return np.asarray(warmth > np.quantile(warmth[person], rng.uniform(0, 0.3)), np.bool_)


def _ragged(person: Bool, rng: np.random.Generator) -> Bool:
    """All but bits of the rim, 1 to 5 pixels wide: a thermal camera is coarser than the depth camera."""
    side = 2 * int(rng.integers(1, 6)) + 1
    inside = cv2.erode(person.astype(np.uint8), np.ones((side, side), np.uint8))
    torn = field(person.shape, int(rng.integers(15, 45)), rng) < rng.uniform(-0.7, 0.5)
    return (inside > 0) | ~torn


def _with_extras(depth: Float32, rng: np.random.Generator) -> Float32:
    """Flat bits of furniture stuck to the silhouette, at the depth where they touch it or behind."""
    person = depth > 0
    rim = person & (cv2.erode(person.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    result = depth.copy()
    noise, lost = noise_of(depth, rng)
    for _ in range(int(rng.integers(1, 4))):
        touching = things(rim, 1, (4.0, 30.0), rng)
        shared = depth[touching & person]
        slope = rng.normal(0, 0.002, 2)
        v, u = np.nonzero(touching & ~person & ~lost)
        if not len(v):
            continue
        away = rng.uniform(0, BEHIND) if rng.random() < 0.5 else rng.normal(0, 0.01)
        plane = np.median(shared) + away + (v - v.mean()) * slope[0] + (u - u.mean()) * slope[1]
        result[v, u] = (plane + noise[v, u]).clip(LEAST_VALUE, 1)
    return result


def _framed(depth: Float32, parts: UInt8, rng: np.random.Generator) -> tuple[Float32, UInt8]:
    """What an image's border leaves of a person: mostly the upper part, else the lower or one side.

    All of them where less than a tenth would be left.
    """
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
    return np.where(kept, depth, np.float32(0)), np.where(kept, parts, np.uint8(BACKGROUND))


def _placed(example: Example, how: Augmentation, rng: np.random.Generator) -> Example:
    """Mirror, turn, make wider or narrower, and cut out the square around what is there, nearly.

    One resampling for all of them.
    """
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
    there = moved(whole, np.asarray(cv2.invertAffineTransform(matrix)), size)
    return (
        np.asarray(cv2.warpAffine(depth, matrix, (size, size), flags=flags), np.float32),
        swap_left_right(placed) if mirror < 0 else placed,
        mirrored(there) if mirror < 0 else there,
    )


def _noise(seen: Bool, rng: np.random.Generator) -> Float32:
    """Pixel noise and slow waves of up to 6 mm, and flying pixels at the rim, in the crop's units."""
    sigma, wave = rng.uniform(0, 0.003, 2)
    noise = rng.standard_normal(seen.shape, np.float32) * np.float32(sigma)
    noise += field(seen.shape, int(rng.integers(6, 20)), rng) * np.float32(wave)
    rim = np.flatnonzero(seen & (cv2.erode(seen.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0))
    flying = rim[rng.random(len(rim)) < rng.uniform(0, 0.3)]
    noise.ravel()[flying] += rng.exponential(0.03, len(flying)).astype(np.float32)
    return noise


def _holes(shape: tuple[int, ...], rng: np.random.Generator) -> Bool:
    """Single pixels, up to 4 % of them, and small patches."""
    holes = rng.random(shape, np.float32) < rng.uniform(0, 0.04)
    if rng.random() < 0.5:
        patches = field(shape, int(rng.integers(10, 30)), rng) > rng.uniform(1.3, 2.2)
        holes |= patches
    return np.asarray(holes, np.bool_)
