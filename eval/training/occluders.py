"""Blankets and boards on a person that remain by mistake when the person is cut out of the image.

An occluder has depth in front of the hidden pixels and the label background. Crops are as in
`eval.training.augment`. Constants are untuned.
"""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int64, UInt8
from annotate.crop import LEAST_VALUE, nearest_seen
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from annotate.scheme.scheme import BACKGROUND, Scheme

TRUNK = (
    *(Region.CHEST, Region.BELLY, Region.LOWER_BELLY),
    *(Region.LEFT_SHOULDER, Region.RIGHT_SHOULDER),
)
LEGS = (
    *(Region.LEFT_LOWER_LEG, Region.LEFT_FOOT, Region.LEFT_TOES),
    *(Region.RIGHT_LOWER_LEG, Region.RIGHT_FOOT, Region.RIGHT_TOES),
)
"""Regions of the trunk, and of the lower legs and feet: a blanket lies between them."""
UNDER = (*TRUNK, Region.HIP, Region.LEFT_UPPER_LEG, Region.RIGHT_UPPER_LEG, *LEGS)
"""Regions of trunk and legs, which carry a blanket."""
UNSEEN = 0.4  # share of the blankets that hide the person and have no depth
ROUGH = 0.006  # of 2000 mm: a larger step between neighbours is a border, not noise
THICK = (0.005, 0.03)  # of 2000 mm: distance of a blanket in front of the nearest point under it


def smooth_noise(shape: tuple[int, ...], cells: int, rng: np.random.Generator) -> Float32:
    """Return smooth noise (h, w) of about unit standard deviation, with ``cells`` bumps across."""
    coarse = rng.standard_normal((cells, cells), np.float32)
    return np.asarray(cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC), np.float32)


def random_shapes(person: Bool, count: int, half_px: tuple[float, float], rng: np.random.Generator) -> Bool:
    """Return a mask (h, w) of ``count`` boxes and ellipses centred on random pixels of the person.

    half_px: least and greatest half side in pixels.
    """
    canvas = np.zeros(person.shape, np.uint8)
    v, u = np.nonzero(person)
    for _ in range(count):
        i = int(rng.integers(len(v)))
        half = np.exp(rng.uniform(np.log(half_px[0]), np.log(half_px[1]), 2))
        turn = float(rng.uniform(0, 180))
        centre = (float(u[i]), float(v[i]))
        if rng.random() < 0.5:
            cv2.ellipse(canvas, (centre, tuple(2 * half), turn), 1, cv2.FILLED)
        else:
            cv2.fillPoly(canvas, [cv2.boxPoints((centre, tuple(2 * half), turn)).astype(np.int32)], 1)
    return canvas > 0


def blanket_band(parts: UInt8, rng: np.random.Generator, scheme: Scheme = PAPER) -> Bool:
    """Return a mask (h, w) from about the hip to the shins or beyond the feet; empty without legs."""
    trunk, legs = (np.argwhere(np.isin(parts, scheme.ids_of(regions))) for regions in (TRUNK, LEGS))
    if not len(trunk) or not len(legs):
        return np.zeros(parts.shape, np.bool_)
    start, axis = trunk.mean(axis=0), legs.mean(axis=0) - trunk.mean(axis=0)
    rows, columns = np.ogrid[: parts.shape[0], : parts.shape[1]]
    along = ((rows - start[0]) * axis[0] + (columns - start[1]) * axis[1]) / max(float(axis @ axis), 1.0)
    along += 0.06 * smooth_noise(parts.shape, int(rng.integers(3, 10)), rng)
    begin = rng.uniform(0.2, 0.7)
    return np.asarray((along > begin) & (along < begin + rng.uniform(0.3, 0.9)), np.bool_)


def add_blanket(
    depth: Float32, parts: UInt8, rng: np.random.Generator, scheme: Scheme = PAPER
) -> tuple[Float32, UInt8]:
    """Return a crop with a folded blanket over the person from the trunk down.

    The blanket spans between the legs and hangs beyond. Patches or all of it have no depth, as where an
    extraction removes it.
    """
    under = (depth > 0) & np.isin(parts, scheme.ids_of(UNDER))
    band = blanket_band(parts, rng, scheme)
    if not (under & band).any():
        return depth, parts
    closed = cv2.morphologyEx(under.astype(np.uint8), cv2.MORPH_CLOSE, _disc(rng.integers(5, 30, 2)))
    wide = cv2.dilate(closed, _disc(rng.integers(1, 22, 2)))
    cells = int(rng.integers(4, 12))
    soft = cv2.GaussianBlur(wide.astype(np.float32), (0, 0), 2)
    hanging = soft + 0.2 * smooth_noise(parts.shape, cells, rng) > 0.5
    # The nearest surface around carries the cloth; min filter and blur are its span and its stiffness.
    nearest = cv2.erode(np.where(under, depth, np.float32(1)), _disc(rng.integers(3, 20, 2)))
    carried = np.asarray(nearest, np.float32)
    spread = carried.ravel()[nearest_seen(carried < 1)]
    surface = cv2.GaussianBlur(spread, (0, 0), float(rng.uniform(1.5, 6))) - np.float32(rng.uniform(*THICK))
    surface += _folds(parts.shape, rng)
    kept = smooth_noise(parts.shape, cells, rng) > (np.inf if rng.random() < UNSEEN else rng.uniform(-3, 0.5))
    return _in_front((depth, parts), np.where(band & hanging, surface, np.float32(np.inf)), kept, rng)


def add_board(depth: Float32, parts: UInt8, rng: np.random.Generator) -> tuple[Float32, UInt8]:
    """Return a crop with a flat board or disc in front: a screen on the lap, a cushion, a tray, a table's
    edge.
    """
    person = depth > 0
    if not person.any():
        return depth, parts
    where = random_shapes(person, 1, (6.0, 40.0), rng)
    hidden = depth[where & person]
    if not hidden.size:
        return depth, parts
    rows, columns = np.ogrid[: parts.shape[0], : parts.shape[1]]
    v, u = np.nonzero(where)
    slope = rng.normal(0, 0.0025, 2)
    plane = (rows - v.mean()) * slope[0] + (columns - u.mean()) * slope[1]
    plane = plane + 0.003 * smooth_noise(parts.shape, 6, rng)
    # Just in front of the nearest hidden pixel, or up to some centimetres away from it.
    gap = np.quantile(hidden - plane[where & person], 0.1) - rng.exponential(0.03)
    surface = np.where(where, (plane + gap).astype(np.float32), np.float32(np.inf))
    return _in_front((depth, parts), surface, where, rng)


def _in_front(
    crop: tuple[Float32, UInt8], surface: Float32, kept: Bool, rng: np.random.Generator
) -> tuple[Float32, UInt8]:
    """Return a crop with a surface (h, w) in front of it; the surface is infinite outside its outline.

    kept: bool (h, w); other pixels of the surface have no depth.
    """
    depth, parts = crop
    seen = np.isfinite(surface) & ((depth == 0) | (surface < depth))
    noise, lost = sensor_noise(depth, rng)
    there = np.where(kept & ~lost, (surface + noise).clip(LEAST_VALUE, 1), np.float32(0))
    return np.where(seen, there, depth).astype(np.float32), np.where(seen, np.uint8(BACKGROUND), parts)


def sensor_noise(depth: Float32, rng: np.random.Generator) -> tuple[Float32, Bool]:
    """Return noise and lost pixels (h, w) like the person's, because smooth occluders could be detected."""
    person = (depth > 0).astype(np.uint8)
    inner = cv2.erode(person, np.ones((3, 3), np.uint8)) > 0
    closed = cv2.erode(cv2.morphologyEx(person, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)), np.ones((5, 5)))
    rough = (depth - cv2.medianBlur(depth, 3))[inner].clip(-ROUGH, ROUGH)
    noise = rng.choice(rough, depth.shape) if rough.size else np.zeros_like(depth)
    lost = 1 - float(person[closed > 0].mean()) if closed.any() else 0.0
    return noise.astype(np.float32), np.asarray(rng.random(depth.shape, np.float32) < lost, np.bool_)


def _folds(shape: tuple[int, ...], rng: np.random.Generator) -> Float32:
    """Return waves (h, w) of depth, up to 15 mm, long in one direction."""
    long, short = int(rng.integers(2, 5)), int(rng.integers(5, 16))
    coarse = rng.standard_normal((long, short), np.float32)
    waves = cv2.resize(coarse if rng.random() < 0.7 else coarse.T, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(waves * np.float32(rng.uniform(0, 0.0075)), np.float32)


def _disc(radii: Int64) -> UInt8:
    width, height = (2 * int(r) + 1 for r in radii)
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, height)), np.uint8)
