"""Corrected frames of a label set, split into frames to train on and frames to measure on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from annotate.array_types import Int64
from annotate.correction.correction import Correction
from annotate.frame_labels import FrameLabels
from eval.network.predict import check_one_person
from eval.training.shared_bodies import bodies_in
from sensors.errors import CloudError

LEAST_FRAMES = 3  # corrected frames; fewer show one side of the person; untuned
HELD_OUT = 4  # one of this many corrected frames, or people, is held out; untuned


@dataclass(frozen=True)
class CorrectedFrame:
    """Frame that a person has accepted or reviewed.

    first: its labels before any correction. corrected: current labels. place: index in the set. bodies: of
    its person, as from ``eval.training.shared_bodies``.
    """

    first: FrameLabels
    corrected: FrameLabels
    place: int
    bodies: frozenset[str] = frozenset()


def corrected_frames(path: Path) -> list[CorrectedFrame]:
    """Return the accepted and reviewed frames of a label set, in order.

    Raises CloudError where the frames are too few, or where all persons of a frame are labelled.
    """
    with Correction.open(path, read_only=True) as correction:
        labels = correction.labels
        check_one_person(labels)
        found = [
            CorrectedFrame(labels.read(i, original=labels.has_original(i)), correction.frame(i), place)
            for place, i in enumerate(labels.frame_ids)
            if correction.state(i) in ("accepted", "reviewed")
        ]
        found = [replace(frame, bodies=bodies_in(labels, frame.first)) for frame in found]
    usable = [frame for frame in found if _shows_parts(frame)]
    if len(usable) < LEAST_FRAMES:
        raise CloudError(
            f"{path.name} has {len(usable)} accepted frames; accept at least {LEAST_FRAMES} with fix"
        )
    return usable


def _shows_parts(frame: CorrectedFrame) -> bool:
    there = frame.first.on_person & (frame.first.depth_mm > 0)
    return bool((there & frame.corrected.on_body).any())


def split_frames(frames: Sequence[CorrectedFrame]) -> tuple[list[CorrectedFrame], list[CorrectedFrame]]:
    """Return frames to train on, and at least one frame to measure on.

    With ``HELD_OUT`` people or more, all frames of some people are measured on; a blend of two bodies belongs
    to both. With fewer people, consecutive frames are measured on, as far in time from the rest as possible,
    because neighbouring frames show nearly the same picture.
    """
    people = _people(frames)
    if len(people) >= HELD_OUT:
        chosen = set().union(*people[-max(1, len(people) // HELD_OUT) :])
        return [f for f in frames if f.bodies.isdisjoint(chosen)], [
            f for f in frames if not f.bodies.isdisjoint(chosen)
        ]
    count = max(1, len(frames) // HELD_OUT)
    places = np.array([frame.place for frame in frames])
    first = max(range(len(frames) - count + 1), key=lambda at: _mean_gap(places, at, count))
    held = range(first, first + count)
    return [frame for n, frame in enumerate(frames) if n not in held], [frames[n] for n in held]


def _people(frames: Sequence[CorrectedFrame]) -> list[frozenset[str]]:
    """Return disjoint sets of bodies, where all bodies of a frame are in one set; the set with the fewest
    frames is last.
    """
    groups: list[frozenset[str]] = []
    for bodies in dict.fromkeys(frame.bodies for frame in frames):
        apart = [group for group in groups if group.isdisjoint(bodies)]
        joined = bodies.union(*(group for group in groups if not group.isdisjoint(bodies)))
        groups = [*apart, joined]
    return sorted(groups, key=lambda group: -sum(not f.bodies.isdisjoint(group) for f in frames))


def _mean_gap(places: Int64, first: int, count: int) -> float:
    """Return the mean distance of a block of frames from the nearest frame outside, in frames.

    places: (n,), ascending frame numbers in the set. The block is ``places[first : first + count]``.
    """
    inside = places[first : first + count]
    others = np.concatenate([places[:first], places[first + count :]])
    return float(np.abs(inside[:, None] - others).min(axis=1).mean()) if len(others) else 0.0
