"""Small label sets of a drawn figure that moves to its left, for windows that open quickly."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from annotate.correction.correction import Correction
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from bench.window import figure
from sensors.rig.camera import Intrinsics

SHAPE = (212, 256)
CAMERA = Intrinsics(SHAPE[1], SHAPE[0], 183.0, 183.0, 128.0, 106.0)


def figure_set(
    path: Path,
    confidences: Sequence[float],
    step_m: float = 0.01,
    instead: Mapping[int, int] | None = None,
    scheme: Scheme = PAPER,
) -> LabelSet:
    """Write a set of a frame for each mean confidence.

    step_m: the figure's way between two frames. instead: by part of the paper, the part that it is mistaken
    for. scheme: of the set; the paper's parts are divided into their regions from the top down.
    """
    labels = LabelSet.create(path, CAMERA, scheme_note(scheme))
    for i, mean in enumerate(confidences):
        depth, parts = figure(*SHAPE, step_m * i)
        for part, other in (instead or {}).items():
            parts[parts == part] = other
        parts = scheme.table[regions_of(parts)]
        sure = np.full(SHAPE, mean, np.float32)
        labels.write(FrameLabels(f"{i:06d}", depth, parts, sure, notes={"confidence": mean}, scheme=scheme))
    return labels


def regions_of(parts: np.ndarray) -> np.ndarray:
    """Return region ids (h, w) of parts of the paper: bands of equal height, from the top down."""
    regions = np.zeros_like(parts)
    for part in PAPER.parts:
        own = sorted(part.regions)
        v, u = np.nonzero(parts == part.id)
        if len(v):
            band = (v - v.min()) * len(own) // (v.max() - v.min() + 1)
            regions[v, u] = np.array(own, np.uint8)[band]
    return regions


def judge(path: Path, who: str, **verdicts: str) -> None:
    """Give verdicts to frames by their numbers: ``f3="accept"``, or else the reason of a rejection."""
    with Correction.open(path, who) as correction:
        for number, verdict in verdicts.items():
            editor = correction.edit(f"{int(number[1:]):06d}")
            editor.judge("accept") if verdict == "accept" else editor.judge("reject", verdict)
