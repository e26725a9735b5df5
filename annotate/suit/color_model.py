"""Colour model of a suit under the illuminant of one frame, and the likelihood of colours under each part.

The illuminant multiplies red, green and blue each by a gain (von Kries); exposure leaves the chromaticity
unchanged. Expectation maximisation fits the two gains and each swatch's shift (wear, reflections) and spread,
with priors near the palette. Constants are untuned unless a source is given.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import N_REGIONS, Region
from annotate.scheme.scheme import Scheme
from annotate.suit.palette import Suit, chromaticity

CLIPPED = 250  # 8-bit value from which a channel has lost its upper end
DARK = 20  # 8-bit value of the brightest channel below which a colour is noise
NOISE_RGB = 4.0  # of an 8-bit channel; blurs the chromaticity of dark pixels
SIGMA = 0.05  # expected standard deviation of a swatch's chromaticity, on folds and under several lamps
SIGMA_POINTS = 60.0  # points that SIGMA is worth
FADE, FADE_SIGMA = 0.1, 0.2  # share of the way from a cloth's chromaticity to the light's, mean and spread
HUE_SIGMA = 0.03  # standard deviation of a swatch's chromaticity beside fading
BARE = (((176, 135, 105), ("HEAD",), ("FOREARM", "HAND", "FINGERS")),
        ((70, 62, 58), ("HEAD",), ("LOWER_LEG", "FOOT", "TOES")))  # fmt: skip
"""sRGB of skin (the middle of the Monk Skin Tone scale), of dark hair and shoes; the regions that show them:
those in the middle, those on both sides.
"""
BARE_COST = 0.7  # log cost of explaining a colour by BARE instead of the suit
GAIN, GAIN_SIGMA = np.array([0.0, 0.25]), 0.3  # log gains of red and blue against green: mean and spread
GAIN_STEPS = np.linspace(-0.7, 0.7, 11)  # offsets from GAIN tried first; incandescent to sky is -0.6 to 0.6
POINT_WORTH = 0.2  # of a point's colour against the priors, because neighbours share illuminant and fold
STRAY = 0.02  # likelihood of any colour on any part, against a swatch's best: reflections, toys
FIT_ROUNDS = 3  # of expectation maximisation
MOST_COLORS = 2000  # of the even sample that stands for a person or a picture, for speed
GRID_COLORS, REFINED = 300, 2  # colours that every illuminant of the grid is tried on; best ones refined


@dataclass(frozen=True)
class ColorModel:
    """Chromaticities of a suit's K swatches (cloth colours) in the illuminant of one frame.

    palette: (K, 2), chromaticities in white light. shift: (K, 2), estimated offset that remains after the
    diagonal illuminant gains ``log_gain``. unknown: (K, 2, 2), covariance of ``shift``. variance: (K,), of a
    swatch's colours along each axis. wears: bool (K, 24), True for regions that show the swatch. bare: bool
    (K,), True for a swatch that is skin or hair, not cloth. log_gain: (2,), natural logarithms of the red and
    blue gains relative to green. parts: name of the suit's part by swatch, "" for one that is bare.

    The suit's scheme gives the regions of a swatch; colours are matched by swatch. A part's likelihood is the
    greatest of its regions, so a suit of any scheme serves a network and labels of any scheme, with losses.
    Colours of a finer suit, such as a glove, count for the network's whole part; they divide it at the end,
    where the labels are in the suit's scheme. Parts of a coarser suit, such as both arms in one colour, are
    equally likely by colour; only shape and depth separate left from right.
    """

    palette: Float64
    shift: Float64
    unknown: Float64
    variance: Float64
    wears: Bool
    bare: Bool
    log_gain: Float64
    parts: tuple[str, ...]

    @property
    def lit(self) -> Float64:
        """Return the palette's chromaticities (K, 2) in the illuminant."""
        return _lit(self.palette, self.log_gain)[0]

    @property
    def fading(self) -> Float64:
        """Return the vector (K, 2) from each lit swatch towards the illuminant's chromaticity, where faded
        colours lie.
        """
        lit, white = _lit(self.palette, self.log_gain)
        return np.asarray(white - lit)

    def match(self, chroma: Float64, noise: Float64) -> Float32:
        """Return the log likelihood (K, n) of colours under each swatch.

        The centre of a cloth swatch with standard deviation ``SIGMA`` has 0. chroma: (n, 2). noise: (n,),
        standard deviations of the chromaticities.
        """
        swatches = _Swatches(self.lit + self.shift, self.variance, self.unknown, self._cost)
        return _match(chroma, noise, swatches)

    def match_under(self, log_gains: Float64, chroma: Float64, noise: Float64) -> Float32:
        """Return ``match`` (L, K, n) of the unfitted model under each of L log gains (L, 2)."""
        lit, white = _lit(self.palette, log_gains)
        fading, count = white - lit, len(log_gains)
        middle, unknown = (lit + FADE * fading).reshape(-1, 2), _strays(fading).reshape(-1, 2, 2)
        swatches = _Swatches(middle, np.tile(self.variance, count), unknown, np.tile(self._cost, count))
        return _match(chroma, noise, swatches).reshape(count, -1, len(chroma))

    @property
    def _cost(self) -> Float64:
        return np.where(self.bare, BARE_COST, 0.0)

    @property
    def parts_worn(self) -> Bool:
        """Return ``worn_in`` of the scheme ``paper``."""
        return self.worn_in(PAPER)

    def worn_in(self, scheme: Scheme) -> Bool:
        """Return bool (K, m): True for the scheme's parts of the body with a region that shows the swatch."""
        return np.asarray(self.wears @ _regions_of(scheme).T)

    def evidence(self, rgb: UInt8, scheme: Scheme = PAPER) -> Float32:
        """Return the log likelihood (m, n) of colours uint8 (n, 3) under a scheme's parts of the body."""
        return np.asarray(np.log(self._likelihood(rgb, scheme) + np.float32(STRAY)), np.float32)

    def worn(self, rgb: UInt8, belief: Float64, scheme: Scheme = PAPER) -> float:
        """Return the mean probability that colours uint8 (n, 3), n > 0, come from a swatch of their part.

        belief: (n, m), probabilities of a scheme's parts of the body. The alternative is a stray colour.
        """
        likely = self._likelihood(rgb, scheme)
        return float((belief.T * likely / (likely + STRAY)).sum() / len(rgb))

    def _likelihood(self, rgb: UInt8, scheme: Scheme) -> Float32:
        return np.exp(self.by_part(self.match(chromaticity(rgb), blur(rgb)), scheme))

    def by_region(self, match: Float32) -> Float32:
        """Return the log likelihood (24, n) of each region's best swatch, from ``match`` (K, n) of all
        swatches.
        """
        return _greatest(match, self.wears)

    def by_part(self, match: Float32, scheme: Scheme = PAPER) -> Float32:
        """Return the log likelihood (m, n) of each part of the body: the greatest of ``by_region``."""
        return _greatest(match, self.worn_in(scheme))


@cache
def _regions_of(scheme: Scheme) -> Bool:
    """Return bool (m, 24): the regions of a scheme's parts of the body."""
    ids = np.array([[part.id] for part in scheme.parts if not part.is_free], np.uint8)
    return np.asarray(scheme.table[1 : N_REGIONS + 1] == ids)


def _greatest(match: Float32, worn: Bool) -> Float32:
    """Return the greatest row (m, n) of ``match`` (K, n) among the swatches of each column of ``worn`` (K,
    m).
    """
    return np.stack([match[own].max(axis=0) for own in worn.T])


def _lit(palette: Float64, log_gain: Float64) -> tuple[Float64, Float64]:
    """Return the chromaticities (..., K, 2) of a palette (K, 2), and (..., 1, 2) of white, under log gains
    (..., 2).
    """
    white = np.exp(log_gain[..., [0, 0, 1]] * (1, 0, 1))[..., None, :]
    rgb = np.column_stack([palette, 1 - palette.sum(axis=1)]) * white
    return rgb[..., :2] / rgb.sum(axis=-1, keepdims=True), white[..., :2] / white.sum(axis=-1, keepdims=True)


class _Swatches(NamedTuple):
    """Normal distributions of K swatches. middle: (K, 2). variance: (K,). unknown: (K, 2, 2), covariance of
    ``middle``. cost: (K,), subtracted from the log density.
    """

    middle: Float64
    variance: Float64
    unknown: Float64
    cost: Float64


def _match(chroma: Float64, noise: Float64, swatches: _Swatches) -> Float32:
    """Return the log density (K, n) of colours (n, 2) under swatches, less the swatches' cost; see
    ``ColorModel.match``.
    """
    middle, variance, unknown, cost = swatches
    of_colors = chroma[:, 0], chroma[:, 1], noise**2
    of_swatches = *middle.T, variance + unknown[:, 0, 0], unknown[:, 0, 1], variance + unknown[:, 1, 1]
    away, area = _away(np.array(of_colors, np.float32), np.array(of_swatches, np.float32))
    least = (2 * np.log(SIGMA) - cost).astype(np.float32)[:, None]
    return np.asarray(least - np.float32(0.5) * (away + np.log(area)), np.float32)


@njit(cache=True, nogil=True)
def _away(colors: Float32, swatches: Float32) -> tuple[Float32, Float32]:
    """Return squared Mahalanobis distances (K, n) of n colours from K swatches, and determinants (K, n) of
    the covariances.

    colors: (3, n), chromaticity and noise variance. swatches: (5, K), mean and xx, xy, yy.
    """
    shape = swatches.shape[1], colors.shape[1]
    away, area = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for k in range(shape[0]):
        x0, y0, xx0, xy, yy0 = swatches[:, k]
        for i in range(shape[1]):
            x, y = colors[0, i] - x0, colors[1, i] - y0
            xx, yy = colors[2, i] + xx0, colors[2, i] + yy0
            area[k, i] = xx * yy - xy * xy
            away[k, i] = (yy * x * x - np.float32(2) * xy * x * y + xx * y * y) / area[k, i]
    return away, area


def readable(rgb: UInt8, seen: Bool) -> Bool:
    """Return flags (n,), True for colours uint8 (n, 3) that are valid, not too dark, and clipped in one
    channel at most.

    seen: bool (n,), True for a valid colour.
    """
    red, green, blue = ((rgb[:, i] >= CLIPPED).view(np.uint8) for i in range(3))
    return np.asarray(seen & (_brightest(rgb) >= DARK) & (red + green + blue < 2))


def unfitted(suit: Suit) -> ColorModel:
    """Return the model of a palette in the expected illuminant, before any fit."""
    bare_regions = [_shown(middle, sided) for _, middle, sided in BARE]
    wears = np.concatenate([suit.regions_worn, np.array(bare_regions)])
    palette = chromaticity(np.concatenate([suit.colors_rgb, np.array([rgb for rgb, *_ in BARE])]))
    bare = np.arange(len(palette)) >= len(suit.parts)
    variance = np.full(len(palette), SIGMA**2)
    names = {part.id: part.name for part in suit.scheme.parts}
    parts = (*(names[part] for part in suit.parts.tolist()), *("" for _ in BARE))
    unknown = np.zeros((len(palette), 2, 2))
    model = ColorModel(palette, palette, unknown, variance, wears, bare, GAIN, parts)
    return under(model, GAIN)


def _shown(middle: tuple[str, ...], sided: tuple[str, ...]) -> list[bool]:
    """Return flags of the 24 regions: middle ones by name, those on both sides by name without side."""
    names = {*middle, *(f"{side}_{name}" for side in ("LEFT", "RIGHT") for name in sided)}
    return [region.name in names for region in Region]


def under(model: ColorModel, log_gain: Float64) -> ColorModel:
    """Return the unfitted model of a palette in the illuminant with log gains (2,)."""
    model = replace(model, log_gain=log_gain)
    fading = model.fading
    return replace(model, shift=FADE * fading, unknown=_strays(fading))


def refit_colors(model: ColorModel, rgb: UInt8, belief: Float64, scheme: Scheme = PAPER) -> ColorModel:
    """Return a model refitted to colours uint8 (n, 3) by expectation maximisation. belief: (n, m),
    probabilities of a scheme's parts of the body.
    """
    some = evenly(len(rgb))
    rgb, prior = rgb[some], (model.worn_in(scheme) @ belief[some].T).astype(np.float32)
    chroma, noise = chromaticity(rgb), blur(rgb)
    for _ in range(FIT_ROUNDS):
        match = np.exp(model.match(chroma, noise)) * prior
        share = match / (match.sum(axis=0) + STRAY)
        weight = share / (noise**2 + model.variance[:, None])
        model = replace(model, log_gain=_fitted_gain(model, chroma, weight))
        model = _fitted_swatches(model, chroma, share)
    return model


def evenly(count: int) -> slice:
    """Return the slice that samples at most ``MOST_COLORS`` of ``count`` colours evenly."""
    return slice(None, None, -(-count // MOST_COLORS))


def blur(rgb: UInt8) -> Float64:
    """Return the standard deviation (n,) of the chromaticity noise of colours uint8 (n, 3), larger for dark
    ones.
    """
    return np.asarray(NOISE_RGB / np.maximum(_brightest(rgb), 1.0))


def _brightest(rgb: UInt8) -> UInt8:
    # Written out, because numpy is slow along short axes.
    return np.maximum(np.maximum(rgb[:, 0], rgb[:, 1]), rgb[:, 2])


def _fitted_gain(model: ColorModel, chroma: Float64, weight: Float64) -> Float64:
    """Return log gains (2,) after one Gauss-Newton step; weight: (K, n), responsibility over variance."""
    x, y = model.lit.T
    z = 1 - x - y
    jacobian = np.stack([np.stack([x * (1 - x), -x * z], 1), np.stack([-x * y, -y * z], 1)], 1)
    mass = weight.sum(axis=1)
    residual = weight @ chroma - mass[:, None] * (model.lit + model.shift)
    normal = POINT_WORTH * np.einsum("k,kij,kil->jl", mass, jacobian, jacobian) + np.eye(2) / GAIN_SIGMA**2
    slope = POINT_WORTH * np.einsum("kij,ki->j", jacobian, residual)
    slope -= (model.log_gain - GAIN) / GAIN_SIGMA**2
    return np.asarray(model.log_gain + np.linalg.solve(normal, slope))


def _fitted_swatches(model: ColorModel, chroma: Float64, share: Float64) -> ColorModel:
    """Return the model with each swatch's shift and spread fitted to colours (n, 2) with responsibilities (K,
    n).
    """
    prior = np.linalg.inv(_strays(model.fading))
    mass, total = share.sum(axis=1), share @ chroma
    mean = total / np.maximum(mass, 1e-9)[:, None]
    gaps = (chroma[:, 0] - mean[:, :1]) ** 2 + (chroma[:, 1] - mean[:, 1:]) ** 2
    own = ((share * gaps).sum(axis=1) / 2 + SIGMA_POINTS * SIGMA**2) / (mass + SIGMA_POINTS)
    precision = POINT_WORTH * mass / own
    pull = np.einsum("kij,kj->ki", prior, FADE * model.fading)
    pull += (POINT_WORTH / own)[:, None] * (total - mass[:, None] * model.lit)
    unknown = np.linalg.inv(prior + precision[:, None, None] * np.eye(2))
    shift = np.einsum("kij,kj->ki", unknown, pull)
    return replace(model, shift=shift, unknown=unknown, variance=own)


def _strays(fading: Float64) -> Float64:
    """Return the prior covariance (..., 2, 2) of the swatches' shifts, larger along their fading (..., 2)."""
    return FADE_SIGMA**2 * fading[..., :, None] * fading[..., None, :] + HUE_SIGMA**2 * np.eye(2)


def fit_illuminant(
    suit: Suit, rgb: UInt8, belief: Float64 | None = None, scheme: Scheme = PAPER
) -> ColorModel:
    """Fit the illuminant to readable colours uint8 (n, 3), n > 0; return the suit's colours in it.

    belief: (n, m), probabilities of a scheme's parts of the body; None = all equally likely. The most likely
    candidates of a grid of illuminants are refined by expectation maximisation.
    """
    palette = unfitted(suit)
    if belief is None:
        parts = len(scheme.body_classes)
        belief = np.full((len(rgb), parts), 1 / parts)
    every = slice(None, None, -(-len(rgb) // GRID_COLORS))
    some, prior = rgb[every], (palette.worn_in(scheme) @ belief[every].T).astype(np.float32)
    chroma, noise = chromaticity(some), blur(some)
    red, green = np.meshgrid(GAIN[0] + GAIN_STEPS, GAIN[1] + GAIN_STEPS, indexing="ij")
    illuminants = np.stack([red.ravel(), green.ravel()], axis=1)
    order = np.argsort(-_score(palette.match_under(illuminants, chroma, noise), prior, illuminants))
    found = [refit_colors(under(palette, illuminants[i]), rgb, belief, scheme) for i in order[:REFINED]]
    scores = [_score(model.match(chroma, noise)[None], prior, model.log_gain[None])[0] for model in found]
    return found[int(np.argmax(scores))]


def _score(match: Float32, prior: Float32, illuminants: Float64) -> Float64:
    """Return the unnormalised log posterior (L,) of illuminants (L, 2), log gains; match: (L, K, n), prior:
    (K, n).
    """
    mixed = np.log((np.exp(match) * prior).sum(axis=1) + STRAY).sum(axis=1)
    return np.asarray(mixed - 0.5 * np.square((illuminants - GAIN) / GAIN_SIGMA).sum(axis=1))
