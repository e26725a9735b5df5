"""Descriptors (G, DESCRIPTOR_WIDTH) of the supervoxels on and around a person, once the suit has been read.

The supervoxels are those of ``annotate.person.clothed_mask``: the person's and those on them or beside. Every
column is of the order of one.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, Int32, UInt8
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS, UNDEFINED
from annotate.person.clothed_mask import MOST_PERSON_ODDS, Clue, PatchClues, room_contrast
from annotate.person.extract import MaskCandidates
from annotate.person.patch_likelihoods import COMPARED_STRIDE, relative_warmth
from annotate.person.planes import normals_at
from annotate.segmentation.bare import bareness
from annotate.segmentation.part_clues import SuitReading, earlier_parts
from annotate.segmentation.part_tree import PART_REACH_M, middle_of
from annotate.segmentation.segment import Segmentation
from annotate.suit.color_model import readable
from sensors.rig.nearest import Nearest

_N = len(BODY_PARTS)
LAYOUT = {
    "belief": "parts",  # of the first reading
    "label": "classes",  # share of the pixels labelled so by the first reading
    "colour": "parts",  # log likelihood by the suit's colours
    "distance": "parts",  # to each part's middle, in its reaches
    "shown": "parts",  # root of each part's visible surface in m2
    "earlier": "parts",  # probabilities by the previous frame
    "place": "xyz",  # metres from the person's median, depth camera's frame
    "normal": "xyz",  # unit
    "lab": "three",  # CIE Lab, about -1 to 1
    "inside": "one",  # share in the mask
    "confidence": "one",  # of the first reading's labels
    "bare": "one",  # log odds of skin or shoe
    "readable": "one",  # share of readable colours
    "odds": "one",  # log odds of the person without the suit
    "suit odds": "one",  # log odds of the person with the suit
    "warmth": "one",  # share of the way from the room's temperature to the person's
    "felt": "one",  # share with a temperature
    "points": "one",  # logarithm
    "surface": "one",  # log m2
    "steps": "three",  # depth of the touching supervoxels less its own in metres: mean, farthest, nearest
    "frequency": "one",  # log frequency of the colour in the room
    "brightness": "one",  # log brightness above the room's
    "still": "one",  # share on a body part in the previous frame, at the same depth
    "has before": "one",  # 1 with a previous frame
    "patch surface": "one",  # log m2 of the patch
    "patch inside": "one",  # share of the patch in the mask
    "alike": "one",  # log m2 near by of the patch's colour
    "blur": "one",  # uncertainty of the chromaticity
    "clues": "clues",  # of the patch, in the order of ``annotate.person.clothed_mask.Clue``
}
"""Columns of a descriptor, in order, and their kind: their width, and what a mirror does to them."""
WIDTHS = {"parts": _N, "classes": _N + 1, "xyz": 3, "three": 3, "one": 1, "clues": len(Clue)}
"""Number of columns of each kind."""
DESCRIPTOR_WIDTH = sum(WIDTHS[kind] for kind in LAYOUT.values())
"""Width of a descriptor."""
MOST_CLUE, MOST_BARE, MOST_STEP_M = 8.0, 8.0, 0.3
"""Bounds of a clue's value, of the log odds of bareness, and of a depth step in metres. Chosen by eye."""
LEAST_FELT, LEAST_BARE_BLUR, TINY_M2 = 0.05, 0.02, 1e-5
"""Least share of pixels with a temperature that the warmth is divided by; least uncertainty of a chromaticity
for bareness; surface in m2 added before a logarithm. Chosen by eye."""
STILL_MM = 80
"""Change of depth in millimetres within which a pixel shows the same thing. Chosen by eye."""
CLEAR_PART_BELIEF, LEAST_PART_M2 = 0.5, 0.002
"""Belief from which on a supervoxel counts for its part's middle, and least surface of such supervoxels in m2
for a part to have a middle. Chosen by eye."""
UNSEEN_DISTANCE, FARTHEST = 2.0, 4.0
"""Distance to parts without a middle, and bound of the distance, in reaches. Chosen by eye."""
NEAREST_SUPERVOXELS, LONGEST_EDGE_M = 6, 0.15
"""Nearest supervoxels taken as neighbour_pairs, as at every second pixel few touch each other, and most
metres to one. Chosen by eye."""

_Columns = dict[str, Float64]


def descriptors(
    cloud: ThermalCloud,
    person: Bool,
    candidates: MaskCandidates,
    first: Segmentation,
    before: FrameLabels | None,
) -> Float64:
    """Descriptors (G, DESCRIPTOR_WIDTH) of the candidates' supervoxels, in the order of LAYOUT.

    person: bool (h, w). first: labels as read from the suit. before: labels of the previous frame.
    """
    if before is not None and before.parts.shape != person.shape:
        before = None
    pixels = _of_pixels(cloud, person, candidates, first, before)
    known: _Columns = {name: candidates.clues.groups.mean(values) for name, values in pixels.items()}
    known["warmth"] = known["warmth"] / np.maximum(known["felt"], LEAST_FELT)
    known |= _of_patches(cloud, candidates, known["inside"])
    known |= _of_supervoxels(cloud, person, candidates, first, before, known)
    return np.column_stack([known[name] for name in LAYOUT])


def _of_pixels(
    cloud: ThermalCloud,
    person: Bool,
    candidates: MaskCandidates,
    first: Segmentation,
    before: FrameLabels | None,
) -> dict[str, NDArray[np.generic]]:
    """Columns (n, ...) of each pixel compared, by name; arguments as of ``descriptors``."""
    compared, reading = candidates.clues.compared, first.reading
    assert reading is not None
    belief = np.zeros((*person.shape, _N), np.float32)
    belief[reading.mask] = reading.belief[reading.groups.ids]
    celsius, rgb = cloud.temperature_c[compared], cloud.color_rgb[compared]
    warmth = relative_warmth(celsius, cloud.temperature_c[candidates.room], cloud.temperature_c[person])
    brightness, frequency = room_contrast(cloud, compared, candidates.room)
    return {
        "belief": belief[compared],
        "label": np.eye(_N + 1)[np.where(first.parts == UNDEFINED, 0, first.parts)[compared]],
        "normal": np.nan_to_num(normals_at(cloud, *np.nonzero(compared))),
        "lab": np.asarray(cv2.cvtColor(rgb[None], cv2.COLOR_RGB2LAB))[0] / 128 - 1,
        "inside": person[compared],
        "confidence": first.confidence[compared],
        "odds": candidates.clues.pixel_odds,
        "suit odds": np.clip(candidates.odds[compared], -MOST_PERSON_ODDS, MOST_PERSON_ODDS),
        "warmth": np.where(np.isfinite(celsius), warmth, 0),
        "felt": np.isfinite(celsius),
        "frequency": frequency,
        "brightness": brightness,
        "still": _still(cloud, compared, before),
    }


def _still(cloud: ThermalCloud, compared: Bool, before: FrameLabels | None) -> Bool:
    """Flags (n,) of the compared pixels on a body part in the previous frame, at the same depth."""
    if before is None:
        return np.zeros(np.count_nonzero(compared), np.bool_)
    still = np.abs(before.depth_mm.astype(np.int32) - cloud.depth_mm) < STILL_MM
    return np.asarray((still & (before.parts > 0) & (before.parts < UNDEFINED))[compared])


def _of_patches(cloud: ThermalCloud, candidates: MaskCandidates, inside: Float64) -> _Columns:
    """Columns (G, ...) of each supervoxel's patch, and of its surface; inside: (G,), share in the mask."""
    clues = candidates.clues
    patch, surface_m2 = clues.patches.ids, _surface_m2(cloud, clues)
    patch_m2 = np.bincount(patch, surface_m2)
    return {
        "surface": np.log(surface_m2 + TINY_M2),
        "patch surface": np.log(patch_m2 + TINY_M2)[patch],
        "patch inside": (np.bincount(patch, surface_m2 * inside) / patch_m2)[patch],
        "alike": np.log(clues.surface_m2 + TINY_M2)[patch],
        "clues": np.clip(clues.columns, -MOST_CLUE, MOST_CLUE)[patch],
    }


def _of_supervoxels(
    cloud: ThermalCloud,
    person: Bool,
    candidates: MaskCandidates,
    first: Segmentation,
    before: FrameLabels | None,
    means: _Columns,
) -> _Columns:
    """Columns (G, ...) of each supervoxel as a whole; means: (G, ...), columns of its pixels."""
    clues, groups, reading = candidates.clues, candidates.clues.groups, first.reading
    assert reading is not None
    centroids_m = groups.centroids_m(cloud.points_m[clues.compared])
    on_person_m = cloud.points_m[person if person.any() else clues.compared]
    colour, usable = _colour(cloud.color_rgb[clues.compared], reading, groups)
    shown_m2, distance = _parts(means["belief"], _surface_m2(cloud, clues) * means["inside"], centroids_m)
    bare = bareness(reading.model, clues.chroma, np.maximum(clues.blur, LEAST_BARE_BLUR))
    unknown = np.full((groups.count, _N), 1 / _N)
    return {
        "colour": colour,
        "distance": distance,
        "shown": np.tile(np.sqrt(shown_m2), (groups.count, 1)),
        "earlier": earlier_parts(before, cloud.camera, centroids_m) if before else unknown,
        "place": centroids_m - np.median(on_person_m, axis=0),
        "bare": np.clip(bare, -MOST_BARE, MOST_BARE),
        "readable": usable,
        "points": np.log(groups.sizes),
        "steps": _steps(groups, centroids_m[:, 2]),
        "has before": np.full(groups.count, before is not None),
        "blur": clues.blur,
    }


def neighbour_pairs(centroids_m: Float64) -> Int32:
    """Pairs (e, 2) of supervoxels with near centroids (G, 3), metres; each pair once, the lower first."""
    nearest = Nearest(centroids_m.astype(np.float32))
    near = nearest.query(centroids_m, NEAREST_SUPERVOXELS + 1, within=LONGEST_EDGE_M)[1].ravel()
    own = np.repeat(np.arange(len(centroids_m)), NEAREST_SUPERVOXELS + 1)
    found = (near < len(centroids_m)) & (near != own)
    pairs = np.sort(np.column_stack([own[found], near[found]]), axis=1)
    return np.unique(pairs, axis=0).astype(np.int32)


def _surface_m2(cloud: ThermalCloud, clues: PatchClues) -> Float64:
    """Visible surface (G,) in m2 of each supervoxel."""
    z_m = cloud.points_m[clues.compared][:, 2].astype(np.float64)
    pixels_m2 = (COMPARED_STRIDE * z_m) ** 2 / (cloud.camera.fx * cloud.camera.fy)
    return np.asarray(np.bincount(clues.groups.ids, pixels_m2))


def _colour(rgb: UInt8, reading: SuitReading, groups: Supervoxels) -> tuple[Float64, Float64]:
    """Mean log likelihood (G, 11) of the readable colours (n, 3) under each part, and their share (G,)."""
    usable = readable(rgb, np.ones(len(rgb), np.bool_))
    evidence = np.zeros((len(rgb), _N))
    evidence[usable] = reading.model.evidence(rgb[usable])
    share = groups.mean(usable)
    return groups.mean(evidence) / np.maximum(share, 1 / groups.sizes)[:, None], share


def _parts(belief: Float64, surface_m2: Float64, centroids_m: Float64) -> tuple[Float64, Float64]:
    """Surface (11,) in m2 of each part's clear supervoxels; distances (G, 11) to their middles in reaches."""
    surface_m2 = (belief * (belief > CLEAR_PART_BELIEF)) * surface_m2[:, None]
    away = np.full(belief.shape, UNSEEN_DISTANCE)
    for part in np.flatnonzero(surface_m2.sum(axis=0) >= LEAST_PART_M2):
        middle_m = middle_of(surface_m2[:, part], centroids_m, PART_REACH_M[part])
        away_m = np.linalg.norm(centroids_m - middle_m, axis=1)
        away[:, part] = np.minimum(away_m / PART_REACH_M[part], FARTHEST)
    return surface_m2.sum(axis=0), away


def _steps(groups: Supervoxels, z_m: Float64) -> Float64:
    """Depth (G, 3) in metres of the touching supervoxels less its own (z_m (G,)): mean, farthest, nearest."""
    a, b = np.concatenate([groups.edges, groups.edges[:, ::-1]]).T
    step = np.clip(z_m[b] - z_m[a], -MOST_STEP_M, MOST_STEP_M)
    farthest, nearest = np.zeros((2, groups.count))
    np.maximum.at(farthest, a, step)
    np.minimum.at(nearest, a, step)
    mean = np.bincount(a, step, groups.count) / np.maximum(np.bincount(a, minlength=groups.count), 1)
    return np.column_stack([mean, farthest, nearest])
