"""What is known of the supervoxels on and around a person once their suit has been read: rows of numbers.

The rows are those of the supervoxels that ``annotate.person.worn`` compared, the person's and what lies on
them or beside. Every column is of the order of one.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.labels import FrameLabels
from annotate.parts import BODY_PARTS, UNDEFINED
from annotate.person.extract import Undecided
from annotate.person.likeness import STRIDE, share
from annotate.person.planes import normals_at
from annotate.person.worn import by_room
from annotate.segmentation.bare import bareness
from annotate.segmentation.earlier import earlier_parts
from annotate.segmentation.part_tree import REACH_M, middle_of
from annotate.segmentation.reading import Reading
from annotate.segmentation.segment import Segmentation
from annotate.suit.color_model import readable
from annotate.supervoxels import Supervoxels
from sensors.nearest import Nearest

_N = len(BODY_PARTS)
LAYOUT = (
    ("belief", "parts"),
    ("label", "classes"),
    ("colour", "parts"),
    ("distance to each part's middle", "parts"),
    ("visible surface of each part", "parts"),
    ("labels of the frame before", "parts"),
    ("place", "xyz"),
    ("normal", "xyz"),
    ("CIE Lab", "three"),
    ("in the mask", "one"),
    ("confidence", "one"),
    ("bare", "one"),
    ("readable", "one"),
    ("odds", "one"),
    ("odds told by the suit", "one"),
    ("warmth", "one"),
    ("felt", "one"),
    ("points", "one"),
    ("surface", "one"),
    ("neighbours' depth", "three"),
    ("colour's frequency in the room", "one"),
    ("brightness above the room's", "one"),
    ("on somebody before", "one"),
    ("a frame before", "one"),
    ("patch: surface", "one"),
    ("patch: in the mask", "one"),
    ("patch: surface of its colour", "one"),
    ("blur", "one"),
    ("patch: clues", "clues"),
)
"""What the columns are, in order, and of what kind; by the kind it is known what a mirror does to them."""
WIDTHS = {"parts": _N, "classes": _N + 1, "xyz": 3, "three": 3, "one": 1, "clues": 7}
COLUMNS = sum(WIDTHS[kind] for _, kind in LAYOUT)
MOST_ODDS, MOST_CLUE, MOST_STEP_M = 6.0, 8.0, 0.3
STILL_MM = 80
"""Where the depth has changed by less since the frame before, the same thing may be there."""
SURE, LEAST_M2 = 0.5, 0.002
"""Belief, and surface of such supervoxels, from which on it is known where a part is."""
UNSEEN, FARTHEST = 2.0, 4.0
"""Distance to parts that are not seen, and the most, in their reaches."""
NEIGHBOURS, NEAR_M = 6, 0.15
"""So many of the nearest supervoxels are neighbours, no farther away than that: at every second pixel few
touch each other."""

_Array = NDArray[np.float64]


def described(
    cloud: ThermalCloud,
    person: NDArray[np.bool_],
    seen: Undecided,
    first: Segmentation,
    before: FrameLabels | None,
) -> _Array:
    """Descriptors (G, COLUMNS) of the supervoxels of the clues seen, in the order of LAYOUT.

    person: bool (h, w). first: labels as read from a suit. before: the labels of the frame before.
    """
    clues, reading = seen.clues, first.reading
    assert reading is not None
    own, groups = clues.own, clues.groups
    belief = np.zeros((*person.shape, _N), np.float32)
    belief[reading.mask] = reading.belief[reading.groups.ids]
    pixels = np.column_stack([belief[own], *_of_pixels(cloud, person, seen, first)])
    mean = groups.mean(pixels)
    belief, labels, rest = mean[:, :_N], mean[:, _N : 2 * _N + 1], mean[:, 2 * _N + 1 :]
    surface_m2 = _surface_m2(cloud, own, groups)
    centroids_m = groups.centroids_m(cloud.points_m[own])
    inside, felt = rest[:, 6], rest[:, 11]
    on_person = cloud.points_m[person]
    middle_m = np.median(on_person if len(on_person) else cloud.points_m[own], axis=0)
    colour, usable = _colour(cloud.color_rgb[own], reading, groups)
    shown_m2, away = _parts(belief, surface_m2 * inside, centroids_m)
    bare = np.clip(bareness(reading.model, clues.chroma, np.maximum(clues.blur, 0.02)), -8, 8)
    earlier = np.full((groups.count, _N), 1 / _N)
    if has_before := before is not None and before.parts.shape == person.shape:
        assert before is not None
        earlier = earlier_parts(before, cloud.camera, centroids_m)
    patch = clues.patches.ids
    patch_m2 = np.bincount(patch, surface_m2)
    return np.column_stack(
        [
            *(belief, labels, colour, away, np.tile(3 * np.sqrt(shown_m2), (groups.count, 1)), earlier),
            *(centroids_m - middle_m, rest[:, :6], inside, rest[:, 7], bare / 4, usable),
            *(rest[:, 8] / 3, rest[:, 9] / 3, rest[:, 10] / np.maximum(felt, 0.05), felt),
            *(np.log(groups.sizes) / 4, np.log(surface_m2 + 1e-5) / 4, _steps(groups, centroids_m[:, 2])),
            *(rest[:, 12] / 3, rest[:, 13], _still(cloud, own, groups, before if has_before else None)),
            np.full(groups.count, float(has_before)),
            np.log(patch_m2 + 1e-5)[patch] / 3,
            (np.bincount(patch, surface_m2 * inside) / patch_m2)[patch],
            np.log(clues.alike_m2[patch] + 1e-5) / 3,
            *(3 * clues.blur, np.clip(clues.told[patch], -MOST_CLUE, MOST_CLUE) / 4),
        ]
    )


def neighbours(centroids_m: _Array) -> NDArray[np.int32]:
    """Pairs (e, 2) of supervoxels with centroids (G, 3) near each other, each pair once, the lower first."""
    nearest = Nearest(centroids_m.astype(np.float32))
    near = nearest.query(centroids_m, NEIGHBOURS + 1, within=NEAR_M)[1].ravel()
    own = np.repeat(np.arange(len(centroids_m)), NEIGHBOURS + 1)
    found = (near < len(centroids_m)) & (near != own)
    pairs = np.sort(np.column_stack([own[found], near[found]]), axis=1)
    return np.unique(pairs, axis=0).astype(np.int32)


def _of_pixels(
    cloud: ThermalCloud, person: NDArray[np.bool_], seen: Undecided, first: Segmentation
) -> tuple[NDArray[np.generic], ...]:
    """Per pixel compared (n, ...): label, normal, Lab, in the mask, confidence, odds, told, warmth, felt,
    frequency of the colour, brightness."""
    own = seen.clues.own
    part = np.where(first.parts == UNDEFINED, 0, first.parts)[own]
    celsius = cloud.temperature_c[own]
    felt = np.isfinite(celsius)
    warmth = share(celsius, cloud.temperature_c[seen.room], cloud.temperature_c[person])
    rgb = cloud.color_rgb[own][None]
    shade, common = by_room(cloud, own, seen.room)
    return (
        np.eye(_N + 1)[part],
        np.nan_to_num(normals_at(cloud, *np.nonzero(own))),
        np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB))[0] / 128 - 1,
        person[own],
        first.confidence[own],
        seen.clues.odds,
        np.clip(seen.told[own], -MOST_ODDS, MOST_ODDS),
        np.where(felt, warmth, 0),
        felt,
        common,
        shade,
    )


def _surface_m2(cloud: ThermalCloud, own: NDArray[np.bool_], groups: Supervoxels) -> _Array:
    pixel_m2 = STRIDE**2 * cloud.points_m[own][:, 2].astype(np.float64) ** 2
    return np.asarray(np.bincount(groups.ids, pixel_m2 / (cloud.camera.fx * cloud.camera.fy)))


def _colour(rgb: NDArray[np.uint8], reading: Reading, groups: Supervoxels) -> tuple[_Array, _Array]:
    """What the colours (n, 3) say of parts, a mean (G, 11) over the readable ones, and their share (G,)."""
    usable = readable(rgb, np.ones(len(rgb), np.bool_))
    evidence = np.zeros((len(rgb), _N))
    evidence[usable] = reading.model.evidence(rgb[usable])
    share = groups.mean(usable)
    return groups.mean(evidence) / np.maximum(share, 1 / groups.sizes)[:, None], share


def _parts(belief: _Array, surface_m2: _Array, centroids_m: _Array) -> tuple[_Array, _Array]:
    """Surface (11,) of each part that is sure, and distances (G, 11) to their middles in their reaches."""
    surface_m2 = (belief * (belief > SURE)) * surface_m2[:, None]
    away = np.full(belief.shape, UNSEEN)
    for part in np.flatnonzero(surface_m2.sum(axis=0) >= LEAST_M2):
        middle_m = middle_of(surface_m2[:, part], centroids_m, REACH_M[part])
        away_m = np.linalg.norm(centroids_m - middle_m, axis=1)
        away[:, part] = np.minimum(away_m / REACH_M[part], FARTHEST)
    return surface_m2.sum(axis=0), away


def _steps(groups: Supervoxels, z_m: _Array) -> _Array:
    """Depth of the touching supervoxels against one's own (G, 3): mean, the farthest, the nearest."""
    a, b = np.concatenate([groups.edges, groups.edges[:, ::-1]]).T
    step = np.clip(z_m[b] - z_m[a], -MOST_STEP_M, MOST_STEP_M)
    farthest, nearest = np.zeros((2, groups.count))
    np.maximum.at(farthest, a, step)
    np.minimum.at(nearest, a, step)
    mean = np.bincount(a, step, groups.count) / np.maximum(np.bincount(a, minlength=groups.count), 1)
    return np.column_stack([10 * mean, 5 * farthest, 5 * nearest])


def _still(
    cloud: ThermalCloud, own: NDArray[np.bool_], groups: Supervoxels, before: FrameLabels | None
) -> _Array:
    """Share (G,) of the pixels that were on somebody before and are as far away as then."""
    if before is None:
        return np.zeros(groups.count)
    still = np.abs(before.depth_mm.astype(np.int32) - cloud.depth_mm) < STILL_MM
    return groups.mean((still & (before.parts > 0) & (before.parts < UNDEFINED))[own])
