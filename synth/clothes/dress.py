"""Dressing: what is worn becomes displaced skin and hanging pieces."""

from dataclasses import replace

import numpy as np

from annotate.array_types import Float32
from synth.body.body import Body, hair_faces
from synth.clothes.cloth import fold_heights, smooth_normals
from synth.clothes.dressed import Dressed, assembled
from synth.clothes.skin_map import ARMS, LEGS, Limb, SkinMap, skin_map

HAIR_LOSS = 1.0
"""Share of infrared that hair loses, as the naked presets take it."""


def naked(body: Body) -> Dressed:
    """The body as it is; its hair is dark."""
    return assembled(body, HAIR_LOSS * hair_faces(body).astype(np.float32))


def dress(body: Body, rng: np.random.Generator) -> Dressed:
    """A body in clothes drawn at random, from bare skin and thin clothes to thick ones."""
    if rng.random() < 0.15:
        return naked(body)
    places, thin = skin_map(body), rng.random() < 0.25
    ease = _ease(places, rng) * (0.3 if thin else 1.0)
    folds = fold_heights(body.vertices_m, rng)
    vertices = body.vertices_m + smooth_normals(body) * (ease * (1 + 0.4 * folds))[:, None]
    up = -float(vertices[:, 2].min())
    lift = np.array([0, 0, up], np.float32)
    worn = replace(body, vertices_m=np.asarray(vertices + lift, np.float32), joints_m=body.joints_m + lift)
    return assembled(worn, HAIR_LOSS * hair_faces(body).astype(np.float32))


def _ease(places: SkinMap, rng: np.random.Generator) -> Float32:
    legs, arms = np.isin(places.limb, LEGS), np.isin(places.limb, ARMS)
    trunk = places.limb == Limb.TRUNK
    trousers = np.where(legs, 0.01 + 0.01 * places.along, 0.01) * (places.along < 1.95)
    top = np.where(arms, 0.01 + 0.004 * places.along, 0.015) * (places.along < np.where(arms, 1.9, 0.95))
    hem = rng.uniform(-0.1, 0.1)
    worn = np.where(legs | trunk & (places.level < 0.2), trousers, 0.0)
    worn += np.where(arms | trunk & (places.level > hem), top, 0.0)
    return np.asarray(worn, np.float32)
