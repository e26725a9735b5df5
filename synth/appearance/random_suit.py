"""Suits: random palettes, to train and test on new colours, and the suits of each cast (set of synthetic
people). Constants are untuned.
"""

import colorsys
from functools import cache

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from annotate.suit.palette import DEFAULT_SUIT, Suit, body_parts, chromaticity, load_suit
from synth.data_files import JUDGE, TRAINING, Cast, shipped

FEWEST = 8  # cloths; parts share cloths where these are fewer than the parts
APART = (0.03, 0.09)  # least distance in chromaticity; see ``palette.MIN_CHROMA_DISTANCE``
GREY, SKIN_NAMED = 0.25, 0.5  # chances of a grey cloth, and of skin in the palette
SKIN_RGB = (201, 143, 115)  # as in ``DEFAULT_SUIT``
DRAWS = 60  # colours drawn until the least distance is halved
CANDIDATES, ORDERS = 6, 200  # colours drawn for each cloth of a scheme's suit, and assignments to parts tried
DOMAIN = {TRAINING: 40, JUDGE: 41}  # key of the random stream


@cache
def judge_suits() -> tuple[Suit, ...]:
    """Return the suits of the judging cast, from ``synth/data/judge/suits``."""
    return tuple(load_suit(path) for path in sorted(shipped("judge", "suits").glob("*.toml")))


def suit_of(cast: Cast, seed: int, scheme: Scheme = PAPER) -> Suit:
    """Return the suit of a recording: the default for the training cast, else a judging suit chosen by the
    seed. The suit of another scheme than ``paper`` is drawn by the seed.
    """
    if scheme != PAPER:
        return random_suit(seed, cast, scheme)
    if cast != JUDGE:
        return DEFAULT_SUIT
    return judge_suits()[seed % len(judge_suits())]


def random_suit(seed: int, cast: Cast = TRAINING, scheme: Scheme = PAPER) -> Suit:
    """Return a suit of a scheme with a random palette.

    In the scheme ``paper`` a suit has at least 8 cloths, at most one a part, and neighbouring parts have
    different cloths. In other schemes each part of the body has its own cloth, and all are apart in
    chromaticity.
    """
    rng = np.random.default_rng((seed, DOMAIN[cast]))
    if scheme != PAPER:
        parts = np.array([part.id for part in body_parts(scheme)], np.uint8)
        return Suit(f"random suit {seed} of {scheme.name}", _apart_cloths(scheme, parts, rng), parts, scheme)
    parts = np.array([part.id for part in PAPER.parts], np.uint8)
    count = int(rng.integers(FEWEST, len(parts) + 1))
    colors = _cloths(count, float(rng.uniform(*APART)), rng)
    cloths = np.concatenate([np.arange(count), rng.choice(count, len(parts) - count, replace=False)])
    cloth = rng.permutation(cloths)
    while any(cloth[a - 1] == cloth[b - 1] for a, b in map(tuple, PAPER.neighbours)):
        cloth = rng.permutation(cloths)
    worn = colors[cloth]
    if rng.random() < SKIN_NAMED:
        worn = np.concatenate([worn, np.array([SKIN_RGB], np.uint8)])
        parts = np.append(parts, PAPER.table[Region.HEAD])
    return Suit(f"random suit {seed}", worn, parts)


def _apart_cloths(scheme: Scheme, parts: UInt8, rng: np.random.Generator) -> UInt8:
    """Draw colours (n, 3) of parts (n,), far in chromaticity from each other and from skin.

    Each colour is the candidate that is farthest from those chosen before (farthest-point sampling). Of
    random assignments to parts the one is chosen whose neighbours and twins are farthest apart.
    """
    count = CANDIDATES * len(parts)
    drawn = np.stack([rng.random(count), *rng.uniform(0.35, 0.95, (2, count))], axis=1)
    colors = 255 * np.array([colorsys.hsv_to_rgb(*one) for one in drawn])
    rgb = np.rint(np.vstack([SKIN_RGB, colors])).astype(np.uint8)
    apart = np.linalg.norm(chromaticity(rgb)[:, None] - chromaticity(rgb)[None], axis=2)
    chosen = [0]
    while len(chosen) <= len(parts):
        chosen.append(int(apart[chosen].min(axis=0).argmax()))
    index = {part: i for i, part in enumerate(parts.tolist())}
    pairs = [*map(tuple, scheme.neighbours), *scheme.twins]
    near = np.array([(index[a], index[b]) for a, b in pairs if a in index and b in index]).reshape(-1, 2)
    orders = [rng.permutation(chosen[1:]) for _ in range(ORDERS)]
    gaps = [apart[order[near[:, 0]], order[near[:, 1]]].min(initial=np.inf) for order in orders]
    return np.asarray(rgb[orders[int(np.argmax(gaps))]])


def _cloths(count: int, apart: float, rng: np.random.Generator) -> UInt8:
    """Draw colours (count, 3) at least ``apart`` in chromaticity; ``apart`` is halved until they fit."""
    found: list[Float64] = [np.full(3, rng.uniform(90, 220))] if rng.random() < GREY else []
    tries = 0
    while len(found) < count:
        tries += 1
        if tries % DRAWS == 0:
            apart /= 2
        hue, saturation, value = rng.random(), rng.uniform(0.35, 0.95), rng.uniform(0.35, 0.95)
        rgb = np.array(colorsys.hsv_to_rgb(hue, saturation, value)) * 255
        gaps = np.linalg.norm(chromaticity(np.array([*found, rgb]))[:-1] - chromaticity(rgb), axis=1)
        if (gaps >= apart).all():
            found.append(rgb)
    return np.rint(found).astype(np.uint8)
