"""Fit the weights of annotate/person/clothed_mask.py to simulated sessions: WEIGHTS, KEPT and BY_TOUCH.

python -m tools.fit_worn SESSION.mcap...
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np

from annotate.parts import BACKGROUND, UNDEFINED
from annotate.person import clothed_mask, extract
from annotate.suit.palette import load_suit
from synth.rig.simulate import suit_path
from tools.fit_confidence import clouds

MOST_PIXELS, PIXELS_PER_WITNESS = 600, 100
"""A patch counts for its pixels, at most for the first, each of the second one witness."""
RIDGE, STEPS = 1.0, 30


@dataclass(frozen=True)
class Seen:
    """Clues of a frame's patches, and of each (R,) how many pixels are known and what share is a person's."""

    clues: clothed_mask.Clues
    pixels: np.ndarray
    share: np.ndarray


def observed(path: Path) -> list[Seen]:
    """What ``worn`` had to go by in a session's frames, and what was true."""
    seen, suit, asked = [], load_suit(suit_path(path)), clothed_mask.worn
    for cloud, parts in clouds(path):

        def keep(*given, parts=parts):
            if (known := clothed_mask.clues(*given)) is not None:
                counted, count = (parts != UNDEFINED)[known.own], len(known.inside)
                person = counted & (parts != BACKGROUND)[known.own]
                pixels = np.bincount(known.patch, counted, count)
                share = np.bincount(known.patch, person, count) / np.maximum(pixels, 1)
                seen.append(Seen(known, pixels, share))
            return asked(*given)

        with patch.object(extract, "worn", keep):
            extract.extract_person(cloud, None, None, suit)
    return seen


def fitted(clues: np.ndarray, share: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Weights (k,) of clues (n, k), the last of them 1: logistic regression by Newton's method."""
    spread = np.append(clues[:, :-1].std(axis=0) + 1e-9, 1)
    scaled, weight = clues / spread, np.minimum(pixels, MOST_PIXELS) / PIXELS_PER_WITNESS
    ridge, weights = RIDGE * np.diag([1.0] * (clues.shape[1] - 1) + [0.0]), np.zeros(clues.shape[1])
    for _ in range(STEPS):
        chance = 1 / (1 + np.exp(-np.clip(scaled @ weights, -30, 30)))
        curve = (scaled * (weight * chance * (1 - chance))[:, None]).T @ scaled
        slope = scaled.T @ (weight * (share - chance)) - ridge @ weights
        weights += np.linalg.solve(curve + ridge + 1e-6 * np.eye(len(ridge)), slope)
    return weights / spread


def main(seen: list[Seen]) -> None:
    """Print the weights of patches in the mask and off it, and of own odds and their neighbours'."""
    clues, inside, share, pixels = (
        np.concatenate(column)
        for column in zip(*((s.clues.told, s.clues.inside, s.share, s.pixels) for s in seen), strict=True)
    )
    known = pixels > 0
    rows = [fitted(clues[m], share[m], pixels[m]) for m in (inside & known, ~inside & known)]
    print("WEIGHTS", *(row.round(2).tolist() for row in rows))
    own, around = [], []
    for s in seen:
        odds = (s.clues.told * np.array(rows)[np.where(s.clues.inside, 0, 1)]).sum(axis=1)
        own.append(odds)
        around.append(
            (clothed_mask.heard(s.clues.patches, odds) - clothed_mask.KEPT * odds) / clothed_mask.BY_TOUCH
        )
    heard = np.column_stack([np.concatenate(own), np.concatenate(around), np.ones(len(share))])
    print("KEPT, BY_TOUCH, 1", fitted(heard[known], share[known], pixels[known]).round(2).tolist())


if __name__ == "__main__":
    main([one for name in sys.argv[1:] for one in observed(Path(name))])
