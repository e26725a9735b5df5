"""What is known of the supervoxels on and around a person once their suit has been read: rows of numbers.

The rows are those of the supervoxels that ``annotate.person.clothed_mask`` compared, the person's and what
lies on them or beside. Every column is of the order of one.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, Int32, UInt8
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS, UNDEFINED
from annotate.person.clothed_mask import Clues, by_room
from annotate.person.extract import Undecided
from annotate.person.patch_likelihoods import STRIDE, share
from annotate.person.planes import normals_at
from annotate.segmentation.bare import bareness
from annotate.segmentation.part_tree import REACH_M, middle_of
from annotate.segmentation.previous_parts import earlier_parts
from annotate.segmentation.reading import Reading
from annotate.segmentation.segment import Segmentation
from annotate.suit.color_model import readable
from sensors.rig.nearest import Nearest

_N = len(BODY_PARTS)
LAYOUT = {
    "belief": "parts",
    "label": "classes",
    "colour": "parts",
    "distance": "parts",
    "shown": "parts",
    "earlier": "parts",
    "place": "xyz",
    "normal": "xyz",
    "lab": "three",
    "inside": "one",
    "confidence": "one",
    "bare": "one",
    "readable": "one",
    "odds": "one",
    "told": "one",
    "warmth": "one",
    "felt": "one",
    "points": "one",
    "surface": "one",
    "steps": "three",
    "frequency": "one",
    "brightness": "one",
    "still": "one",
    "has before": "one",
    "patch surface": "one",
    "patch inside": "one",
    "alike": "one",
    "blur": "one",
    "clues": "clues",
}
"""What the columns are, in order, and of what kind; by the kind it is known what a mirror does to them.

belief, label: of the first look. colour: log likelihood by the suit's colours. distance: to each part's
middle, in its reaches. shown: root of each part's visible surface. earlier: parts of the frame before.
place: metres from the person's median. lab: CIE, about -1 to 1. inside: share in the mask. bare: log
odds of skin or shoe. odds, told: log odds of the person without and with the suit. warmth: share of the
way from the room to the person. points, surface, patch surface, alike (of the patch's colour):
logarithms. steps: depth of what touches it, the mean, farthest, nearest. frequency, brightness: of the
colour in the room, logarithms. still: share that was on somebody before and has not moved. clues: of
``annotate.person.clothed_mask``."""
WIDTHS = {"parts": _N, "classes": _N + 1, "xyz": 3, "three": 3, "one": 1, "clues": 7}
COLUMNS = sum(WIDTHS[kind] for kind in LAYOUT.values())
MOST_ODDS, MOST_CLUE, MOST_BARE, MOST_STEP_M, LEAST_FELT = 6.0, 8.0, 8.0, 0.3, 0.05
LEAST_BLUR, SPECK_M2 = 0.02, 1e-5
STILL_MM = 80
"""Where the depth has changed by less since the frame before, the same thing may be there."""
SURE, LEAST_M2 = 0.5, 0.002
"""Belief, and surface of such supervoxels, from which on it is known where a part is."""
UNSEEN, FARTHEST = 2.0, 4.0
"""Distance to parts that are not seen, and the most, in their reaches."""
NEIGHBOURS, NEAR_M = 6, 0.15
"""So many of the nearest supervoxels are neighbours, no farther away than that: at every second pixel few
touch each other."""

_Columns = dict[str, Float64]


def described(
    cloud: ThermalCloud, person: Bool, seen: Undecided, first: Segmentation, before: FrameLabels | None
) -> Float64:
    """Descriptors (G, COLUMNS) of the supervoxels of the clues seen, in the order of LAYOUT.

    person: bool (h, w). first: labels as read from a suit. before: the labels of the frame before.
    """
    if before is not None and before.parts.shape != person.shape:
        before = None
    pixels = _of_pixels(cloud, person, seen, first, before)
    known: _Columns = {name: seen.clues.groups.mean(values) for name, values in pixels.items()}
    known["warmth"] = known["warmth"] / np.maximum(known["felt"], LEAST_FELT)
    known |= _of_patches(cloud, seen, known["inside"])
    known |= _of_supervoxels(cloud, person, seen, first, before, known)
    return np.column_stack([known[name] for name in LAYOUT])


def _of_pixels(
    cloud: ThermalCloud, person: Bool, seen: Undecided, first: Segmentation, before: FrameLabels | None
) -> dict[str, NDArray[np.generic]]:
    """What is known of each pixel compared (n, ...)."""
    own, reading = seen.clues.own, first.reading
    assert reading is not None
    belief = np.zeros((*person.shape, _N), np.float32)
    belief[reading.mask] = reading.belief[reading.groups.ids]
    celsius, rgb = cloud.temperature_c[own], cloud.color_rgb[own]
    warmth = share(celsius, cloud.temperature_c[seen.room], cloud.temperature_c[person])
    brightness, frequency = by_room(cloud, own, seen.room)
    return {
        "belief": belief[own],
        "label": np.eye(_N + 1)[np.where(first.parts == UNDEFINED, 0, first.parts)[own]],
        "normal": np.nan_to_num(normals_at(cloud, *np.nonzero(own))),
        "lab": np.asarray(cv2.cvtColor(rgb[None], cv2.COLOR_RGB2LAB))[0] / 128 - 1,
        "inside": person[own],
        "confidence": first.confidence[own],
        "odds": seen.clues.odds,
        "told": np.clip(seen.told[own], -MOST_ODDS, MOST_ODDS),
        "warmth": np.where(np.isfinite(celsius), warmth, 0),
        "felt": np.isfinite(celsius),
        "frequency": frequency,
        "brightness": brightness,
        "still": _still(cloud, own, before),
    }


def _still(cloud: ThermalCloud, own: Bool, before: FrameLabels | None) -> Bool:
    """Which of the pixels (n,) were on somebody before and are as far away as then."""
    if before is None:
        return np.zeros(np.count_nonzero(own), np.bool_)
    still = np.abs(before.depth_mm.astype(np.int32) - cloud.depth_mm) < STILL_MM
    return np.asarray((still & (before.parts > 0) & (before.parts < UNDEFINED))[own])


def _of_patches(cloud: ThermalCloud, seen: Undecided, inside: Float64) -> _Columns:
    """What is known of the patch that each supervoxel is of (G, ...), and its own surface."""
    clues = seen.clues
    patch, surface_m2 = clues.patches.ids, _surface_m2(cloud, clues)
    patch_m2 = np.bincount(patch, surface_m2)
    return {
        "surface": np.log(surface_m2 + SPECK_M2),
        "patch surface": np.log(patch_m2 + SPECK_M2)[patch],
        "patch inside": (np.bincount(patch, surface_m2 * inside) / patch_m2)[patch],
        "alike": np.log(clues.alike_m2 + SPECK_M2)[patch],
        "clues": np.clip(clues.told, -MOST_CLUE, MOST_CLUE)[patch],
    }


def _of_supervoxels(
    cloud: ThermalCloud,
    person: Bool,
    seen: Undecided,
    first: Segmentation,
    before: FrameLabels | None,
    means: _Columns,
) -> _Columns:
    """What is known of each supervoxel as a whole (G, ...); means: of its pixels."""
    clues, groups, reading = seen.clues, seen.clues.groups, first.reading
    assert reading is not None
    centroids_m = groups.centroids_m(cloud.points_m[clues.own])
    on_person_m = cloud.points_m[person if person.any() else clues.own]
    colour, usable = _colour(cloud.color_rgb[clues.own], reading, groups)
    shown_m2, distance = _parts(means["belief"], _surface_m2(cloud, clues) * means["inside"], centroids_m)
    bare = bareness(reading.model, clues.chroma, np.maximum(clues.blur, LEAST_BLUR))
    if before is None:
        earlier = np.full((groups.count, _N), 1 / _N)
    else:
        earlier = earlier_parts(before, cloud.camera, centroids_m)
    return {
        "colour": colour,
        "distance": distance,
        "shown": np.tile(np.sqrt(shown_m2), (groups.count, 1)),
        "earlier": earlier,
        "place": centroids_m - np.median(on_person_m, axis=0),
        "bare": np.clip(bare, -MOST_BARE, MOST_BARE),
        "readable": usable,
        "points": np.log(groups.sizes),
        "steps": _steps(groups, centroids_m[:, 2]),
        "has before": np.full(groups.count, before is not None),
        "blur": clues.blur,
    }


def neighbours(centroids_m: Float64) -> Int32:
    """Pairs (e, 2) of supervoxels with centroids (G, 3) near each other, each pair once, the lower first."""
    nearest = Nearest(centroids_m.astype(np.float32))
    near = nearest.query(centroids_m, NEIGHBOURS + 1, within=NEAR_M)[1].ravel()
    own = np.repeat(np.arange(len(centroids_m)), NEIGHBOURS + 1)
    found = (near < len(centroids_m)) & (near != own)
    pairs = np.sort(np.column_stack([own[found], near[found]]), axis=1)
    return np.unique(pairs, axis=0).astype(np.int32)


def _surface_m2(cloud: ThermalCloud, clues: Clues) -> Float64:
    """Visible surface (G,) of each supervoxel."""
    z_m = cloud.points_m[clues.own][:, 2].astype(np.float64)
    pixels_m2 = (STRIDE * z_m) ** 2 / (cloud.camera.fx * cloud.camera.fy)
    return np.asarray(np.bincount(clues.groups.ids, pixels_m2))


def _colour(rgb: UInt8, reading: Reading, groups: Supervoxels) -> tuple[Float64, Float64]:
    """What the colours (n, 3) say of parts, a mean (G, 11) over the readable ones, and their share (G,)."""
    usable = readable(rgb, np.ones(len(rgb), np.bool_))
    evidence = np.zeros((len(rgb), _N))
    evidence[usable] = reading.model.evidence(rgb[usable])
    share = groups.mean(usable)
    return groups.mean(evidence) / np.maximum(share, 1 / groups.sizes)[:, None], share


def _parts(belief: Float64, surface_m2: Float64, centroids_m: Float64) -> tuple[Float64, Float64]:
    """Surface (11,) of each part that is sure, and distances (G, 11) to their middles in their reaches."""
    surface_m2 = (belief * (belief > SURE)) * surface_m2[:, None]
    away = np.full(belief.shape, UNSEEN)
    for part in np.flatnonzero(surface_m2.sum(axis=0) >= LEAST_M2):
        middle_m = middle_of(surface_m2[:, part], centroids_m, REACH_M[part])
        away_m = np.linalg.norm(centroids_m - middle_m, axis=1)
        away[:, part] = np.minimum(away_m / REACH_M[part], FARTHEST)
    return surface_m2.sum(axis=0), away


def _steps(groups: Supervoxels, z_m: Float64) -> Float64:
    """Depth of the touching supervoxels against one's own (G, 3): mean, the farthest, the nearest."""
    a, b = np.concatenate([groups.edges, groups.edges[:, ::-1]]).T
    step = np.clip(z_m[b] - z_m[a], -MOST_STEP_M, MOST_STEP_M)
    farthest, nearest = np.zeros((2, groups.count))
    np.maximum.at(farthest, a, step)
    np.minimum.at(nearest, a, step)
    mean = np.bincount(a, step, groups.count) / np.maximum(np.bincount(a, minlength=groups.count), 1)
    return np.column_stack([mean, farthest, nearest])
