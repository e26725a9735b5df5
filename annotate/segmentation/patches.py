"""Patches of one colour on a person, and which parts they can be: a second opinion before any pixel's.

Within a patch all supervoxels share the same cloth, fold and lamp, so that their colours are one piece of
evidence, not many. A patch's colour alone is often ambiguous once cloth has faded and light is coloured;
where it lies among the others rarely is.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from annotate.array_types import Float64, Index, Int64
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import BODY_PARTS, PART_ID
from annotate.segmentation.body_plan import CONTACT, DISTANCE_M, DISTANCE_SD_M
from annotate.segmentation.part_tree import softmax
from annotate.suit.color_model import GAIN, GAIN_SIGMA, GAIN_STEPS, ColorModel, under

MERGE = 0.15
"""Chromaticity by which touching supervoxels may differ in one patch; the less, the larger it has grown
(k of Felzenszwalb & Huttenlocher 2004, in supervoxels)."""
LEAST_BLUR = 0.01
"""No supervoxel's chromaticity is known better than that."""
UNREAD = 0.9
"""Uncertainty of a chromaticity from which on it says nothing: such patches are not read at all."""
MOST = 32
"""The largest patches are labelled together; the others wait for their surroundings."""
LEAST_POINTS, FULL_POINTS = 15, 40
"""Points of a patch that is labelled at all, and from which on its colour has its full weight."""
MEAN_BLUR = 0.5
"""Noise of a patch's mean colour against its points', which is the camera's and the light's in part."""
NARROW, SETTLED = 8, 8
"""How many labellings are followed in every light at first, and for how many patches: at most half."""
LIGHTS, BEAM = 12, 40
"""How many of the lights are followed from there on, and how many labellings in each."""
DISTANCE_WEIGHT, DISTANCE_WIDER = 6.0, 1.3
"""How many independent distances all those of a patch are worth; poses the rig has not seen are wider."""
CONTACT_WEIGHT, FULL_CONTACT = 0.7, 3.0
"""Weight of a contact, and how many touching pairs of supervoxels make one."""
ALWAYS_SEEN, ABSENT, WHOLE = (PART_ID["head"] - 1, PART_ID["torso"] - 1), -5.0, 8
"""Parts that 99.7 % of the rig's frames show (376 frames, seeds 101 to 141), log odds of those without.
Fewer patches than a whole person's may show less of one."""
STRAY = -8.0
"""Log likelihood of a patch whose colour is no swatch's."""

_N = len(BODY_PARTS)


@dataclass(frozen=True)
class Patches:
    """Patches of one colour: ids (G,) of the supervoxels' patches, 0 the largest; then by patch (R, ...).

    chroma (R, 2), blur (R,): mean chromaticity and its uncertainty. points: (R,) how many. middle_m: (R, 3).
    contacts: (R, R) touching pairs of supervoxels.
    """

    ids: Index
    chroma: Float64
    blur: Float64
    points: Float64
    middle_m: Float64
    contacts: Float64

    def mean(self, values: Float64, sizes: Int64) -> Float64:
        """Mean (R, k) over each patch of its supervoxels' values (G, k), which have ``sizes`` (G,)."""
        return _mean(self.ids, values, sizes.astype(np.float64))


def patches_of(groups: Supervoxels, chroma: Float64, blur: Float64, middle_m: Float64) -> Patches:
    """Join touching supervoxels of like chromaticity (G, 2); blur (G,): its uncertainty."""
    roots = _joined(groups, chroma)
    sizes = groups.sizes.astype(np.float64)
    rank = np.argsort(np.argsort(-np.bincount(roots, sizes, groups.count), kind="stable"), kind="stable")
    ids = rank[roots]
    count = int(ids.max()) + 1
    contacts = np.zeros((count, count))
    np.add.at(contacts, tuple(ids[groups.edges].T), 1)
    contacts = contacts + contacts.T
    np.fill_diagonal(contacts, 0)
    return Patches(
        ids,
        _mean(ids, chroma, sizes / np.maximum(blur, LEAST_BLUR) ** 2),
        _mean(ids, blur[:, None], sizes)[:, 0],
        np.bincount(ids, sizes, count).astype(np.float64),
        _mean(ids, middle_m, sizes),
        contacts,
    )


def _joined(groups: Supervoxels, chroma: Float64) -> Index:
    """One supervoxel's number (G,) for all of a patch: Felzenszwalb & Huttenlocher 2004 on their graph."""
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


def _mean(ids: Index, values: Float64, by: Float64) -> Float64:
    total = np.stack([np.bincount(ids, by * column) for column in values.T], axis=1)
    return np.asarray(total / np.bincount(ids, by)[:, None])


def read_together(patches: Patches, palette: ColorModel, clues: Float64) -> tuple[Float64, Float64]:
    """Belief (R, 11) about the patches and log gains (2,) of the light that explain them best as one body.

    clues: (R, 11) log evidence from elsewhere. A beam search over labellings, the largest patch first, in
    the lights of a grid side by side, from the middle on in the likeliest only; the belief is a mean over
    what is left in the beam.
    """
    used = np.flatnonzero((patches.points >= LEAST_POINTS) & (patches.blur < UNREAD))[:MOST]
    if not len(used):
        return np.full((len(patches.points), _N), 1 / _N), GAIN
    gains, unary = _lights(patches, palette, used)
    gains, labels, score = _beam(gains, unary + clues[used], pair_scores(patches, used))
    for part in ALWAYS_SEEN if len(used) >= WHOLE else ():
        score = score + ABSENT * ~(labels == part).any(axis=2)
    weight = np.exp(score - score.max())
    belief = np.full((len(patches.points), _N), 1 / _N)
    for n, patch in enumerate(used):
        belief[patch] = np.bincount(labels[..., n].ravel(), weight.ravel(), _N)
    belief[used] /= belief[used].sum(axis=1, keepdims=True)
    return belief, np.asarray(gains[np.unravel_index(score.argmax(), score.shape)[0]])


def read_alone(patches: Patches, palette: ColorModel, clues: Float64) -> tuple[Float64, Float64]:
    """As ``read_together``, but each patch by its own colour, in white light."""
    white = np.zeros(2)
    match = under(palette, white).match(patches.chroma, MEAN_BLUR * patches.blur)
    return softmax(palette.by_part(match) + clues), white


def _beam(gains: Float64, unary: Float64, pairs: Float64) -> tuple[Float64, Index, Float64]:
    """The likeliest gains (L, 2), and the best labellings (L, B, R) in each with their log score (L, B).

    gains: (all, 2). unary: (all, R, 11), pairs: (R, R, 11, 11), log scores.
    """
    count = unary.shape[1]
    labels = np.zeros((len(gains), 1, count), np.intp)
    score = (-((gains - GAIN) ** 2).sum(axis=1) / (2 * GAIN_SIGMA**2))[:, None]
    settled = min(SETTLED, count // 2)
    for n in range(count):
        if n == settled:
            likely = np.argsort(-score.max(axis=1), kind="stable")[:LIGHTS]
            gains, unary, labels, score = gains[likely], unary[likely], labels[likely], score[likely]
        labels, score = _grown(labels, score, unary, pairs, n, BEAM if n >= settled else NARROW)
    return gains, labels, score


@njit(cache=True, nogil=True)
def _grown(
    labels: Index, score: Float64, unary: Float64, pairs: Float64, n: int, most: int
) -> tuple[Index, Float64]:
    """Labellings (L, B', R) by one patch more, the n-th: the ``most`` best first; their scores (L, B')."""
    lights, beam, count = labels.shape
    parts = unary.shape[2]
    most = min(most, beam * parts)
    grown, best = np.zeros((lights, most, count), np.intp), np.zeros((lights, most))
    heard, at = np.zeros(parts), np.zeros(most, np.intp)
    for light in range(lights):
        found = 0
        for b in range(beam):
            heard[:] = 0
            for m in range(n):
                heard += pairs[m, n, labels[light, b, m]]
            for part in range(parts):
                value = score[light, b] + unary[light, n, part] + heard[part]
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
    """The gains (L, 2) of all lights and the log likelihood (L, R, 11) of the patches' parts in each."""
    gains = GAIN + np.stack(np.meshgrid(GAIN_STEPS, GAIN_STEPS), axis=-1).reshape(-1, 2)
    chroma, blur = patches.chroma[used], MEAN_BLUR * patches.blur[used]
    match = palette.match_under(gains, chroma, blur)
    by_part = np.logaddexp(palette.by_part(match), STRAY).reshape(len(gains), len(used), _N)
    return gains, by_part * np.minimum(patches.points[used] / FULL_POINTS, 1)[:, None]


def pair_scores(patches: Patches, used: Index) -> Float64:
    """Log score (R, R, 11, 11) of every pair of patches by their parts: how far apart, whether touching."""
    middle = patches.middle_m[used]
    away = np.linalg.norm(middle[:, None] - middle[None], axis=2)[..., None, None]
    spread = DISTANCE_WIDER * DISTANCE_SD_M
    distance = -0.5 * ((away - DISTANCE_M) / spread) ** 2 - np.log(spread / spread.mean())
    share = patches.points[used] / patches.points[used].sum()
    heed = DISTANCE_WEIGHT * (share[:, None] + share[None]) / 2
    contact = CONTACT_WEIGHT * np.minimum(patches.contacts[np.ix_(used, used)] / FULL_CONTACT, 1)
    return np.asarray(heed[..., None, None] * distance + contact[..., None, None] * CONTACT)
