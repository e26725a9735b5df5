"""Person points -> body parts: suit colour pooled over supervoxels, smoothed along the body's part tree."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.parts import BACKGROUND, BODY_PARTS, NEIGHBOURS, UNDEFINED
from annotate.suit import Suit, chromaticity
from annotate.supervoxels import Supervoxels, supervoxels

SEED_M = 0.05
"""Distance of supervoxel seeds: a forearm is about 7 cm thick."""
CHROMA_SIGMA = 0.05
"""Spread of a swatch's chromaticity under coloured light and on folds."""
NOISE_RGB = 4.0
"""Noise of an 8-bit colour channel, which blurs the chromaticity of dark pixels."""
COLOR_FLOOR = 1e-3
"""Likelihood of any colour on any part: reflections, toys, a mended sleeve."""
POINT_WEIGHT = 0.5
"""Weight of a point's own colour against its supervoxel's verdict, for seams inside a supervoxel."""
SAME, JOINED, TOUCHING = 0.0, -1.2, -2.4
"""Log compatibility of two touching supervoxels: the same part, anatomical neighbours, a chance contact."""
SMOOTHING = 0.6
ROUNDS = 12
MIN_COLORED_SHARE = 0.05
"""Below this share of person points with colour there is nothing to go by."""

_N = len(BODY_PARTS)


@dataclass(frozen=True)
class Segmentation:
    """Parts over the depth image. parts: uint8 (h, w); confidence: float32 (h, w), 0 off the person.

    notes: what went wrong, for the person who reviews.
    """

    parts: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    notes: tuple[str, ...] = ()


def segment(cloud: ThermalCloud, person: NDArray[np.bool_], suit: Suit) -> Segmentation:
    """Label a person's points by the suit they wear.

    person: bool (h, w). A frame whose person has hardly any colour comes back undefined, with a note.
    """
    mask = person & cloud.valid
    parts = np.full(mask.shape, BACKGROUND, np.uint8)
    confidence = np.zeros(mask.shape, np.float32)
    n, colored = int(mask.sum()), cloud.color_valid[mask]
    if n == 0:
        return Segmentation(parts, confidence, ("no person: nothing to label",))
    if colored.mean() < MIN_COLORED_SHARE:
        parts[mask] = UNDEFINED
        return Segmentation(parts, confidence, ("no colour on the person: parts are undefined",))
    points, rgb = cloud.points_m[mask], cloud.color_rgb[mask]
    groups = supervoxels(points, rgb, seed_m=SEED_M)
    evidence = _color_evidence(rgb, suit)
    evidence[~colored] = 0
    belief = _smooth(_pooled(evidence, colored, groups), groups)
    chosen, certainty = _points_in_groups(belief, evidence, groups)
    parts[mask], confidence[mask] = chosen + 1, certainty
    return Segmentation(parts, confidence)


def _color_evidence(rgb: NDArray[np.uint8], suit: Suit) -> NDArray[np.float64]:
    """Log likelihood (n, 11) of every part for every point's colour, the best swatch counting."""
    chroma = chromaticity(rgb)
    spread = CHROMA_SIGMA**2 + (NOISE_RGB / np.maximum(rgb.max(axis=1), 1.0)) ** 2
    gaps = np.square(chroma[:, None] - chromaticity(suit.colors_rgb)[None]).sum(axis=2)
    per_swatch = -gaps / (2 * spread[:, None])
    evidence = np.full((len(rgb), _N), -np.inf)
    for swatch, part in enumerate(suit.parts):
        evidence[:, part - 1] = np.maximum(evidence[:, part - 1], per_swatch[:, swatch])
    return np.asarray(np.logaddexp(evidence, np.log(COLOR_FLOOR)))


def _pooled(
    evidence: NDArray[np.float64], colored: NDArray[np.bool_], groups: Supervoxels
) -> NDArray[np.float64]:
    """Mean evidence (G, 11) over each supervoxel's coloured points, weighing more the more there are."""
    total = np.stack([np.bincount(groups.ids, column, groups.count) for column in evidence.T], axis=1)
    count = np.bincount(groups.ids, colored, groups.count)
    # A few points are a guess; from about ten on more of the same adds nothing: they share their light.
    return np.asarray(total / np.maximum(count, 1)[:, None] * (3 * count / (count + 10))[:, None])


def _compatibility() -> NDArray[np.float64]:
    table = np.full((_N, _N), TOUCHING)
    for i in range(_N):
        for j in range(_N):
            if frozenset((i + 1, j + 1)) in NEIGHBOURS:
                table[i, j] = JOINED
    np.fill_diagonal(table, SAME)
    return table


_COMPATIBILITY = _compatibility()


def _smooth(unary: NDArray[np.float64], groups: Supervoxels) -> NDArray[np.float64]:
    """Mean-field belief (G, 11) of a Potts-like field whose costs follow the body's part tree.

    Source: Kraehenbuehl & Koltun 2011, the sparse case. Each round is damped, so it settles.
    """
    belief = _softmax(unary)
    a, b = groups.edges.T
    degree = np.bincount(np.r_[a, b], minlength=groups.count)
    for _ in range(ROUNDS):
        message = np.zeros_like(belief)
        expected = belief @ _COMPATIBILITY
        np.add.at(message, a, expected[b])
        np.add.at(message, b, expected[a])
        # More neighbours do not mean more knowledge: the sum is tempered.
        message *= (SMOOTHING * 4 / np.maximum(degree, 4))[:, None]
        belief = 0.5 * belief + 0.5 * _softmax(unary + message)
    return belief


def _points_in_groups(
    belief: NDArray[np.float64], evidence: NDArray[np.float64], groups: Supervoxels
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Part index (n,) and confidence (n,) per point: the verdict of its supervoxel, mended by its own colour.

    A point may only take a part that its supervoxel or one touching it has.
    """
    chosen = belief.argmax(axis=1)
    allowed = np.zeros((groups.count, _N), bool)
    allowed[np.arange(groups.count), chosen] = True
    a, b = groups.edges.T
    allowed[a, chosen[b]] = True
    allowed[b, chosen[a]] = True
    score = np.log(belief + 1e-6)[groups.ids] + POINT_WEIGHT * evidence
    score[~allowed[groups.ids]] = -np.inf
    best = score.argmax(axis=1)
    return best, belief[groups.ids, best]


def _softmax(x: NDArray[np.float64]) -> NDArray[np.float64]:
    e = np.exp(x - x.max(axis=1, keepdims=True))
    return np.asarray(e / e.sum(axis=1, keepdims=True))
