"""A person's outfit, cloth by cloth: irregular seams, folds, wear and bare skin.

A colour belongs to a zone: the eleven parts of a suit by their ids, then skin, hair and shoes. Zones meet
where a field over the body's skin is zero; a field is a distance in metres, so that noise added to it
moves the seam by just as much.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.color import lab2rgb, rgb2lab

from annotate.array_types import Float32, Float64, Int32, UInt8
from annotate.parts import N_CLASSES, NEIGHBOURS, PART_ID
from annotate.suit.palette import Suit
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.data_files import table

SKIN, HAIR, SHOE = 12, 13, 14
N_ZONES = 15
SEAMS = tuple(sorted((min(pair), max(pair)) for pair in NEIGHBOURS))
"""Pairs of parts whose border carries a field: negative in the first, positive in the second."""
HAND, FOOT, FACE, HAIRLINE = (len(SEAMS) + i for i in range(4))
N_FIELDS = len(SEAMS) + 4
GAMMA = 2.2
"""Exponent from sRGB to linear light, near enough to IEC 61966-2-1."""

SKIN_RGB, HAIR_RGB, SHOE_RGB, SHIRT_RGB, TROUSERS_RGB = (
    np.array(table("people")[what]) for what in ("skin", "hair", "shoe", "shirt", "trousers")
)
"""sRGB (n, 3) of people and everyday clothes; sources in ``synth/data/people.toml``."""
BLUSH = np.array([1.04, 0.94, 0.90])
"""The scale's swatches are greyer than lit skin, whose blood is red. No source: chosen by eye."""
FOLD_REACH_M = 0.14
"""How far from a bending joint its folds die out."""
SEAM_REACH_M = 0.08
"""Farther from its border no seam is looked for."""
FOLDING = ("elbow", "knee", "hip", "shoulder")


@dataclass(frozen=True)
class Wear:
    """Deviation of a worn suit from its palette; no source for any strength: chosen by eye.

    seam_sd_m: a seam's distance from the part's border. fold_m: height of folds at a joint. hue_sd_deg and
    lightness_sd: a cloth's shift in CIELAB. fade: greatest share of a cloth's chroma that washing took.
    patch: spread of wear within a cloth. alike: how far one pair of cloths moved towards each other.
    hood_down: share of people with bare hair. bare: hands, neck and shoes are no cloth of the suit.
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
    """A dressed body. zone_rgb: linear (15, 3). fields_m: float32 (V, 14), see ``SEAMS``. folds_m: float32
    (V,) height of folds. rest_m: float32 (V, 3), where noise is read, apart from every other person's."""

    face_parts: UInt8
    rest_m: Float32
    fields_m: Float32
    folds_m: Float32
    zone_rgb: Float64
    seam_sd_m: float
    patch: float

    def face_rgb(self, faces: Int32) -> Float64:
        """Linear colour (F, 3) at the centre of each of the body's faces (F, 3), seams where they belong."""
        fields = self.fields_m[faces].mean(axis=1)
        zone = self.face_parts.copy()
        zone[np.isin(zone, (5, 6)) & (fields[:, HAND] > 0)] = SKIN
        zone[np.isin(zone, (10, 11)) & (fields[:, FOOT] > 0)] = SHOE
        face = (zone == PART_ID["head"]) & (fields[:, FACE] > 0)
        zone[face] = np.where(fields[face, HAIRLINE] > 0, HAIR, SKIN)
        return np.asarray(self.zone_rgb[zone])


def dress(body: Body, suit: Suit, wear: Wear, rng: np.random.Generator) -> Outfit:
    """A body in the suit as worn, skin, hair and shoes of any human colour."""
    zone_rgb = _zones(_worn(suit, wear, rng), rng)
    fields = _fields(body, rng.normal(0, (0.012, 0.015)))
    if rng.random() < wear.hood_down:
        fields[:, FACE] = 1.0
    if not wear.bare:
        fields[:, [HAND, FOOT, FACE]] = -1.0
    return _outfit(body, fields, zone_rgb, wear, rng)


def dress_plainly(body: Body, wear: Wear, rng: np.random.Generator) -> Outfit:
    """A body in shirt and trousers, bare-headed; sleeves long or short."""
    shirt, trousers = rng.choice(SHIRT_RGB), rng.choice(TROUSERS_RGB)
    cloth = np.zeros((N_CLASSES, 3))
    cloth[:] = shirt + rng.normal(0, 6, 3)
    cloth[[PART_ID[p] for p in ("hip", "left_upper_leg", "right_upper_leg")]] = trousers
    cloth[[PART_ID[p] for p in ("left_lower_leg", "right_lower_leg")]] = trousers
    fields = _fields(body, rng.normal(0, (0.012, 0.015)))
    fields[:, FACE] = 1.0
    if rng.random() < 0.5:
        fields[:, HAND] = 1.0
    return _outfit(body, fields, _zones(np.clip(cloth, 0, 255), rng), wear, rng)


def _outfit(body: Body, fields: Float64, zone_rgb: Float64, wear: Wear, rng: np.random.Generator) -> Outfit:
    return Outfit(
        body.face_parts,
        (body.vertices_m + rng.uniform(0, 10, 3)).astype(np.float32),
        fields.astype(np.float32),
        (wear.fold_m * _bending(body)).astype(np.float32),
        zone_rgb,
        wear.seam_sd_m,
        wear.patch,
    )


def _zones(cloth_rgb: Float64, rng: np.random.Generator) -> Float64:
    """Linear colours (15, 3): cloth by part, then skin, hair and shoes."""
    zones = np.zeros((N_ZONES, 3))
    zones[:N_CLASSES] = cloth_rgb
    tone = rng.uniform(0, len(SKIN_RGB) - 1)
    below = min(int(tone), len(SKIN_RGB) - 2)
    share = tone - below
    zones[SKIN] = BLUSH * ((1 - share) * SKIN_RGB[below] + share * SKIN_RGB[below + 1])
    zones[HAIR] = rng.choice(HAIR_RGB) * rng.uniform(0.85, 1.15)
    zones[SHOE] = rng.choice(SHOE_RGB) * rng.uniform(0.8, 1.2)
    return np.asarray(np.power(np.clip(zones, 0, 255) / 255, GAMMA))


def _worn(suit: Suit, wear: Wear, rng: np.random.Generator) -> Float64:
    """sRGB (12, 3) of every part's cloth after washing and sun, its palette's first swatch before."""
    swatches = np.stack([suit.colors_rgb[suit.parts == part][0] for part in range(1, N_CLASSES)])
    lab = np.asarray(rgb2lab(swatches / 255.0), np.float64)
    hue, faded, lighter = (rng.normal(size=11), rng.uniform(size=11), rng.normal(size=11))
    turned = np.exp(1j * np.radians(wear.hue_sd_deg * hue)) * (1 - wear.fade * faded)
    ab = (lab[:, 1] + 1j * lab[:, 2]) * turned
    a, b = rng.permutation(11)[:2]
    middle = (ab[a] + ab[b]) / 2
    ab[[a, b]] += wear.alike * (middle - ab[[a, b]])
    lab[:, 0] = np.clip(lab[:, 0] + wear.lightness_sd * lighter, 5, 95)
    lab[:, 1], lab[:, 2] = ab.real, ab.imag
    plain = wear.hue_sd_deg == wear.lightness_sd == wear.fade == wear.alike == 0
    worn = swatches if plain else np.clip(lab2rgb(lab), 0, 1) * 255
    return np.concatenate([np.zeros((1, 3)), worn])


def _fields(body: Body, shift_m: Float64) -> Float64:
    """Distances (V, 14) along the skin at rest: to ten seams, beyond wrist and ankle, into face and hair.

    shift_m: (2,) how much farther than the joint a sleeve and a trouser leg reach.
    """
    fields = np.zeros((len(body.vertices_m), N_FIELDS))
    for n, pair in enumerate(SEAMS):
        fields[:, n] = _seam_field(body, pair)
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
    """How far (V,) points lie beyond the joint ``end`` of a limb, along its last bone, each on its side."""
    level = []
    for name in ("left", "right"):
        joint, before = at[f"{name}_{end}"], at[f"{name}_{near}"]
        level.append((points - joint) @ ((joint - before) / np.linalg.norm(joint - before)))
    return np.asarray(np.choose(side, level))


def _seam_field(body: Body, pair: tuple[int, int]) -> Float64:
    """Distance (V,) to the border of two parts, positive in the second, 0 on it; elsewhere unused."""
    first, second = (np.unique(body.faces[body.face_parts == part]) for part in pair)
    border = np.zeros(len(body.vertices_m), bool)
    border[np.intersect1d(first, second)] = True
    edges = body.faces[body.face_parts == pair[0]][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
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
    """Where cloth folds (V,): 1 at a bending joint, little in the middle of a limb, 0.25 everywhere."""
    joints = body.joints_m[[i for name, i in JOINT_ID.items() if name.endswith((*FOLDING, "spine_lower"))]]
    away = cKDTree(joints).query(body.vertices_m)[0]
    return np.asarray(0.25 + 0.75 * np.exp(-((away / FOLD_REACH_M) ** 2)))
