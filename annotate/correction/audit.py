"""Audit of a label set: the work of each person, from the journal."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from annotate.array_types import UInt8
from annotate.correction.replay import after, begun_from, is_stroke, rejection, step_of, verdicts
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import Stroke
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from sensors.files.natural_order import in_order


@dataclass(frozen=True)
class PartWork:
    """Work on one part: number of strokes, their active seconds, and numbers of pixels that the part gained
    and lost in the final labels.
    """

    strokes: int
    seconds: float
    gained_px: int
    lost_px: int


@dataclass(frozen=True)
class PersonWork:
    """Work of one person on a label set.

    first, last: times of the work, ISO 8601 UTC, "" if unknown. frames, accepted: numbers of edited frames
    and of accepted frames. accepted_untouched: share of accepted frames with unchanged first labels.
    seconds_median, seconds_p90: active seconds per frame. seconds: active seconds by activity. changed: share
    of labelled pixels that the person changed last, unless they regained their first part. parts: by name.
    """

    who: str
    first: str
    last: str
    frames: int
    accepted: int
    accepted_untouched: float
    seconds_median: float
    seconds_p90: float
    seconds: dict[str, float]
    strokes: int
    undos: int
    operations: dict[str, int]
    changed: float
    parts: dict[str, PartWork]


@dataclass(frozen=True)
class WorkedFrame:
    """Active seconds of all people on a frame. step: fine-tuning step that labelled the frame, or ""."""

    frame_id: str
    seconds: float
    step: str


@dataclass(frozen=True)
class Audit:
    """Work on a label set.

    people: the person with most frames first. rejected: reason by frame id. course: worked frames in the
    order of their last strokes.
    """

    people: tuple[PersonWork, ...]
    rejected: dict[str, str]
    course: tuple[WorkedFrame, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the audit as JSON values, without the list of worked frames (``course``)."""
        return {"people": [asdict(person) for person in self.people], "rejected": self.rejected}


@dataclass(frozen=True)
class _Visit:
    """Entries of one person on one frame. before, after: uint8 (n,), old and new parts of pixels that this
    person changed last.
    """

    strokes: tuple[Stroke, ...]
    before: UInt8
    after: UInt8
    body_px: int
    untouched: bool
    accepted: bool


def audit(labels: LabelSet, journal: Journal) -> Audit:
    """Return the work of each person on a label set. Raises FormatError for a corrupt journal or frame."""
    visits: defaultdict[str, list[_Visit]] = defaultdict(list)
    rejected, course = {}, []
    for frame_id in in_order(set(labels.frame_ids) & set(journal.frame_ids)):
        strokes, first = journal.strokes(frame_id), labels.read(frame_id, labels.has_original(frame_id))
        before = begun_from(first, strokes)
        step = step_of(strokes) or ""
        strokes = [stroke for stroke in strokes if stroke.operation != "relabel"]
        if any(stroke.by_person for stroke in strokes):
            seconds = sum(stroke.active_seconds for stroke in strokes)
            course.append((max(s.when for s in strokes if s.by_person), WorkedFrame(frame_id, seconds, step)))
        for who, visit in _visits(strokes, before.parts, after(before, strokes, exact=True).parts):
            visits[who].append(visit)
        if (reason := rejection(strokes)) is not None:
            rejected[frame_id] = reason
    people = [_person(who, of_person, labels.scheme) for who, of_person in visits.items()]
    people.sort(key=lambda person: (-person.frames, person.who))
    by_time = tuple(worked for _, worked in sorted(course, key=lambda entry: entry[0]))
    return Audit(tuple(people), rejected, by_time)


def _visits(strokes: Sequence[Stroke], before: UInt8, after: UInt8) -> Iterator[tuple[str, _Visit]]:
    """Yield the work of each person on a frame; a changed pixel belongs to the last person who changed it."""
    names = list(dict.fromkeys(stroke.who for stroke in strokes))
    last = np.zeros(before.size, np.intp)
    for stroke in strokes:
        last[stroke.pixels] = names.index(stroke.who)
    changed = (before != after).ravel()
    body_px = int(((before != BACKGROUND) | (after != BACKGROUND)).sum())
    accepting = {verdict.who for verdict in verdicts(strokes) if verdict.operation == "accept"}
    for number, who in enumerate(names):
        own = tuple(stroke for stroke in strokes if stroke.who == who)
        at = np.flatnonzero(changed & (last == number))
        parts = before.ravel()[at], after.ravel()[at]
        yield who, _Visit(own, *parts, body_px, not changed.any(), who in accepting)


def _person(who: str, visits: Sequence[_Visit], scheme: Scheme) -> PersonWork:
    strokes = [stroke for visit in visits for stroke in visit.strokes]
    seconds = [sum(stroke.active_seconds for stroke in visit.strokes) for visit in visits]
    accepted = [visit for visit in visits if visit.accepted]
    by_kind = Counter[str]()
    for stroke in strokes:
        by_kind.update(stroke.seconds)
    operations = Counter(stroke.operation for stroke in strokes)
    when = sorted(stroke.when for stroke in strokes if stroke.when)
    return PersonWork(
        who=who,
        first=when[0] if when else "",
        last=when[-1] if when else "",
        frames=len(visits),
        accepted=len(accepted),
        accepted_untouched=_share(sum(visit.untouched for visit in accepted), len(accepted)),
        seconds_median=round(float(np.median(seconds)), 3),
        seconds_p90=round(float(np.quantile(seconds, 0.9)), 3),
        seconds={kind: round(total, 3) for kind, total in sorted(by_kind.items())},
        strokes=sum(map(is_stroke, strokes)),
        undos=operations["undo"],
        operations=dict(sorted(operations.items())),
        changed=_share(sum(len(v.after) for v in visits), sum(v.body_px for v in visits)),
        parts=_by_part(strokes, visits, scheme),
    )


def _by_part(strokes: Sequence[Stroke], visits: Sequence[_Visit], scheme: Scheme) -> dict[str, PartWork]:
    gained = sum((np.bincount(v.after, minlength=256) for v in visits), np.zeros(256, np.int64))
    lost = sum((np.bincount(v.before, minlength=256) for v in visits), np.zeros(256, np.int64))
    given = [stroke for stroke in strokes if is_stroke(stroke)]
    work = {}
    for name, part in {**scheme.part_id, "undefined": UNDEFINED}.items():
        own = [stroke for stroke in given if stroke.part == part]
        seconds = round(sum(stroke.active_seconds for stroke in own), 3)
        if own or gained[part] or lost[part]:
            work[name] = PartWork(len(own), seconds, int(gained[part]), int(lost[part]))
    return work


def _share(some: int, of: int) -> float:
    return round(some / of, 6) if of else 0.0
