"""Surface temperatures of a person and of the things in a room.

Constants are untuned unless a source is given.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from annotate.array_types import Bool, Float32, Float64, Int32, Int64
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from synth.body.body import Body, hair_faces
from synth.body.skeleton import JOINT_ID
from synth.surface.furniture import SURFACES, Surface
from synth.surface.rasterize import face_means

PART_C = {
    "head": 33.5,
    "chest": 30.5,
    "hip": 30.0,
    "upper_arm": 30.0,
    "forearm": 30.5,
    "upper_leg": 29.5,
    "lower_leg": 28.8,
}
"""Degrees Celsius of the paper's part with a region, by the region's name without side: a person at rest in a
room of 21 C, between skin and air (ISO 7933, clothing surface temperature).
"""
MEAN_ROOM_C = 20.5  # room of ``PART_C``
FOLLOWS_ROOM = 0.4  # degrees of cloth a degree of the room
HAIR_C = 27.5
HAND_C, COLD_HAND_C = 31.0, 26.0  # fingers fall to 25 C in a cool room (thermal comfort literature)
SOCK_C, COLD_FOOT_C = 27.5, 23.0
SLEEVE_DROP_C = 4.5  # of a loose or damp sleeve or trouser leg
LOOSE_DROP_C, LOOSE_M = 1.5, 0.03  # drop of cloth that far off the skin, in proportion below
CONTACT_C = 32.5  # of cloth pressed on cloth
CONTACT_M = 0.02  # distance of limbs that warm each other
TOUCH_WARM_S, TOUCH_COOL_S = 15.0, 30.0  # time constants of thin cloth
SURFACE_C = {surface: entry["celsius"] for surface, entry in SURFACES.items() if "celsius" in entry}


@dataclass(frozen=True)
class Clothing:
    """Personal differences of surface temperature.

    offset_c: shift of all cloth. patch_c: standard deviation of warm and cold patches. cold_feet, cold_hands:
    position between normal (0) and cold (1) temperature. cold_sleeves: ids of parts with loose cloth.
    """

    offset_c: float = 0.0
    patch_c: float = 0.0
    cold_feet: float = 0.0
    cold_hands: float = 0.0
    cold_sleeves: tuple[int, ...] = ()

    @staticmethod
    def sample(rng: np.random.Generator, strength: float) -> "Clothing":
        """Draw a person's differences. strength: factor on their size, ``Difficulty.warmth``."""
        limbs = [_part(side, limb) for side in ("left", "right") for limb in ("forearm", "lower_leg")]
        loose = tuple(part for part in limbs if rng.random() < 0.05 * strength**2)
        return Clothing(
            offset_c=0.5 * strength * float(rng.normal()),
            patch_c=0.35 * strength,
            cold_feet=min(1.0, 0.4 * strength * float(rng.random())),
            cold_hands=min(1.0, 0.4 * strength * float(rng.random())),
            cold_sleeves=loose,
        )


class BodyWarmth:
    """Surface temperature of a person; limbs that touch stay warm for a while. worn: body in loose cloth."""

    def __init__(
        self,
        body: Body,
        clothing: Clothing,
        room_c: float,
        rng: np.random.Generator,
        worn: Body | None = None,
    ) -> None:
        self._body = body
        self._apart = _apart(body, clothing, room_c, rng)
        if worn is not None:
            self._apart -= LOOSE_DROP_C * _looseness(body, worn)
        self._touch = np.zeros(len(body.vertices_m))
        self._limbs = _limb_vertices(body)

    def update(self, vertices_m: Float32, pressed: Bool, seconds: float) -> None:
        """Advance the temperatures by ``seconds`` in one pose (V, 3). pressed: (V,) flags of vertices on
        furniture.
        """
        touched = pressed | _touching(vertices_m, self._limbs)
        lag_s = np.where(touched, TOUCH_WARM_S, TOUCH_COOL_S)
        self._touch += (touched - self._touch) * (1 - np.exp(-seconds / lag_s))

    def celsius(self) -> Float64:
        """Return the temperature (F,) of every face, degrees Celsius."""
        touch = face_means(self._touch, self._body.faces)
        return np.asarray(self._apart + touch * np.maximum(CONTACT_C - self._apart, 0.0), np.float64)


_DRAWN = slice(16, 48)  # surfaces with a random number; another count changes every recording of a seed


def surface_temperatures(tags: Int32, room_c: float, spread: float, rng: np.random.Generator) -> Float64:
    """Draw the temperature (F,), degrees Celsius, of faces of objects by tag; spread: factor on the
    deviations.
    """
    table = np.full(max(Surface) + 1, room_c)
    table[_DRAWN] += 0.3 * spread * rng.normal(size=_DRAWN.stop - _DRAWN.start)
    for surface, (celsius, deviation) in SURFACE_C.items():
        if surface < _DRAWN.stop or surface in tags:
            table[surface] = celsius + spread * deviation * float(rng.normal())
    return np.asarray(table[tags], np.float64)


def _apart(body: Body, clothing: Clothing, room_c: float, rng: np.random.Generator) -> Float64:
    """Return the temperature (F,), degrees Celsius, of a body's faces where nothing touches them."""
    by_part = np.zeros(PAPER.n_classes)
    for region in Region:
        celsius = PART_C.get(region.label.removeprefix("left_").removeprefix("right_"))
        if celsius is not None:
            part = PAPER.table[region]
            by_part[part] = celsius + (0 if region == Region.HEAD else clothing.offset_c)
            by_part[part] -= SLEEVE_DROP_C * (part in clothing.cold_sleeves)
    temperature = by_part[body.face_parts]
    joint = body.strongest_joints
    for ends, warm, cold, share in (
        ("wrist", HAND_C, COLD_HAND_C, clothing.cold_hands),
        ("ankle", SOCK_C, COLD_FOOT_C, clothing.cold_feet),
    ):
        own = np.isin(joint, [JOINT_ID[f"{side}_{ends}"] for side in ("left", "right")])[body.faces[:, 0]]
        temperature[own] = warm + share * (cold - warm)
    temperature[hair_faces(body)] = HAIR_C
    centre = face_means(body.vertices_m, body.faces)
    waves = rng.normal(0, 9.0, (3, 6))
    patches = np.sin(centre @ waves + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1) / np.sqrt(3)
    temperature += FOLLOWS_ROOM * (room_c - MEAN_ROOM_C) + clothing.patch_c * patches
    return np.asarray(temperature, np.float64)


def _looseness(body: Body, worn: Body) -> Float64:
    """Return the looseness (F,) of cloth in [0, 1]: its distance to the skin, less the height of shoes."""
    lift = worn.joints_m[0] - body.joints_m[0]
    off_m = np.linalg.norm(worn.vertices_m - body.vertices_m - lift, axis=1)
    return np.asarray(face_means(np.clip(off_m / LOOSE_M, 0, 1), body.faces), np.float64)


def _part(side: str, limb: str) -> int:
    return int(PAPER.table[Region.on(side, limb)])


def _limb_vertices(body: Body) -> list[tuple[Int64, Int64]]:
    """Return pairs of vertex sets that can touch: arm and trunk, arm and leg, both legs."""
    part = body.vertex_parts
    sides: dict[str, dict[str, Int64]] = {}
    for side in ("left", "right"):
        ids = {limb: _part(side, limb) for limb in ("upper_arm", "forearm", "upper_leg", "lower_leg")}
        sides[side] = {limb: np.flatnonzero(part == p) for limb, p in ids.items()}
    trunk = np.flatnonzero(np.isin(part, PAPER.ids_of((Region.CHEST, Region.HIP))))
    pairs = []
    for own in sides.values():
        shoulder = body.vertices_m[trunk, 2] > body.vertices_m[own["upper_arm"], 2].max() - 0.18
        pairs += [(own["upper_arm"], trunk[~shoulder]), (own["forearm"], trunk)]
        for other in sides.values():
            pairs += [(own["forearm"], other[limb]) for limb in ("upper_leg", "lower_leg")]
    left, right = sides["left"], sides["right"]
    low = {limb: rows[body.vertices_m[rows, 2] < body.joints_m[0, 2] - 0.25] for limb, rows in left.items()}
    pairs += [(low["upper_leg"], right["upper_leg"]), (left["lower_leg"], right["lower_leg"])]
    pairs += [(left["forearm"], right["forearm"])]
    return pairs


def _touching(vertices_m: Float32, pairs: list[tuple[Int64, Int64]]) -> Bool:
    """Return flags (V,) of the vertices that touch the other set of their pair."""
    touched = np.zeros(len(vertices_m), np.bool_)
    for one, other in pairs:
        a, b = vertices_m[one], vertices_m[other]
        in_a, in_b = _beside(a, b), _beside(b, a)
        if not in_a.any() or not in_b.any():
            continue
        gap, nearest = cKDTree(b[in_b]).query(a[in_a], distance_upper_bound=CONTACT_M)
        touched[one[in_a][np.isfinite(gap)]] = True
        touched[other[in_b][np.unique(nearest[np.isfinite(gap)])]] = True
    return touched


def _beside(points_m: Float32, others_m: Float32) -> Bool:
    """Return flags (N,) of points within ``CONTACT_M`` of the bounding box of other points (M, 3)."""
    near: Bool = (points_m > others_m.min(axis=0) - CONTACT_M) & (points_m < others_m.max(axis=0) + CONTACT_M)
    x, y, z = near.T  # in a third of the time that ``all`` takes
    return np.asarray(x & y & z, np.bool_)
