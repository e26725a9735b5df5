"""Tops and trousers: skin displaced along its normals and away from the limb's axis."""

from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Bool, Float32
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.clothes.attire import Top, Trousers
from synth.clothes.cloth import fold_heights, hold_apart, smooth_normals
from synth.clothes.skin_map import ARMS, LEGS, Limb, SkinMap, skin_map
from synth.clothes.tube import slack_m

EDGE = 0.04  # width of a hem's edge, share of a limb: about an edge of the skin
COLLAR = (0.9, 1.0)  # levels of a top's end at the neck
MIDLINE_M = 0.003  # distance of a leg's cloth from the midline at rest
PRESSED = 0.25  # share of thickness left between legs, and between arm and trunk; untuned
FIRM = {"TRUNK": 0.6, "HEAD": 1.0, "ARM": 0.5, "LEG": 0.3}  # share left between touching limbs; untuned
SLACK_LIMIT_M = 0.07  # greatest distance of hanging cloth from skin


@dataclass(frozen=True, eq=False)
class Fitting:
    """Body at rest, and the displacements of its clothes: ease_m (V,) along normals, hang_m (V, 3).

    dark: (V,), absorbed share of infrared of the outermost cloth.
    """

    body: Body
    places: SkinMap
    normals: Float32
    folds: Float32
    ease_m: Float32
    hang_m: Float32
    dark: Float32

    @classmethod
    def of(cls, body: Body, rng: np.random.Generator) -> "Fitting":
        """Return the fitting of a naked body, with displacements of 0."""
        n = len(body.vertices_m)
        ease, hang, dark = (np.zeros(shape, np.float32) for shape in (n, (n, 3), n))
        folds = fold_heights(body.vertices_m, rng)
        return cls(body, skin_map(body), smooth_normals(body), folds, ease, hang, dark)

    def lay(self, mask: Float32, ease_mm: Float32 | float, folds_mm: float, dark: float) -> None:
        """Add cloth of ``ease_mm`` thickness with folds, weighted by a mask (V,) in [0, 1]. dark: absorbed
        share of infrared.
        """
        off = np.asarray(ease_mm + folds_mm * self.folds, np.float32)
        self.ease_m[:] += mask * np.maximum(off, 0) / np.float32(1000)
        self.dark[mask > 0.5] = dark

    def let_hang(self, mask: Float32, slack: Float32, out: Float32) -> None:
        """Add displacements along ``out`` (V, 3), away from the limb's axis, to a hanging tube of cloth.

        slack: (V,), distance of the skin from the tube. mask: (V,), weights.
        """
        self.hang_m[:] += (mask * np.minimum(slack, np.float32(SLACK_LIMIT_M)))[:, None] * out

    def dressed_body(self) -> Body:
        """Return the body whose skin is the cloth, soles at z = 0."""
        off = self.ease_m[:, None] * self.normals + self.hang_m
        off = hold_apart(self.body, self.places, self.normals, off)
        skin = self._apart(off)
        firm = self._apart(self._firmness()[:, None] * off)
        up = np.array([0, 0, -skin[:, 2].min()], np.float32)
        joints = self.body.joints_m + up
        return replace(self.body, vertices_m=skin + up, joints_m=joints, firm_m=firm + up)

    def _apart(self, off_m: Float32) -> Float32:
        """Return vertices displaced by ``off_m`` (V, 3); cloth of a leg does not cross the middle plane."""
        vertices = self.body.vertices_m + off_m
        legs = np.isin(self.places.limb, LEGS)
        side = np.where(self.places.limb == Limb.LEFT_LEG, np.float32(1), np.float32(-1))
        inmost = np.minimum(side * self.body.vertices_m[:, 0], np.float32(MIDLINE_M))
        vertices[legs, 0] = (side * np.maximum(side * vertices[:, 0], inmost))[legs]
        return vertices

    def _firmness(self) -> Float32:
        """Return the share (V,) of cloth thickness that remains where limbs touch; 1 for shoes."""
        share = np.array([FIRM[limb.name.split("_")[-1]] for limb in Limb], np.float32)[self.places.limb]
        feet = [JOINT_ID["left_ankle"], JOINT_ID["right_ankle"]]
        return np.where(np.isin(self.body.strongest_joints, feet), np.float32(1), share)


def between(along: Float32, start: float, end: float) -> Float32:
    """Return a mask (V,) with soft edges that is 1 between two positions along a limb."""
    up = np.clip((along - np.float32(start)) / np.float32(EDGE) + np.float32(0.5), 0, 1)
    return np.asarray(up * np.clip((np.float32(end) - along) / np.float32(EDGE) + np.float32(0.5), 0, 1))


def ramp(along: Float32, start: float, end: float) -> Float32:
    """Return a smooth step (V,) from 0 at ``start`` to 1 at ``end``."""
    share = np.clip((along - np.float32(start)) / np.float32(end - start), 0, 1)
    return np.asarray(share * share * (3 - 2 * share))


def put_on_top(fitting: Fitting, top: Top) -> None:
    """Add the top to the fitting, on trunk and arms."""
    places = fitting.places
    arms = np.isin(places.limb, ARMS)
    trunk = (places.limb == Limb.TRUNK) | np.isin(places.limb, LEGS)
    collar = 1 - ramp(places.level, *COLLAR)
    mask = np.where(trunk, between(places.level, top.hem, 9) * collar, 0).astype(np.float32)
    beside = np.float32(1 - PRESSED) * ramp(np.abs(places.trunk.out[:, 0]), 0.5, 0.9)
    fitting.lay(mask, (1 - beside) * np.float32(top.body_mm), top.folds_mm, top.dark)
    source = trunk & (places.level > top.hem - EDGE) & (places.level < 0.8)
    height = -fitting.body.vertices_m[:, 2]
    slack = slack_m((height, places.trunk.around_rad, places.trunk.away_m), source, top.give)
    hanging = mask * (1 - beside * ramp(places.level, 0.1, 0.5)) * (1 - ramp(places.level, 0.5, 0.8))
    fitting.let_hang(hanging, slack, places.trunk.out)
    if top.hood_mm:
        nape = ramp(places.level, 0.78, 0.9) * (1 - ramp(places.level, 1.0, 1.12))
        behind = ramp(np.abs(places.trunk.around_rad), 1.2, 2.2)
        fitting.lay(np.where(arms, 0, nape * behind), top.hood_mm, top.folds_mm, top.dark)
    if top.sleeve > 0:
        _sleeves(fitting, top, arms)


def _sleeves(fitting: Fitting, top: Top, arms: Bool) -> None:
    places = fitting.places
    mask = np.where(arms, between(places.along, -1, top.sleeve), 0).astype(np.float32)
    share = np.clip(places.along / np.float32(top.sleeve), 0, 1)
    above = min(top.body_mm, 2 * top.cuff_mm)
    inner = _inner(places, Limb.LEFT_ARM)
    pressed = 1 - np.float32(1 - PRESSED) * inner
    fitting.lay(mask, pressed * (above + (top.cuff_mm - above) * share), 0.7 * top.folds_mm, top.dark)
    hanging = mask * pressed * ramp(places.along, 0.2, 0.5)
    for limb, side in zip(ARMS, ("left", "right"), strict=True):
        source = (places.limb == limb) & (places.along > 0.15) & (places.along < top.sleeve + EDGE)
        down = places.along * _bone_m(fitting.body, f"{side}_shoulder", f"{side}_elbow")
        slack = slack_m((down, places.limbs.around_rad, places.limbs.away_m), source, 0.1 + top.give)
        fitting.let_hang(hanging, slack, places.limbs.out)


def put_on_trousers(fitting: Fitting, worn: Trousers) -> None:
    """Add the trousers to the fitting, on hips and legs."""
    places = fitting.places
    legs = np.isin(places.limb, LEGS)
    seat = np.where(places.limb == Limb.TRUNK, between(places.level, -9, worn.waist), 0)
    fitting.lay(seat.astype(np.float32), worn.seat_mm, 0.5 * worn.folds_mm, worn.dark)
    mask = np.where(legs, between(places.along, -9, worn.hem), 0).astype(np.float32)
    share = ramp(places.along, 0.0, max(worn.hem, 0.3))
    inner = _inner(places, Limb.LEFT_LEG) * ramp(places.along, -0.1, 0.2)
    pressed = 1 - np.float32(1 - PRESSED) * inner
    fitting.lay(
        mask, pressed * (worn.seat_mm + (worn.hem_mm - worn.seat_mm) * share), worn.folds_mm, worn.dark
    )
    hanging = mask * ramp(places.along, 0.1, 0.4) * pressed
    for limb, side in zip(LEGS, ("left", "right"), strict=True):
        source = (places.limb == limb) & (places.along > 0.1) & (places.along < worn.hem + EDGE)
        down = places.along * _bone_m(fitting.body, f"{side}_hip", f"{side}_knee")
        slack = slack_m((down, places.limbs.around_rad, places.limbs.away_m), source, worn.give)
        fitting.let_hang(hanging, slack, places.limbs.out)


def _inner(places: SkinMap, left: Limb) -> Float32:
    """Return a weight (V,): 1 where a limb's skin faces the other limb of its pair, 0 where it faces away.
    left: the left limb.
    """
    side = np.where(places.limb == left, np.float32(-1), np.float32(1))
    return np.asarray(np.clip(side * places.limbs.out[:, 0], 0, 1))


def _bone_m(body: Body, start: str, end: str) -> np.float32:
    return np.float32(np.linalg.norm(body.joints_m[JOINT_ID[end]] - body.joints_m[JOINT_ID[start]]))
