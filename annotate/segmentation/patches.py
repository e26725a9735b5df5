"""Patches of one colour on a person, and a belief (R, 11) in their parts, read together as one body.

Within a patch all supervoxels share the same cloth, fold and lamp, so that their colours are one piece of
evidence, not many. A patch's colour alone is often ambiguous once cloth has faded and light is coloured; its
place among the others rarely is.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float64, Index, Int64
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import BODY_PARTS, PART_ID
from annotate.segmentation.body_plan import CONTACT, DISTANCE_M, DISTANCE_SD_M
from annotate.segmentation.part_tree import softmax
from annotate.suit.color_model import GAIN, GAIN_SIGMA, GAIN_STEPS, ColorModel, under

SEED_M = 0.05
"""Distance in metres between supervoxel seeds: a forearm is about 7 cm thick. Chosen by eye."""
MERGE = 0.15
"""Chromaticity by which touching supervoxels may differ in one patch, less the larger it has grown (k of
Felzenszwalb & Huttenlocher 2004, in supervoxels). Chosen by eye."""
LEAST_MEAN_BLUR, UNREAD = 0.01, 0.9
"""Least uncertainty of a supervoxel's chromaticity, and that from which on a patch is not read. Chosen by
eye."""
MOST_PATCHES = 32
"""Patches labelled together, the largest; the others get a uniform belief. Chosen by eye."""
LEAST_PATCH_POINTS, FULL_POINTS = 15, 40
"""Points below which a patch is not labelled, and from which on its colour has its full weight. Chosen by
eye."""
MEAN_BLUR, STRAY_PATCH = 0.5, -8.0
"""Uncertainty of a patch's mean colour as a share of its points'; log likelihood if it is no swatch's. Chosen
by eye."""
NARROW, NARROW_PATCHES = 8, 8
"""Labellings followed in every light at first, and the patches labelled so, at most half of all. Chosen by
eye."""
LIGHTS, BEAM = 12, 40
"""Lights followed from there on, and labellings followed in each of them. Chosen by eye."""
DISTANCE_WEIGHT, DISTANCE_WIDER = 6.0, 1.3
"""Number of independent distances that all distances of a patch are worth, and the factor on the rig's spread
of distances, for poses outside the rig. Chosen by eye."""
CONTACT_WEIGHT, FULL_CONTACT = 0.7, 3.0
"""Weight of a contact between two patches, and the touching pairs of supervoxels that make one. Chosen by
eye."""
ALWAYS_SEEN = (PART_ID["head"] - 1, PART_ID["torso"] - 1)
"""Part indices in sight in 99.7 % of the rig's frames, measured over 376 frames, seeds 101 to 141."""
ABSENT, WHOLE = -5.0, 8
"""Log odds of a labelling without one of them, and patches from which on a person is taken to be seen whole.
Chosen by eye."""

_N = len(BODY_PARTS)


@dataclass(frozen=True)
class Patches:
    """R patches of one colour.

    ids: (G,), patch of each supervoxel, 0 the largest. chroma (R, 2), blur (R,): mean chromaticity and its
    uncertainty. points: (R,), number of points. middle_m: (R, 3), mean place in metres, depth camera's frame.
    contacts: (R, R), number of touching pairs of supervoxels.
    """

    ids: Index
    chroma: Float64
    blur: Float64
    points: Float64
    middle_m: Float64
    contacts: Float64

    @property
    def is_large(self) -> Bool:
        """Flags (R,) of the patches with enough points to be labelled."""
        return np.asarray(self.points >= LEAST_PATCH_POINTS)

    def mean(self, values: Float64, sizes: Int64) -> Float64:
        """Mean (R, k) over each patch of supervoxels' values (G, k); sizes: (G,), their numbers of points."""
        return _mean(self.ids, values, sizes.astype(np.float64))


def patches_of(groups: Supervoxels, chroma: Float64, blur: Float64, middle_m: Float64) -> Patches:
    """Patches of touching supervoxels of like chromaticity.

    chroma (G, 2), blur (G,): mean chromaticity and its uncertainty. middle_m: (G, 3), centroids in metres.
    """
    roots = _joined(groups, chroma)
    sizes = groups.sizes.astype(np.float64)
    rank = np.argsort(np.argsort(-np.bincount(roots, sizes, groups.count), kind="stable"), kind="stable")
    ids = rank[roots]
    count = int(ids.max()) + 1
    contacts = np.zeros((count, count))
    np.add.at(contacts, tuple(ids[groups.edges].T), 1)
    contacts = contacts + contacts.T
    np.fill_diagonal(contacts, 0)
    chroma = _mean(ids, chroma, sizes / np.maximum(blur, LEAST_MEAN_BLUR) ** 2)
    blur, points = _mean(ids, blur[:, None], sizes)[:, 0], np.bincount(ids, sizes, count)
    return Patches(ids, chroma, blur, points.astype(np.float64), _mean(ids, middle_m, sizes), contacts)


def _joined(groups: Supervoxels, chroma: Float64) -> Index:
    """Number (G,) of one supervoxel of each one's patch: Felzenszwalb & Huttenlocher 2004 on their graph."""
    a, b = groups.edges.T
    apart = np.linalg.norm(chroma[a] - chroma[b], axis=1)
    parent, size, within = list(range(groups.count)), [1] * groups.count, [0.0] * groups.count

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for edge in np.argsort(apart, kind="stable").tolist():
        i, j = root(int(a[edge])), root(int(b[edge]))
        if i != j and apart[edge] <= min(within[i] + MERGE / size[i], within[j] + MERGE / size[j]):
            parent[j], size[i], within[i] = i, size[i] + size[j], float(apart[edge])
    return np.array([root(i) for i in range(groups.count)], np.intp)


def _mean(ids: Index, values: Float64, weights: Float64) -> Float64:
    """Mean (R, k) of values (G, k) with weights (G,) over the groups ``ids`` (G,)."""
    total = np.stack([np.bincount(ids, weights * column) for column in values.T], axis=1)
    return np.asarray(total / np.bincount(ids, weights)[:, None])


def read_together(patches: Patches, palette: ColorModel, evidence: Float64) -> tuple[Float64, Float64]:
    """Belief (R, 11) in the parts of the patches, and log gains (2,) of the light that explain them best.

    evidence: (R, 11), log evidence besides colour. A beam search over labellings of the whole body, the
    largest patch first, in all lights of a grid, after the first patches in the likeliest lights only; the
    belief is a mean over the labellings left in the beam.
    """
    used = np.flatnonzero(patches.is_large & (patches.blur < UNREAD))[:MOST_PATCHES]
    if not len(used):
        return np.full((len(patches.points), _N), 1 / _N), GAIN
    gains, unary = _lights(patches, palette, used)
    gains, labels, score = _beam(gains, unary + evidence[used], pair_scores(patches, used))
    for part in ALWAYS_SEEN if len(used) >= WHOLE else ():
        score = score + ABSENT * ~(labels == part).any(axis=2)
    weight = np.exp(score - score.max())
    belief = np.full((len(patches.points), _N), 1 / _N)
    for n, patch in enumerate(used):
        belief[patch] = np.bincount(labels[..., n].ravel(), weight.ravel(), _N)
    belief[used] /= belief[used].sum(axis=1, keepdims=True)
    return belief, np.asarray(gains[np.unravel_index(score.argmax(), score.shape)[0]])


def read_alone(patches: Patches, palette: ColorModel, evidence: Float64) -> tuple[Float64, Float64]:
    """Belief (R, 11) and log gains (2,) as from ``read_together``, each patch by itself in white light."""
    white = np.zeros(2)
    match = under(palette, white).match(patches.chroma, MEAN_BLUR * patches.blur)
    return softmax(palette.by_part(match) + evidence), white


def _beam(gains: Float64, unary: Float64, pairs: Float64) -> tuple[Float64, Index, Float64]:
    """Log gains (L, 2) of the likeliest lights, best labellings (L, B, R) in each and log scores (L, B).

    gains: (A, 2), log gains of all lights. unary (A, R, 11), pairs (R, R, 11, 11): log scores.
    """
    count = unary.shape[1]
    labels = np.zeros((len(gains), 1, count), np.intp)
    score = (-((gains - GAIN) ** 2).sum(axis=1) / (2 * GAIN_SIGMA**2))[:, None]
    narrow = min(NARROW_PATCHES, count // 2)
    for n in range(count):
        if n == narrow:
            likely = np.argsort(-score.max(axis=1), kind="stable")[:LIGHTS]
            gains, unary, labels, score = gains[likely], unary[likely], labels[likely], score[likely]
        labels, score = _grown(labels, score, unary, pairs, n, BEAM if n >= narrow else NARROW)
    return gains, labels, score


@njit(cache=True, nogil=True)
def _grown(
    labels: Index, score: Float64, unary: Float64, pairs: Float64, n: int, most: int
) -> tuple[Index, Float64]:
    """Labellings (L, B', R) with the n-th patch added, ``most`` of them, best first; log scores (L, B')."""
    lights, beam, count = labels.shape
    parts = unary.shape[2]
    most = min(most, beam * parts)
    grown, best = np.zeros((lights, most, count), np.intp), np.zeros((lights, most))
    by_others, at = np.zeros(parts), np.zeros(most, np.intp)
    for light in range(lights):
        found = 0
        for b in range(beam):
            by_others[:] = 0
            for m in range(n):
                by_others += pairs[m, n, labels[light, b, m]]
            for part in range(parts):
                value = score[light, b] + unary[light, n, part] + by_others[part]
                if found == most and value <= best[light, most - 1]:
                    continue
                found = min(found + 1, most)
                i = found - 1
                while i > 0 and best[light, i - 1] < value:  # of equals the first stays before
                    best[light, i], at[i] = best[light, i - 1], at[i - 1]
                    i -= 1
                best[light, i], at[i] = value, b * parts + part
        for i in range(most):
            grown[light, i, :n] = labels[light, at[i] // parts, :n]
            grown[light, i, n] = at[i] % parts
    return grown, best


def _lights(patches: Patches, palette: ColorModel, used: Index) -> tuple[Float64, Float64]:
    """Log gains (L, 2) of all lights; log likelihoods (L, R, 11) of the parts of patches ``used`` in each."""
    gains = GAIN + np.stack(np.meshgrid(GAIN_STEPS, GAIN_STEPS), axis=-1).reshape(-1, 2)
    chroma, blur = patches.chroma[used], MEAN_BLUR * patches.blur[used]
    match = palette.match_under(gains, chroma, blur)
    by_part = np.logaddexp(palette.by_part(match), STRAY_PATCH).reshape(len(gains), len(used), _N)
    return gains, by_part * np.minimum(patches.points[used] / FULL_POINTS, 1)[:, None]


def pair_scores(patches: Patches, used: Index) -> Float64:
    """Log score (R, R, 11, 11) of every pair of patches ``used`` by their parts: distance and contact."""
    middle = patches.middle_m[used]
    away = np.linalg.norm(middle[:, None] - middle[None], axis=2)[..., None, None]
    spread = DISTANCE_WIDER * DISTANCE_SD_M
    distance = -0.5 * ((away - DISTANCE_M) / spread) ** 2 - np.log(spread / spread.mean())
    share = patches.points[used] / patches.points[used].sum()
    weight = DISTANCE_WEIGHT * (share[:, None] + share[None]) / 2
    contact = CONTACT_WEIGHT * np.minimum(patches.contacts[np.ix_(used, used)] / FULL_CONTACT, 1)
    return np.asarray(weight[..., None, None] * distance + contact[..., None, None] * CONTACT)
