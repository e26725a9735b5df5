"""Colour model of a suit in the light of one frame, and the log likelihood of colours under its parts.

The light of a frame (lamp, white balance) multiplies red, green and blue each by a gain, von Kries' model;
exposure multiplies all three and leaves the chromaticity alone. The two gains, each swatch's remaining
shift (worn cloth, colour thrown by its neighbours) and its spread are fitted to the person's points by
expectation maximisation, held near the palette by priors.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.parts import BODY_PARTS, PARTS
from annotate.suit.palette import Suit, chromaticity

CLIPPED, DARK = 250, 20
"""8-bit value from which on a channel has lost its upper end, and that of the brightest channel below which a
colour is noise. Chosen by eye."""
NOISE_RGB = 4.0
"""Noise of an 8-bit channel, which blurs the chromaticity of dark pixels. Chosen by eye."""
SIGMA, SIGMA_POINTS = 0.05, 60.0
"""Expected standard deviation of a swatch's chromaticity, on folds and under several lamps, and the number of
points that it is worth. Chosen by eye."""
FADE, FADE_SIGMA, HUE_SIGMA = 0.1, 0.2, 0.03
"""Expected fading, a share of the way from a cloth's chromaticity to the light's, and its standard deviation;
that of a swatch's chromaticity beside fading. Chosen by eye."""
BARE = (((176, 135, 105), ("head", "left_forearm", "right_forearm")),
        ((70, 62, 58), ("head", "left_lower_leg", "right_lower_leg")))  # fmt: skip
"""sRGB colours that are no cloth of the suit, and the parts that show them: skin of face and hands (the
middle of the Monk Skin Tone scale); dark hair and shoes (chosen by eye)."""
BARE_COST = 0.7
"""Log cost of explaining a colour by something bare instead of the suit. Chosen by eye."""
GAIN, GAIN_SIGMA = np.array([0.0, 0.25]), 0.3
"""Expected log gains (2,) of red and blue against green between a palette and any light, and the standard
deviation of each. Chosen by eye."""
GAIN_STEPS = np.linspace(-0.7, 0.7, 11)
"""Offsets from them tried at first, in both; incandescent lamp to blue sky is about -0.6 to 0.6."""
POINT_WORTH = 0.2
"""Worth of a point's colour against the priors, as neighbours share their light and fold. Chosen by eye."""
STRAY = 0.02
"""Likelihood of any colour on any part, against a swatch's best: reflections, toys. Chosen by eye."""
FIT_ROUNDS, MOST_COLORS = 3, 2000
"""Rounds of expectation maximisation; colours that stand for all of a person or of a picture, an even sample,
for speed. Chosen by eye."""


@dataclass(frozen=True)
class ColorModel:
    """K swatches in the light of one frame.

    palette: (K, 2), chromaticities in white light. shift: (K, 2), offset from the palette under the gains;
    unknown: (K, 2, 2), its covariance. variance: (K,), of a swatch's colours along one axis. wears: bool (K,
    11), parts that show a swatch. bare: bool (K,), no cloth of the suit. log_gain: (2,), of red and blue
    against green, natural logarithm.
    """

    palette: Float64
    shift: Float64
    unknown: Float64
    variance: Float64
    wears: Bool
    bare: Bool
    log_gain: Float64

    @property
    def lit(self) -> Float64:
        """Chromaticities (K, 2) of the palette in the frame's light."""
        return _lit(self.palette, self.log_gain)[0]

    @property
    def fading(self) -> Float64:
        """Offset (K, 2) from the lit palette to the light's own chromaticity."""
        lit, light = _lit(self.palette, self.log_gain)
        return np.asarray(light - lit)

    def match(self, chroma: Float64, noise: Float64) -> Float32:
        """Log likelihood (K, n) of colours under each swatch, 0 at the middle of one as wide as SIGMA.

        chroma (n, 2), noise (n,): chromaticities and their standard deviations.
        """
        return _match(chroma, noise, self.lit + self.shift, self.variance, self.unknown, self._cost)

    def match_under(self, log_gains: Float64, chroma: Float64, noise: Float64) -> Float32:
        """Log likelihood (L, K, n) by ``match`` of the unfitted model under log gains (L, 2)."""
        lit, light = _lit(self.palette, log_gains)
        fading, lights = light - lit, len(log_gains)
        middle, unknown = (lit + FADE * fading).reshape(-1, 2), _strays(fading).reshape(-1, 2, 2)
        variance, cost = np.tile(self.variance, lights), np.tile(self._cost, lights)
        return _match(chroma, noise, middle, variance, unknown, cost).reshape(lights, -1, len(chroma))

    @property
    def _cost(self) -> Float64:
        return np.where(self.bare, BARE_COST, 0.0)

    def evidence(self, rgb: UInt8) -> Float32:
        """Log likelihood (11, n) of colours uint8 (n, 3) under every part; flat where no swatch is near."""
        return np.asarray(np.log(self._likelihood(rgb) + np.float32(STRAY)), np.float32)

    def worn(self, rgb: UInt8, belief: Float64) -> float:
        """Share of colours uint8 (n, 3), n > 0, that parts with beliefs (n, 11) wear."""
        likely = self._likelihood(rgb)
        return float((belief.T * likely / (likely + STRAY)).sum() / len(rgb))

    def _likelihood(self, rgb: UInt8) -> Float32:
        return np.exp(self.by_part(self.match(chromaticity(rgb), blur(rgb))))

    def by_part(self, match: Float32) -> Float32:
        """Log likelihood (11, n) of each part's best swatch, from that of all swatches (K, n)."""
        return np.stack([match[worn].max(axis=0) for worn in self.wears.T])


def _lit(palette: Float64, log_gain: Float64) -> tuple[Float64, Float64]:
    """Chromaticities (..., K, 2) of a palette (K, 2) in lights (..., 2), and of the lights (..., 1, 2)."""
    light = np.exp(log_gain[..., [0, 0, 1]] * (1, 0, 1))[..., None, :]
    rgb = np.column_stack([palette, 1 - palette.sum(axis=1)]) * light
    return rgb[..., :2] / rgb.sum(axis=-1, keepdims=True), light[..., :2] / light.sum(axis=-1, keepdims=True)


def _match(
    chroma: Float64, noise: Float64, middle: Float64, variance: Float64, unknown: Float64, cost: Float64
) -> Float32:
    """Log density (K, n) of normal distributions less each one's cost; as ``ColorModel.match``."""
    of_colors = chroma[:, 0], chroma[:, 1], noise**2
    of_swatches = *middle.T, variance + unknown[:, 0, 0], unknown[:, 0, 1], variance + unknown[:, 1, 1]
    away, area = _away(np.array(of_colors, np.float32), np.array(of_swatches, np.float32))
    least = (2 * np.log(SIGMA) - cost).astype(np.float32)[:, None]
    return np.asarray(least - np.float32(0.5) * (away + np.log(area)), np.float32)


@njit(cache=True, nogil=True)
def _away(colors: Float32, swatches: Float32) -> tuple[Float32, Float32]:
    """Squared distances (K, n) in standard deviations, and determinants (K, n) of the covariances.

    colors: (3, n), chromaticities and variances. swatches: (5, K), chromaticities and covariances (xx, xy,
    yy). In single precision and along the colours, so that loops vectorise.
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
    """Flags (n,) of readable colours uint8 (n, 3): seen (bool (n,)), neither too dark nor clipped."""
    red, green, blue = ((rgb[:, i] >= CLIPPED).view(np.uint8) for i in range(3))
    return np.asarray(seen & (_brightest(rgb) >= DARK) & (red + green + blue < 2))


def unfitted(suit: Suit) -> ColorModel:
    """Model of a palette in the expected light, before any colour has been seen."""
    names = [part.name for part in BODY_PARTS]
    wears = [np.isin(names, PARTS[part].name) for part in suit.parts]
    wears += [np.isin(names, worn) for _, worn in BARE]
    palette = chromaticity(np.concatenate([suit.colors_rgb, np.array([rgb for rgb, _ in BARE])]))
    bare = np.arange(len(palette)) >= len(suit.parts)
    variance = np.full(len(palette), SIGMA**2)
    model = ColorModel(
        palette, palette, np.zeros((len(palette), 2, 2)), variance, np.array(wears), bare, GAIN
    )
    return under(model, GAIN)


def under(model: ColorModel, log_gain: Float64) -> ColorModel:
    """Model of a palette in the light of log gains (2,), before any colour has been seen."""
    model = replace(model, log_gain=log_gain)
    fading = model.fading
    return replace(model, shift=FADE * fading, unknown=_strays(fading))


def refit_colors(model: ColorModel, rgb: UInt8, belief: Float64) -> ColorModel:
    """Model fitted by expectation maximisation to colours uint8 (n, 3) of parts with beliefs (n, 11)."""
    some = evenly(len(rgb))
    rgb, prior = rgb[some], (model.wears @ belief[some].T).astype(np.float32)
    chroma, noise = chromaticity(rgb), blur(rgb)
    for _ in range(FIT_ROUNDS):
        match = np.exp(model.match(chroma, noise)) * prior
        share = match / (match.sum(axis=0) + STRAY)
        weight = share / (noise**2 + model.variance[:, None])
        model = replace(model, log_gain=_fitted_gain(model, chroma, weight))
        model = _fitted_swatches(model, chroma, share)
    return model


def evenly(count: int) -> slice:
    """Every how many-th of ``count`` colours are an even sample, ``MOST_COLORS`` at most."""
    return slice(None, None, -(-count // MOST_COLORS))


def blur(rgb: UInt8) -> Float64:
    """Standard deviation (n,) of the chromaticity of colours uint8 (n, 3), by darkness."""
    return np.asarray(NOISE_RGB / np.maximum(_brightest(rgb), 1.0))


def _brightest(rgb: UInt8) -> UInt8:
    """Highest channel (n,) of colours (n, 3); written out, as numpy is slow along short axes."""
    return np.maximum(np.maximum(rgb[:, 0], rgb[:, 1]), rgb[:, 2])


def _fitted_gain(model: ColorModel, chroma: Float64, weight: Float64) -> Float64:
    """Log gains (2,) after one Gauss-Newton step; weight: (K, n), responsibility over variance."""
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
    """Model with each swatch's shift and spread fitted to its share (K, n) of the colours (n, 2).

    A shift's prior is a normal distribution drawn out towards the light's chromaticity, for cloth fades.
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
    """Covariance (..., 2, 2) of the swatches' shifts of fading (..., 2) before any colour is seen."""
    return FADE_SIGMA**2 * fading[..., :, None] * fading[..., None, :] + HUE_SIGMA**2 * np.eye(2)
