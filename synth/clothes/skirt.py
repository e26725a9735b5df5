"""Skirts, and the lower halves of coats, dresses and long shirts, about both legs."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float32, Float64, Int32, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from synth.body.body import Body
from synth.body.part_border import borders
from synth.body.skeleton import JOINT_ID
from synth.clothes.attire import Skirt
from synth.clothes.cloth import fold_heights
from synth.clothes.rings import BACK, CLEAR_M, FRONT, LINED, NODES, RING_M, Carrier, hung
from synth.clothes.skin_map import ARMS, LEGS, Limb, SkinMap
from synth.surface.facets import Triple

TUCK_M = 0.012  # of the first ring inside the flesh, to hide its edge
LIDS = 2 * NODES + 6  # faces of the two lids
FOREARM, EVERY = 1.2, 6  # first place on an arm that presses cloth, and stride of its vertices


@dataclass(frozen=True, eq=False)
class HangingSkirt:
    """Rings of cloth around the legs of a dressed body.

    ease_m: (R, NODES), distance from the flesh. flare: widening, metres per metre. upright: see ``_down``.
    """

    carrier: Carrier
    ease_m: Float32
    flare: float
    upright: tuple[float, float]
    faces: Int32
    face_parts: UInt8
    dark: Float32

    def place(self, vertices_m: Float32, joints_m: Float64) -> Float32:
        """Return the skirt's vertices (v, 3), as ``Piece.place``."""
        down = _down(joints_m, self.upright)
        return hung(vertices_m, down, self.carrier, self.ease_m, self.flare)


def hang_skirt(
    naked: Body, worn: Body, places: SkinMap, skirt: Skirt, rng: np.random.Generator
) -> HangingSkirt:
    """Return a skirt on the body ``worn``; naked: body without clothes; places: ``SkinMap`` of the body."""
    top, hem = _heights(naked, skirt)
    rings = max(4, round((top - hem) / RING_M) + 1)
    step = (top - hem) / (rings - 1)
    carrier = _carrier(naked, places, top, step, rings)
    ease, faces = _ease(rings, skirt, rng), _faces(rings)
    at_rest = hung(
        worn.vertices_m, (0.0, 0.0, -1.0), carrier._replace(arms=carrier.arms[:0]), ease, skirt.flare
    )
    parts = _parts_beneath(naked, at_rest, faces)
    dark = np.full(len(faces), skirt.dark, np.float32)
    return HangingSkirt(carrier, ease, skirt.flare, _upright(naked.joints_m), faces, parts, dark)


def _carrier(body: Body, places: SkinMap, top: float, step: float, rings: int) -> Carrier:
    """Return the carrier of rings that lie ``step`` metres apart, downwards from the height ``top``."""
    ring = (np.float32(top) - body.vertices_m[:, 2]) / np.float32(step)
    feet = np.isin(body.strongest_joints, (JOINT_ID["left_ankle"], JOINT_ID["right_ankle"]))
    about = np.isin(places.limb, (Limb.TRUNK, *LEGS)) & ~feet
    held = np.flatnonzero(about & (ring > -1) & (ring < rings)).astype(np.int32)
    arms = np.flatnonzero(np.isin(places.limb, ARMS) & (places.along > FOREARM))[::EVERY].astype(np.int32)
    left = (body.vertices_m[held, 0] > 0).astype(np.float32)
    return Carrier(held, ring[held], left, arms, float((top - body.joints_m[JOINT_ID["left_hip"], 2]) / step))


def _down(joints_m: Float64, upright: tuple[float, float]) -> Triple:
    """Return the pelvis' downward direction for joints (J, 3).

    upright: weights of the line from spine to hips, and of its perpendicular, forwards.
    """
    left, right, spine = (joints_m[JOINT_ID[n]] for n in ("left_hip", "right_hip", "spine_lower"))
    line = (left + right) / 2 - spine
    x, y, z = upright[0] * line + upright[1] * np.cross(left - right, line)
    return float(x), float(y), float(z)


def _upright(rest_joints_m: Float64) -> tuple[float, float]:
    """Return the weights with which ``_down`` is vertical for a body at rest."""
    axes = np.array([_down(rest_joints_m, shares) for shares in ((1.0, 0.0), (0.0, 1.0))])
    along, across = np.linalg.lstsq(axes.T, np.array([0.0, 0.0, -1.0]), rcond=None)[0]
    return float(along), float(across)


def _heights(body: Body, skirt: Skirt) -> tuple[float, float]:
    hip, knee, ankle, neck = (
        body.joints_m[JOINT_ID[n], 2] for n in ("left_hip", "left_knee", "left_ankle", "neck")
    )
    top = hip + skirt.waist * (neck - hip)
    hem = float(np.interp(skirt.hem, [0, 1, 2], [hip, knee, ankle]))
    return float(top), hem


def _ease(rings: int, skirt: Skirt, rng: np.random.Generator) -> Float32:
    """Return the distance (R, NODES) of the skirt's rings from the body surface, in metres.

    The folds are deeper at the lower rings.
    """
    down = np.arange(rings, dtype=np.float32)[:, None] * np.float32(RING_M)
    angle = np.linspace(0, 2 * np.pi, NODES, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1) * 0.15
    places = np.array([(x, y, d) for d in down[:, 0] * 0.4 for x, y in around], np.float32)
    folds = fold_heights(places, rng).reshape(rings, NODES)
    folds *= np.float32(skirt.folds_mm / 1000) * np.clip(down / np.float32(0.3), 0.2, 1.5)
    ease = np.float32(skirt.ease_mm / 1000) * np.clip(down / np.float32(0.08), 0, 1) + folds
    ease = np.maximum(ease, 0) + np.float32(CLEAR_M)
    ease[0] = -TUCK_M
    return np.asarray(ease, np.float32)


def _faces(rings: int) -> Int32:
    """Return the outward faces (F, 3): outside and inside, two per quad, then the two closing lids.

    The lower lid's faces meet in the centre of each leg; six lie between the legs.
    """
    total = rings + LINED
    k, j = np.meshgrid(np.arange(total - 1), np.arange(NODES), indexing="ij")
    a, b = k * NODES + j, k * NODES + (j + 1) % NODES
    c, d = a + NODES, b + NODES
    sides = np.stack([np.stack([a, d, b], -1), np.stack([a, c, d], -1)], axis=-2).reshape(-1, 3)
    first, last = np.arange(NODES), (total - 1) * NODES + np.arange(NODES)
    roof = np.stack([np.full(NODES, total * NODES), first, np.roll(first, -1)], axis=1)
    right, left, behind, ahead = total * NODES + np.arange(1, 5)
    own = np.where((np.arange(NODES) >= BACK) & (np.arange(NODES) < FRONT), right, left)
    floor = np.stack([own, np.roll(last, -1), last], axis=1)
    between = [
        (right, ahead, last[FRONT]), (ahead, left, last[FRONT]), (right, behind, ahead),
        (left, behind, last[BACK]), (behind, right, last[BACK]), (left, ahead, behind),
    ]  # fmt: skip
    return np.concatenate([sides, roof, floor, between]).astype(np.int32)


def _parts_beneath(body: Body, at_rest: Float32, faces: Int32) -> UInt8:
    """Return the body part (F,) under each face of the skirt at rest.

    The two triangles of a quad get the same part.
    """
    middles = at_rest[faces].mean(axis=1, dtype=np.float64)
    quads = middles[: len(faces) - LIDS].reshape(-1, 2, 3)
    quads[:] = quads.mean(axis=1, keepdims=True)
    levels = {
        (b.before, b.beyond): b.level for b in borders(body.vertices_m.astype(np.float64), body.joints_m)
    }
    torso, hip = (int(PAPER.table[region]) for region in (Region.CHEST, Region.HIP))
    parts = np.where(levels[torso, hip](middles) > 0, hip, torso).astype(np.uint8)
    for side, own in (("left", middles[:, 0] > 0), ("right", middles[:, 0] <= 0)):
        thigh, shank = (int(PAPER.table[Region.on(side, name)]) for name in ("upper_leg", "lower_leg"))
        parts[own & (levels[hip, thigh](middles) > 0)] = thigh
        parts[(parts == thigh) & (levels[thigh, shank](middles) > 0)] = shank
    return parts
