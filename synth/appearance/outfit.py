"""Outfit of a person: irregular seams, folds, wear and bare skin.

Zones of the suit's pattern meet where fields are 0 (``synth.appearance.pattern``). So noise in a field moves
a seam by the same distance. Cast: a set of synthetic people and things (``synth.data_files``).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.color import lab2rgb, rgb2lab

from annotate.array_types import Float32, Float64, Int32, UInt8
from annotate.scheme.regions import Region
from annotate.suit.palette import DEFAULT_SUIT, Suit
from synth.appearance.pattern import (
    FACE,
    FIRST_CLOTH,
    FIRST_SEAM,
    FOOT,
    HAIR,
    HAIRLINE,
    HAND,
    N_ZONES,
    SHOE,
    SKIN,
    Pattern,
    pattern_of,
)
from synth.body.atlas_border import face_regions
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.data_files import TRAINING, Cast, table_of

GAMMA = 2.2  # exponent from sRGB to linear light, close to IEC 61966-2-1
SKIN_RGB = np.array(table_of(TRAINING, "people")["skin"])  # sRGB (n, 3); of every cast
BLUSH = np.array([1.04, 0.94, 0.90])  # because lit skin is redder than the scale's swatches; untuned
FOLD_REACH_M = 0.14  # of folds about a bending joint
SEAM_REACH_M = 0.08  # of a seam's field
FOLDING = ("elbow", "knee", "hip", "shoulder")
PLAIN = pattern_of(DEFAULT_SUIT)
"""Pattern of plain clothes, by the parts of the scheme ``paper``."""
DRAWN = len(
    PLAIN.parts
)  # random numbers of each kind of wear; another count changes every recording of a seed
_TROUSERS = (
    Region.HIP,
    Region.LEFT_UPPER_LEG,
    Region.RIGHT_UPPER_LEG,
    Region.LEFT_LOWER_LEG,
    Region.RIGHT_LOWER_LEG,
)


@dataclass(frozen=True)
class Wear:
    """Deviations of a worn suit from its palette; untuned.

    seam_sd_m: standard deviation of a seam from the border of parts. fold_m: height of folds at a joint.
    hue_sd_deg, lightness_sd: deviations of a cloth in CIELAB. fade: greatest lost share of chroma. patch:
    strength of uneven wear within a cloth. alike: share of the difference removed between the colours of one
    pair of cloths. hood_down: share of people with bare hair. bare: whether hands and feet are bare.
    """

    seam_sd_m: float = 0.0
    fold_m: float = 0.0
    hue_sd_deg: float = 0.0
    lightness_sd: float = 0.0
    fade: float = 0.0
    patch: float = 0.0
    alike: float = 0.0
    hood_down: float = 0.0
    bare: bool = True


@dataclass(frozen=True)
class Outfit:
    """Colours and folds of a dressed body.

    face_regions: (F,), region ids. zone_rgb: linear (N_ZONES, 3), by zone. fields_m: (V, n_fields), fields of
    the pattern. folds_m: (V,) height of folds. rest_m: (V, 3), coordinates at which noise is sampled,
    different for each person.
    """

    pattern: Pattern
    face_regions: UInt8
    rest_m: Float32
    fields_m: Float32
    folds_m: Float32
    zone_rgb: Float64
    seam_sd_m: float
    patch: float

    @property
    def cloth_rgb(self) -> Float64:
        """Return the linear colours (n, 3) of the suit's cloths."""
        return self.zone_rgb[FIRST_CLOTH : FIRST_CLOTH + len(self.pattern.parts)]

    def face_rgb(self, faces: Int32) -> Float64:
        """Return the linear colour (F, 3) at the centres of the body's faces; seams are without noise."""
        fields = self.fields_m[faces].mean(axis=1)
        zone = self.pattern.zone_of_region[self.face_regions]
        opening = self.pattern.openings[zone, self.face_regions]
        open_ = (opening >= 0) & (fields[np.arange(len(fields)), np.maximum(opening, 0)] > 0)
        bare = np.where(opening == FOOT, SHOE, SKIN)
        bare[(opening == FACE) & (fields[:, HAIRLINE] > 0)] = HAIR
        return np.asarray(self.zone_rgb[np.where(open_, bare, zone)])


def dress(body: Body, suit: Suit, wear: Wear, rng: np.random.Generator, cast: Cast = TRAINING) -> Outfit:
    """Return a body's outfit: the worn suit, a random skin colour, and a cast's colours of hair and shoes."""
    pattern = pattern_of(suit)
    zone_rgb = _zones(_worn(suit, wear, rng), rng, cast)
    fields = _fields(body, pattern, rng.normal(0, (0.012, 0.015)))
    if rng.random() < wear.hood_down:
        fields[:, FACE] = 1.0
    if not wear.bare:
        fields[:, [HAND, FOOT, FACE]] = -1.0
    return _outfit(body, _Cloth(pattern, fields, zone_rgb), wear, rng)


def dress_plainly(body: Body, wear: Wear, rng: np.random.Generator, cast: Cast = TRAINING) -> Outfit:
    """Return a body's outfit of shirt and trousers in a cast's colours, with bare head, long or short
    sleeves.
    """
    shirt, trousers = (rng.choice(_colors(cast, what)) for what in ("shirt", "trousers"))
    cloth = np.tile(shirt + rng.normal(0, 6, 3), (len(PLAIN.parts), 1))
    cloth[PLAIN.zone_of_region[list(_TROUSERS)] - FIRST_CLOTH] = trousers
    fields = _fields(body, PLAIN, rng.normal(0, (0.012, 0.015)))
    fields[:, FACE] = 1.0
    if rng.random() < 0.5:
        fields[:, HAND] = 1.0
    zone_rgb = _zones(np.clip(cloth, 0, 255), rng, cast)
    return _outfit(body, _Cloth(PLAIN, fields, zone_rgb), wear, rng)


class _Cloth(NamedTuple):
    """Pattern, its fields (V, n_fields) on a body, and linear colours (N_ZONES, 3)."""

    pattern: Pattern
    fields: Float64
    zone_rgb: Float64


def _outfit(body: Body, cloth: _Cloth, wear: Wear, rng: np.random.Generator) -> Outfit:
    rest, folds = body.vertices_m + rng.uniform(0, 10, 3), wear.fold_m * _bending(body)
    a, b, c = (array.astype(np.float32) for array in (rest, cloth.fields, folds))
    regions = face_regions(body)
    return Outfit(cloth.pattern, regions, a, b, c, cloth.zone_rgb, wear.seam_sd_m, wear.patch)


def _colors(cast: Cast, what: str) -> NDArray[np.int_]:
    """Return the sRGB colours (n, 3) that a cast has for hair, shoe, shirt or trousers."""
    return np.array(table_of(cast, "people")[what])


def _zones(cloth_rgb: Float64, rng: np.random.Generator, cast: Cast) -> Float64:
    zones = np.zeros((N_ZONES, 3))
    zones[FIRST_CLOTH : FIRST_CLOTH + len(cloth_rgb)] = cloth_rgb
    tone = rng.uniform(0, len(SKIN_RGB) - 1)
    below = min(int(tone), len(SKIN_RGB) - 2)
    share = tone - below
    zones[SKIN] = BLUSH * ((1 - share) * SKIN_RGB[below] + share * SKIN_RGB[below + 1])
    zones[HAIR] = rng.choice(_colors(cast, "hair")) * rng.uniform(0.85, 1.15)
    zones[SHOE] = rng.choice(_colors(cast, "shoe")) * rng.uniform(0.8, 1.2)
    return np.asarray(np.power(np.clip(zones, 0, 255) / 255, GAMMA))


def _worn(suit: Suit, wear: Wear, rng: np.random.Generator) -> Float64:
    """Return the sRGB colours (n, 3) of a suit's cloths after wear, from each part's first swatch."""
    swatches = np.stack([suit.swatches_of(part)[0] for part in pattern_of(suit).parts])
    lab = np.asarray(rgb2lab(swatches / 255.0), np.float64)
    count = len(swatches)
    hue, faded, lighter, pair = _drawn(DRAWN, rng)
    if count != DRAWN:
        # ``rng`` draws the same numbers for every suit, so that room and light do not depend on the suit.
        hue, faded, lighter, pair = _drawn(count, rng.spawn(1)[0])
    turned = np.exp(1j * np.radians(wear.hue_sd_deg * hue)) * (1 - wear.fade * faded)
    ab = (lab[:, 1] + 1j * lab[:, 2]) * turned
    middle = ab[pair].sum() / 2
    ab[pair] += wear.alike * (middle - ab[pair])
    lab[:, 0] = np.clip(lab[:, 0] + wear.lightness_sd * lighter, 5, 95)
    lab[:, 1], lab[:, 2] = ab.real, ab.imag
    plain = wear.hue_sd_deg == wear.lightness_sd == wear.fade == wear.alike == 0
    return np.asarray(swatches if plain else np.clip(lab2rgb(lab), 0, 1) * 255, np.float64)


def _drawn(count: int, rng: np.random.Generator) -> tuple[Float64, Float64, Float64, NDArray[np.int_]]:
    """Draw wear of cloths: turns of the hue, fading and lightness (count,), and the indices of two alike
    cloths.
    """
    return (
        rng.normal(size=count),
        rng.uniform(size=count),
        rng.normal(size=count),
        np.resize(rng.permutation(count)[:2], 2),
    )


def _fields(body: Body, pattern: Pattern, shift_m: Float64) -> Float64:
    """Return the fields (V, n_fields): distances beyond wrists and ankles, into face and hair, beyond seams.

    shift_m: (2,) lengths of sleeve and trouser leg beyond wrist and ankle.
    """
    fields = np.zeros((len(body.vertices_m), pattern.n_fields))
    zones = pattern.zone_of_region[face_regions(body)]
    for n, pair in enumerate(pattern.seams, FIRST_SEAM):
        fields[:, n] = _seam_field(body, zones, pair)
    x, y, z = body.vertices_m.astype(np.float64).T
    points = np.stack([x, y, z], axis=1)
    at = {name: body.joints_m[i] for name, i in JOINT_ID.items()}
    side = np.where(x > 0, 0, 1)
    fields[:, HAND] = _beyond(points, at, side, "elbow", "wrist") - shift_m[0]
    fields[:, FOOT] = _beyond(points, at, side, "knee", "ankle") - 0.02 - shift_m[1]
    head = at["head"]
    fields[:, FACE] = np.minimum(head[1] - 0.02 - y, 0.065 - np.abs(x))
    brow = head[2] + 0.6 * (z.max() - head[2])
    fields[:, HAIRLINE] = np.maximum(z - brow, np.minimum(y - head[1] - 0.02, z - head[2]))
    return fields


def _beyond(points: Float64, at: dict[str, Float64], side: NDArray[np.int_], near: str, end: str) -> Float64:
    """Return how far (V,), metres, points (V, 3) lie beyond joint ``end`` along a limb.

    near: the limb's previous joint. side: (V,) 0 for the left limb, 1 for the right.
    """
    level = []
    for name in ("left", "right"):
        joint, before = at[f"{name}_{end}"], at[f"{name}_{near}"]
        level.append((points - joint) @ ((joint - before) / np.linalg.norm(joint - before)))
    return np.asarray(np.choose(side, level))


def _seam_field(body: Body, zones: UInt8, pair: tuple[int, int]) -> Float64:
    """Return the signed distance (V,) to the border of two zones, positive in the second. zones: (F,)."""
    first, second = (np.unique(body.faces[zones == zone]) for zone in pair)
    border = np.zeros(len(body.vertices_m), bool)
    border[np.intersect1d(first, second)] = True
    edges = body.faces[zones == pair[0]][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = edges[border[edges].all(axis=1)]
    start, end = (body.vertices_m[edges[:, i]].astype(np.float64) for i in range(2))
    line = np.concatenate([start + share * (end - start) for share in np.linspace(0, 1, 9)])
    away: Float64 = np.full(len(border), SEAM_REACH_M)
    near = np.union1d(first, second)
    away[near] = cKDTree(line).query(body.vertices_m[near], distance_upper_bound=SEAM_REACH_M)[0]
    np.minimum(away, SEAM_REACH_M, out=away)
    away[first] *= -1
    away[border] = 0
    return away


def _bending(body: Body) -> Float64:
    """Return the strength of folds (V,): 1 at a bending joint, 0.25 far from all."""
    joints = body.joints_m[[i for name, i in JOINT_ID.items() if name.endswith((*FOLDING, "spine_lower"))]]
    away = cKDTree(joints).query(body.vertices_m)[0]
    return np.asarray(0.25 + 0.75 * np.exp(-((away / FOLD_REACH_M) ** 2)))
