"""Patches read together: the kernels beside their plain NumPy twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.segmentation.patches import _grown
from annotate.suit.color_model import GAIN, under, unfitted
from annotate.suit.palette import DEFAULT_SUIT


def grown_naive(labels, score, unary, pairs, n, most):
    """Every labelling by every part, sorted; of equals the first stays before."""
    heard = sum((pairs[m, n][labels[..., m]] for m in range(n)), np.zeros((1, 1, unary.shape[2])))
    flat = (score[..., None] + unary[:, None, n] + heard).reshape(len(labels), -1)
    best = np.argsort(-flat, axis=1, kind="stable")[:, :most]
    labels = labels[np.arange(len(labels))[:, None], best // unary.shape[2]].copy()
    labels[..., n] = best % unary.shape[2]
    return labels, np.take_along_axis(flat, best, axis=1)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 50))
def test_the_beam_keeps_the_best_labellings_in_order(seed, lights, most):
    rng = np.random.default_rng(seed)
    unary = rng.integers(-4, 1, (lights, 5, 11)).astype(float)  # whole numbers: many are equal
    pairs = rng.integers(-4, 1, (5, 5, 11, 11)).astype(float)
    kept = twin = np.zeros((lights, 1, 5), np.intp), np.zeros((lights, 1))
    for n in range(5):
        kept, twin = _grown(*kept, unary, pairs, n, most), grown_naive(*twin, unary, pairs, n, most)
        for mine, theirs in zip(kept, twin, strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_all_lights_at_once_match_as_one_by_one():
    rng = np.random.default_rng(3)
    palette, chroma, noise = unfitted(DEFAULT_SUIT), rng.uniform(0.1, 0.6, (7, 2)), rng.uniform(0.01, 0.3, 7)
    gains = GAIN + rng.uniform(-0.7, 0.7, (5, 2))
    expected = np.concatenate([under(palette, gain).match(chroma, noise) for gain in gains])
    np.testing.assert_allclose(palette.match_under(gains, chroma, noise), expected, rtol=1e-9)


def test_a_part_is_explained_by_the_best_of_its_swatches():
    palette = unfitted(DEFAULT_SUIT)
    match = np.random.default_rng(4).normal(size=(9, len(palette.wears)))
    for part, best in enumerate(palette.by_part(match).T):
        np.testing.assert_array_equal(best, match[:, palette.wears[:, part]].max(axis=1))
