"""Track ids of persons over a recording: detections are assigned to tracks by place and speed.

The Hungarian method chooses the assignment of least cost (Kuhn 1955). A track without a detection stays open
for ``LOST_S`` seconds of the recording. A detection is shown if it is sure or continues a shown track; a less
sure one is shown from its second frame on, because most false detections last one frame. In a frame that
continues no track of a person shown just before, as in a folder of unrelated images, likely ones are shown.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from annotate.array_types import Float64
from annotate.person.detection.finder import Person
from annotate.person.detection.odds import LIKELY_ODDS, SURE_ODDS
from annotate.person.detection.votes import MOST_PERSONS

LOST_S = 2.0
USUAL_S = 1 / 30  # between frames without times
PLACE_M, SPEED_M_S = 0.25, 0.5  # standard deviations of a predicted place: at once, and more a second
MOST_ERROR = 3.5  # of a predicted place, standard deviations
NEW_PERSON = 20.0  # -2 log likelihood of a place without a track
SPEED_S = 0.6  # decay of the earlier speed
MOST_TRACKS = 2 * MOST_PERSONS  # of a note: shown in earlier frames, and in the last one
FARTHEST = 1e4  # metres or metres a second, of a note's place or speed
MOST_AHEAD_S = 0.3  # for which a lost person's speed holds


@dataclass(frozen=True)
class Track:
    """Person over frames: id, 0 = not shown yet; last detected centre (3,) and speed (3,), depth camera's
    frame; time of the last detection.
    """

    number: int
    at_m: Float64
    m_per_s: Float64
    seen_ns: int

    def expected_m(self, seconds: float) -> Float64:
        """Return the centre (3,) expected some seconds after the last detection."""
        return np.asarray(self.at_m + self.m_per_s * min(seconds, MOST_AHEAD_S))

    def seen_again(self, at_m: Float64, seen_ns: int) -> "Track":
        """Return the track after another detection."""
        seconds = max(_seconds(self.seen_ns, seen_ns), 1e-3)
        share = 1 - np.exp(-seconds / SPEED_S)
        m_per_s = self.m_per_s + share * ((at_m - self.at_m) / seconds - self.m_per_s)
        return replace(self, at_m=at_m, m_per_s=m_per_s, seen_ns=seen_ns)


@dataclass(frozen=True)
class Tracks:
    """Open tracks after a frame. stamp_ns: time of the frame. latest: id given last."""

    stamp_ns: int
    tracks: tuple[Track, ...] = ()
    latest: int = 0

    def note(self) -> dict[str, Any]:
        """Return the tracks as a note of the frame: millimetres, mm/s."""
        rows = [
            {
                "id": track.number,
                "at_mm": np.rint(1000 * track.at_m).astype(int).tolist(),
                "mm_per_s": np.rint(1000 * track.m_per_s).astype(int).tolist(),
                "seen_ns": track.seen_ns,
            }
            for track in self.tracks
        ]
        return {"stamp_ns": self.stamp_ns, "latest": self.latest, "tracks": rows}

    @classmethod
    def of(cls, notes: Mapping[str, Any]) -> "Tracks | None":
        """Return the tracks in a frame's notes, None without any or with malformed ones."""
        try:
            note = notes["people"]
            tracks = [
                Track(
                    int(row["id"]),
                    np.array(row["at_mm"], np.float64).reshape(3) / 1000,
                    np.array(row["mm_per_s"], np.float64).reshape(3) / 1000,
                    int(row["seen_ns"]),
                )
                for row in note["tracks"]
            ]
            found = cls(int(note["stamp_ns"]), tuple(tracks), int(note["latest"]))
        except (TypeError, KeyError, ValueError, OverflowError):
            return None
        return found if found._is_possible() else None

    def _is_possible(self) -> bool:
        """Return whether all ids, places, speeds and times are within bounds."""
        ids = (self.latest, *(track.number for track in self.tracks))
        times = (self.stamp_ns, *(track.seen_ns for track in self.tracks))
        moves = [values for track in self.tracks for values in (track.at_m, track.m_per_s)]
        return (
            len(self.tracks) <= MOST_TRACKS
            and all(0 <= number <= MOST_PERSONS for number in ids)
            and all(abs(time) < 2**63 for time in times)
            and all((np.abs(values) <= FARTHEST).all() for values in moves)
        )


class Sightings:
    """Detections of a frame, assigned to the tracks of the frame before.

    people: detected in the frame. earlier: None in the first frame. stamp_ns: time of the frame, None =
    ``USUAL_S`` after the frame before.
    """

    def __init__(self, people: Sequence[Person], earlier: Tracks | None, stamp_ns: int | None) -> None:
        if stamp_ns is None:
            stamp_ns = earlier.stamp_ns + round(USUAL_S * 1e9) if earlier else 0
        if earlier is not None and stamp_ns < earlier.stamp_ns:
            earlier = None  # another recording, or one from its start again
        self._people, self._stamp_ns, self._latest = people, stamp_ns, earlier.latest if earlier else 0
        self._open = [t for t in earlier.tracks if _seconds(t.seen_ns, stamp_ns) <= LOST_S] if earlier else []
        self._track_of = assigned([person.centre_m for person in people], self._open, stamp_ns)
        is_first = self._is_new_scene(earlier)
        self.shown = [self._is_shown(i, is_first) for i in range(len(people))]
        """Flag of each person."""

    def _is_new_scene(self, earlier: Tracks | None) -> bool:
        """Return whether no one is from the frame before: the first frame, a gap, or an unrelated image."""
        if earlier is None or _seconds(earlier.stamp_ns, self._stamp_ns) > LOST_S:
            return True
        return not self._track_of and any(
            track.number > 0 and track.seen_ns == earlier.stamp_ns for track in self._open
        )

    def _is_shown(self, i: int, is_first: bool) -> bool:
        odds, track = self._people[i].odds, self._track_of.get(i)
        if odds >= SURE_ODDS or (track is not None and self._open[track].number > 0):
            return True
        return odds >= LIKELY_ODDS and (is_first or track is not None)

    def numbered(self, subject: int | None) -> tuple[list[int], Tracks]:
        """Return the id of each person, 0 for those not shown, and the open tracks.

        subject: index of the person with id 1; None = ids by track alone.
        """
        ids = _Ids({track.number for track in self._open}, self._latest)
        given = {i: self._open[k].number for i, k in self._track_of.items()}
        renamed = {}
        if subject is not None and given.get(subject) != 1:
            # An earlier subject becomes another person.
            renamed = {1: ids.next()} if 1 in ids.taken else {}
            given = {i: renamed.get(number, number) for i, number in given.items()} | {subject: ids.first()}
        for i, shown in enumerate(self.shown):
            if shown and not given.get(i):
                given[i] = ids.next()
        numbers = [given.get(i, 0) for i in range(len(self._people))]
        return numbers, Tracks(self._stamp_ns, (*self._lost(renamed), *self._seen(numbers)), ids.latest)

    def _lost(self, renamed: Mapping[int, int]) -> Iterator[Track]:
        for k, track in enumerate(self._open):
            if k not in self._track_of.values() and track.number > 0:
                yield replace(track, number=renamed.get(track.number, track.number))

    def _seen(self, numbers: Sequence[int]) -> Iterator[Track]:
        for i, (person, number) in enumerate(zip(self._people, numbers, strict=True)):
            if i in self._track_of:
                track = self._open[self._track_of[i]].seen_again(person.centre_m, self._stamp_ns)
                yield replace(track, number=number)
            else:
                yield Track(number, person.centre_m, np.zeros(3), self._stamp_ns)


class _Ids:
    """Ids of new persons. taken: ids of open tracks; latest: id given last."""

    def __init__(self, taken: set[int], latest: int) -> None:
        self.taken, self.latest = taken, latest

    def first(self) -> int:
        """Take id 1."""
        self.latest = max(self.latest, 1)
        self.taken.add(1)
        return 1

    def next(self) -> int:
        """Take an id that no person had; after ``MOST_PERSONS`` persons the least free one."""
        self.latest = min(self.latest + 1, MOST_PERSONS)
        free = (number for number in range(1, MOST_PERSONS) if number not in self.taken)
        number = next(free, MOST_PERSONS) if self.latest in self.taken else self.latest
        self.taken.add(number)
        return number


def assigned(places_m: Sequence[Float64], tracks: Sequence[Track], stamp_ns: int) -> dict[int, int]:
    """Return the index of the track of each place (3,) that continues one.

    The assignment is the likeliest. A place farther than ``MOST_ERROR`` from all tracks starts one.
    """
    if not places_m or not tracks:
        return {}
    gaps_s = [_seconds(track.seen_ns, stamp_ns) for track in tracks]
    expected_m = np.array([track.expected_m(gap) for track, gap in zip(tracks, gaps_s, strict=True)])
    spread_m = np.array([np.hypot(PLACE_M, SPEED_M_S * gap) for gap in gaps_s])
    errors = np.linalg.norm(np.array(places_m)[:, None] - expected_m, axis=-1) / spread_m
    unlikely = np.square(errors) + 6 * np.log(spread_m / PLACE_M)  # -2 log likelihood in three dimensions
    near = errors < MOST_ERROR
    rows, columns = linear_sum_assignment(np.where(near, unlikely, NEW_PERSON))
    return {int(i): int(k) for i, k in zip(rows, columns, strict=True) if near[i, k]}


def _seconds(earlier_ns: int, later_ns: int) -> float:
    return (later_ns - earlier_ns) * 1e-9
