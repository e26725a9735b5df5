"""Track ids of persons over a recording, by the distance of their centres."""

from collections.abc import Sequence
from itertools import count

import numpy as np

from annotate.frame_labels import FrameLabels
from annotate.person.finder import Person
from annotate.person.votes import MOST_PERSONS

REACH_M = 0.8  # between a person's middles in two frames: half a second of walking; untuned


def assign_track_ids(
    people: Sequence[Person], before: FrameLabels | None, *, subject_first: bool
) -> tuple[list[int], list[list[int]]]:
    """Return the track id of each person of a frame, from 1 on, and all tracks so far.

    A track is [id, x, y, z]: the person's centre when last detected, millimetres, depth camera's frame.
    before: labels of the previous frame. subject_first: the first person gets id 1.
    """
    tracks = {number: at_mm for number, *at_mm in before.notes.get("people", ())} if before else {}
    middles_mm = [np.rint(person.centre_m * 1000).astype(int).tolist() for person in people]
    numbers = {0: 1} if subject_first and people else {}
    away_mm = sorted(
        (float(np.linalg.norm(np.subtract(at_mm, tracks[number]))), i, number)
        for i, at_mm in enumerate(middles_mm)
        for number in tracks
    )
    for far_mm, i, number in away_mm:
        if far_mm < 1000 * REACH_M and i not in numbers and number not in numbers.values():
            numbers[i] = number
    taken = tracks.keys() | set(numbers.values())
    fresh = (number for number in count(1) if number not in taken)
    for i in range(len(people)):
        if i not in numbers:
            numbers[i] = min(next(fresh), MOST_PERSONS)
    tracks |= {numbers[i]: at_mm for i, at_mm in enumerate(middles_mm)}
    return [numbers[i] for i in range(len(people))], [[number, *tracks[number]] for number in sorted(tracks)]
