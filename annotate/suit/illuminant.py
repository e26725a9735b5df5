"""The light of one frame, from colours alone: before it is known which part any of them belongs to."""

import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from annotate.parts import BODY_PARTS
from annotate.suit.color_model import (
    GAIN,
    GAIN_SIGMA,
    GAIN_STEPS,
    STRAY,
    ColorModel,
    blur,
    refit_colors,
    under,
    unfitted,
)
from annotate.suit.palette import Suit, chromaticity

LIT_COLORS, REFINED = 300, 2
"""Colours that every light is tried on, an even sample; best lights that the swatches are fitted in. Chosen
by eye."""


def fitted_to(suit: Suit, rgb: UInt8, belief: Float64 | None = None) -> ColorModel:
    """The suit's colours in the light that explains readable colours uint8 (n, 3) best, n > 0.

    belief: (n, 11), of each colour's part; None = all are as likely. Of a grid of lights those of the highest
    likelihood are refined by expectation maximisation, and the best of these is taken.
    """
    palette = unfitted(suit)
    if belief is None:
        belief = np.full((len(rgb), len(BODY_PARTS)), 1 / len(BODY_PARTS))
    every = slice(None, None, -(-len(rgb) // LIT_COLORS))
    some, prior = rgb[every], (palette.wears @ belief[every].T).astype(np.float32)
    chroma, noise = chromaticity(some), blur(some)
    red, green = np.meshgrid(GAIN[0] + GAIN_STEPS, GAIN[1] + GAIN_STEPS, indexing="ij")
    lights = np.stack([red.ravel(), green.ravel()], axis=1)
    order = np.argsort(-_score(palette.match_under(lights, chroma, noise), prior, lights))
    found = [refit_colors(under(palette, lights[i]), rgb, belief) for i in order[:REFINED]]
    scores = [_score(model.match(chroma, noise)[None], prior, model.log_gain[None])[0] for model in found]
    return found[int(np.argmax(scores))]


def _score(match: Float32, prior: Float32, lights: Float64) -> Float64:
    """Log likelihood (L,) of lights (L, 2) by the match (L, K, n) of colours, with priors (K, n)."""
    mixed = np.log((np.exp(match) * prior).sum(axis=1) + STRAY).sum(axis=1)
    return np.asarray(mixed - 0.5 * np.square((lights - GAIN) / GAIN_SIGMA).sum(axis=1))
