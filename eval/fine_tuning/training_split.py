"""Corrected frames of a label set, split into folds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from annotate.array_types import Int64
from annotate.correction.correction import Correction
from annotate.correction.frame_kinds import distances_m, farthest_first, thumbnail_m
from annotate.frame_labels import FrameLabels
from eval.network.predict import check_one_person
from eval.training.shared_bodies import bodies_in
from sensors.errors import CloudError

LEAST_FRAMES = 3  # corrected frames; fewer show one side of the person; untuned
FOLDS = 4  # groups of corrected frames, each left out of one training; more take longer; untuned


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


def folds(frames: Sequence[CorrectedFrame]) -> Int64:
    """Return the fold (n,) of each frame, from 0; a fold is left out of a training and measured on.

    With ``FOLDS`` people or more, all frames of a person are in one fold; a blend of two bodies belongs to
    both. With fewer people, a fold holds frames of one kind (`annotate.correction.frame_kinds`), because
    frames of one kind show nearly the same picture.
    """
    people = _people(frames)
    if len(people) >= FOLDS:
        owner = [next(n for n, group in enumerate(people) if not group.isdisjoint(f.bodies)) for f in frames]
        return np.array(owner) % FOLDS
    apart_m = distances_m([thumbnail_m(frame.first.depth_mm) for frame in frames])
    return np.asarray(apart_m[farthest_first(apart_m, FOLDS)].argmin(axis=0), np.int64)


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
