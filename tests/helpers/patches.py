"""Label maps of patches in any scheme, with errors, from integers of a seed alone."""

from pathlib import Path

import numpy as np

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.parts import PAPER
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from sensors.rig.camera import Intrinsics

CAMERA = Intrinsics(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)


def patches(seed: int, ids: tuple[int, ...]) -> np.ndarray:
    """Nearest-seed patches uint8 (48, 64), three of each id."""
    rng = np.random.default_rng(seed)
    seeds = rng.integers(0, 64, (3 * len(ids), 2))
    v, u = np.mgrid[:48, :64]
    nearest = ((v[..., None] - seeds[:, 0]) ** 2 + (u[..., None] - seeds[:, 1]) ** 2).argmin(-1)
    return np.array(ids, np.uint8)[nearest % len(ids)]


def pair(seed: int, scheme: Scheme = PAPER) -> tuple[FrameLabels, FrameLabels]:
    """A prediction and its truth: shifted, a third of it of other patches, with a confidence."""
    ids = (BACKGROUND, BACKGROUND, *(part.id for part in scheme.parts), UNDEFINED)
    truth, noise, rng = patches(seed, ids), patches(100 + seed, ids), np.random.default_rng(1000 + seed)
    guess = np.roll(truth, int(rng.integers(0, 3)), axis=1)
    guess[:16] = noise[:16]
    depth = (1500 + 100 * (seed % 4) + np.arange(64)).astype(np.uint16) * np.ones((48, 1), np.uint16)
    sure = (rng.integers(0, 256, guess.shape) / 255).astype(np.float32)
    name = ("anna", "ben", "cem", "")[seed % 4]
    frame_id, notes = f"{seed:06d}", {"activity": "reading"}
    return (
        FrameLabels(frame_id, depth, guess, sure, subject=name, scheme=scheme),
        FrameLabels(frame_id, depth, truth, None, "truth", name, notes, scheme=scheme),
    )


def write_set(path: Path, frames: list[FrameLabels]) -> LabelSet:
    """A label set of frames of one scheme."""
    labels = LabelSet.create(path, CAMERA, scheme_note(frames[0].scheme))
    for frame in frames:
        labels.write(frame)
    return labels
