"""What a label set's corrections teach: frames as they were at first, and the parts that people gave."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from annotate.array_types import Int64
from annotate.correction.correction import Correction
from annotate.crop import person_of
from annotate.frame_labels import FrameLabels
from annotate.parts import on_body
from eval.network.predict import check_alone
from sensors.errors import CloudError

LEAST_FRAMES = 3
"""Corrected frames from which anything is learnt: fewer show one side of the person. Untuned."""
HELD_OUT = 4
"""Number of corrected frames of which one is held out, because a measure needs frames that were not learnt.
Untuned."""


@dataclass(frozen=True)
class Taught:
    """A frame that a person has finished.

    first: its labels before all work; corrected: as they are now; place: its number in the label set.
    """

    first: FrameLabels
    corrected: FrameLabels
    place: int


def lessons(path: Path) -> list[Taught]:
    """The frames of a label set that people have accepted or reviewed, in order.

    Raises CloudError where they are too few, or where everybody is labelled.
    """
    with Correction.open(path, read_only=True) as correction:
        check_alone(correction.labels)
        labels = correction.labels
        ids = enumerate(labels.frame_ids)
        done = [(n, i) for n, i in ids if correction.state(i) in ("accepted", "reviewed")]
        found = (
            Taught(labels.read(i, original=labels.has_original(i)), correction.frame(i), n) for n, i in done
        )
        taught = [one for one in found if _shows_parts(one)]
    if len(taught) < LEAST_FRAMES:
        raise CloudError(
            f"{_frames(len(taught))} of {path.name} accepted; accept at least {LEAST_FRAMES} with fix"
        )
    return taught


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"


def _shows_parts(taught: Taught) -> bool:
    there = person_of(taught.first.parts) & (taught.first.depth_mm > 0)
    return bool((there & on_body(taught.corrected.parts)).any())


def divided(taught: Sequence[Taught]) -> tuple[list[Taught], list[Taught]]:
    """Return frames to learn from, and frames to measure on: one at least, of two and more.

    The frames to measure on follow each other, and lie as far from the others in time as possible: the
    neighbour of a frame that was learnt shows nearly the same picture, and would flatter.
    """
    count = max(1, len(taught) // HELD_OUT)
    places = np.array([one.place for one in taught])
    first = max(range(len(taught) - count + 1), key=lambda at: _mean_gap(places, at, count))
    held = range(first, first + count)
    return [one for n, one in enumerate(taught) if n not in held], [taught[n] for n in held]


def _mean_gap(places: Int64, first: int, count: int) -> float:
    """Return the mean distance, in frames, of places [first, first + count) from the nearest other one."""
    inside = places[first : first + count]
    others = np.concatenate([places[:first], places[first + count :]])
    return float(np.abs(inside[:, None] - others).min(axis=1).mean()) if len(others) else 0.0
