"""Marker sets: position of each named marker on the body, and selection of a recording's markers by a set.

Constants are untuned unless a source is given.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from annotate.array_types import Bool, Float64, Int64
from sensors.errors import CloudError, FormatError, Setting
from sensors.files.bounded import read_toml
from synth.body.skeleton import JOINT_ID, shortest_arc
from synth.data_files import shipped
from synth.motion_files.marker_files import UNITS_M, Markers
from synth.motion_files.vertical_axis import MIRROR_LINE, direction, find_vertical, is_mirrored

MIN_MARKERS = 8  # known names that a set needs to fit a recording
MAX_FILE_BYTES = 1_000_000  # shipped sets have 5 kB at most
DEFAULT_SPREAD_MM = 30.0
PERSON_M = (0.5, 3.0)  # least and greatest diagonal of the box about a person's markers
SAME_PERSON = 0.12  # share by which distances of markers on one bone differ between two people
FAR_M = 100.0  # farthest coordinate in a capture room
SHARED = 0.8  # share of names with one beginning, the file's prefix; a root or force plate may lack it
_SIDE = re.compile(r"(left|right|l|r)", re.IGNORECASE)


@dataclass(frozen=True)
class MarkerSet:
    """Positions of M markers on a body 1.70 m tall in anatomical zero.

    joint: int64 (M,) the joint of each marker. at_m: (M, 3) metres from the joint, x to the person's left, y
    back, z up. spread_m: (M,) standard deviation of that position. weight: (M,). also: other names of
    markers, by the key of the name (see ``key_of``). note: remark on solutions.
    """

    name: str
    names: tuple[str, ...]
    joint: Int64
    at_m: Float64
    spread_m: Float64
    weight: Float64
    also: dict[str, tuple[str, ...]] = field(default_factory=dict)
    note: str = ""

    @cached_property
    def places(self) -> dict[str, int]:
        """Return the index of the marker by the key of each of its names."""
        known = {key_of(name): place for place, name in enumerate(self.names)}
        others = {key_of(other): known[key] for key, spellings in self.also.items() for other in spellings}
        return others | known

    def columns(self, labels: Sequence[str]) -> list[int | None]:
        """Return for each label the index of its marker, None for unknown labels."""
        keys = zip(map(key_of, labels), map(key_of, without_prefix(labels, "_- .")), strict=True)
        return [self.places.get(whole, self.places.get(short)) for whole, short in keys]


def load_marker_set(path: Path) -> MarkerSet:
    """Read a marker-set file (TOML). Raises FormatError with the name of the wrong entry."""
    content = read_toml(path, MAX_FILE_BYTES, "give a marker-set file (TOML)")
    markers = content.get("markers")
    if not isinstance(markers, dict) or not markers:
        raise FormatError(f"marker set {path} has no table [markers] with entries; add it")
    rows = [_place(path, name, entry) for name, entry in markers.items()]
    also = {key_of(name): _also(path, name, entry) for name, entry in markers.items() if "also" in entry}
    keys = [key_of(name) for name in (*markers, *(other for others in also.values() for other in others))]
    if twice := next((key for key in keys if keys.count(key) > 1), ""):
        raise FormatError(
            f"marker set {path} names {twice!r} twice (case and punctuation do not count); rename one"
        )
    joint, at, spread, weight = zip(*rows, strict=True)
    return MarkerSet(
        str(content.get("name", path.stem)),
        tuple(markers),
        np.array(joint, np.int64),
        np.array(at, float),
        np.array(spread, float) / 1000,
        np.array(weight, float),
        also,
        str(content.get("note", "")),
    )


def _also(path: Path, name: str, entry: dict[str, object]) -> tuple[str, ...]:
    also = entry["also"]
    if not isinstance(also, list) or not all(isinstance(other, str) for other in also):
        raise FormatError(
            f'marker set {path}: other names of {name} are not a list; give also = ["LeftKnee"]'
        )
    return tuple(also)


def _place(path: Path, name: str, entry: object) -> tuple[int, list[float], float, float]:
    try:
        assert isinstance(entry, dict)
        joint, at = JOINT_ID[entry["joint"]], [float(v) for v in entry["at_m"]]
        spread, weight = float(entry.get("spread_mm", DEFAULT_SPREAD_MM)), float(entry.get("weight", 1.0))
        assert len(at) == 3 and all(abs(v) <= 1 for v in at) and 0 < spread <= 1000 and 0 < weight <= 100
    except (AssertionError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(
            f"marker set {path}: {name} is not a place; give "
            '{ joint = "left_knee", at_m = [0.05, 0, 0], spread_mm = 30, weight = 1 }'
        ) from error
    return joint, at, spread, weight


@cache
def shipped_marker_sets() -> tuple[MarkerSet, ...]:
    """Return the sets of ``synth/data/markersets``."""
    return tuple(load_marker_set(path) for path in sorted(shipped("markersets").glob("*.toml")))


def choose_marker_set(labels: tuple[str, ...]) -> MarkerSet:
    """Return the shipped set with most of the labels. Raises CloudError when no set has enough."""

    def known(markers: MarkerSet) -> int:
        return len(set(markers.columns(labels)) - {None})

    best = max(shipped_marker_sets(), key=lambda s: (known(s), -len(s.names)))
    if known(best) < MIN_MARKERS:
        shown = ", ".join(labels[:6])
        raise CloudError(f"unknown markers ({shown}, ...); give a marker-set file that describes them")
    return best


@dataclass(frozen=True)
class KnownMarkers:
    """Markers of a set in a recording.

    positions_m: float64 (F, M, 3) world, z up, NaN where not seen, one column per marker of the set. unknown:
    labels outside the set. up: the file's axis that became z. unit: the file's. assumed: sentences on unit,
    axes and repeated labels.
    """

    positions_m: Float64
    unknown: tuple[str, ...]
    up: str
    unit: str
    assumed: tuple[str, ...] = ()

    @property
    def seen(self) -> Bool:
        """Return flags (F, M) of seen markers."""
        return np.asarray(np.isfinite(self.positions_m).all(axis=2))


def known_markers(markers: Markers, markerset: MarkerSet, standing: bool = False) -> KnownMarkers:
    """Return the set's markers of a recording, in metres, z up.

    standing: True if the person stands. A unit that contradicts a person's size is replaced by
    the one that fits, and a vertical axis that contradicts the motion likewise. A mirror image is mirrored
    back. Raises CloudError for too few known or seen markers, or without a fitting unit.
    """
    picked, unknown, twice = _picked(markers, markerset)
    unit, unit_line = _unit(picked, markers.unit)
    picked *= UNITS_M[unit]
    up, vertical = find_vertical(picked, markerset.joint, markerset.at_m, markers.up, standing)
    world = picked @ shortest_arc(direction(up), np.array([0.0, 0.0, 1.0])).T
    world[np.abs(world).max(axis=2) > FAR_M] = np.nan
    mirrored = is_mirrored(world, markerset.joint, markerset.at_m)
    if mirrored:
        world[..., 0] *= -1
    notes = (*((markerset.note,) if markerset.note else ()), *twice, *unit_line, *vertical)
    return KnownMarkers(world, unknown, up, unit, (*notes, *((MIRROR_LINE,) if mirrored else ())))


def _picked(markers: Markers, markerset: MarkerSet) -> tuple[Float64, tuple[str, ...], tuple[str, ...]]:
    """Return positions (F, M, 3) in the file's unit, unknown labels, and sentences on people and repeated
    labels.
    """
    places = markerset.columns(markers.labels)
    frames = np.isfinite(markers.positions).all(axis=2).sum(axis=0)
    others, lines = _other_people(markers.labels, places, frames)
    columns: dict[int, int] = {}
    twice = []
    for column, (label, place) in enumerate(zip(markers.labels, places, strict=True)):
        if place is None or column in others:
            continue
        if place in columns:
            twice.append(label)
        if place not in columns or frames[column] > frames[columns[place]]:
            columns[place] = column
    if len(columns) < MIN_MARKERS:
        raise CloudError(
            f"only {len(columns)} of the {len(markerset.names)} markers of set {markerset.name!r} are in the "
            "recording; give a marker-set file that fits it"
        )
    picked = np.full((len(markers.positions), len(markerset.names), 3), np.nan)
    for place, column in columns.items():
        picked[:, place] = markers.positions[:, column]
    unknown = tuple(label for label, place in zip(markers.labels, places, strict=True) if place is None)
    if twice:
        shown = ", ".join(twice[:4]) + (", ..." if len(twice) > 4 else "")
        line = (
            f"{len(twice)} labels name a marker that another label names ({shown}); the one seen most is used"
        )
        lines = (*lines, line)
    return picked, unknown, lines


def _other_people(
    labels: Sequence[str], places: Sequence[int | None], frames: Int64
) -> tuple[set[int], tuple[str, ...]]:
    """Return the columns of all people except the one seen most, and a sentence on them. frames: number of
    frames of each column.
    """
    people: dict[str, dict[int, int]] = {}
    for column, (label, place) in enumerate(zip(labels, places, strict=True)):
        if place is not None:
            people.setdefault(label.rpartition(":")[0], {})[place] = column
    people = {name: own for name, own in people.items() if len(own) >= MIN_MARKERS}
    if len(people) < 2 or not set.intersection(*map(set, people.values())):
        return set(), ()
    seen = {name: int(frames[list(own.values())].sum()) for name, own in people.items()}
    used = max(people, key=lambda name: seen[name])
    others = {c for c, label in enumerate(labels) if label.rpartition(":")[0] in set(people) - {used}}
    names = ", ".join(repr(name[:40]) for name in people)
    return others, (f"the file holds {len(people)} people ({names}); {used[:40]!r} is used",)


def _unit(positions: Float64, unit: str) -> tuple[str, tuple[str, ...]]:
    """Return the unit of a file, and a sentence where the stated unit is missing or fits no person."""
    span = _span(positions)
    for name in (unit, "m", "cm", "mm"):
        if name in UNITS_M and PERSON_M[0] <= span * UNITS_M[name] <= PERSON_M[1]:
            stated = f"the unit {unit!r} does not fit a person" if unit else "no unit is stated"
            return name, () if name == unit else (f"{stated}; {name} is assumed",)
    raise CloudError(
        f"the markers span {span:.3g} {unit or 'units'}, no person's size in m, cm or mm; scale them"
    )


def _span(positions: Float64) -> float:
    count = np.isfinite(positions).all(axis=2).sum(axis=1)
    full = positions[count >= max(4, 0.8 * count.max())]
    if not len(full):
        raise CloudError(
            "no frame holds four markers of the set; check the marker set, or record again", Setting.MARKERSET
        )
    return float(np.median(np.linalg.norm(np.nanmax(full, axis=1) - np.nanmin(full, axis=1), axis=1)))


def check_same_person(trial: KnownMarkers, static: KnownMarkers, markerset: MarkerSet) -> None:
    """Raise CloudError when distances between markers on one bone differ between trial and static."""
    differences = []
    for joint in np.unique(markerset.joint):
        on_bone = np.flatnonzero(markerset.joint == joint)
        for i, a in enumerate(on_bone):
            for b in on_bone[i + 1 :]:
                here, there = (_distance(t, int(a), int(b)) for t in (trial, static))
                if min(here, there) > 0.08:
                    differences.append(abs(here / there - 1))
    if not differences:
        raise CloudError(
            "the static trial shares too few markers with the trial; give the static of this recording"
        )
    if np.median(differences) > SAME_PERSON / 2 or np.quantile(differences, 0.8) > SAME_PERSON:
        raise CloudError(
            f"the static trial is of another person or other markers: distances on one bone differ by "
            f"{100 * np.median(differences):.0f} % (median); give the static of this recording"
        )


def _distance(trial: KnownMarkers, a: int, b: int) -> float:
    both = trial.seen[:, a] & trial.seen[:, b]
    if not both.any():
        return float("nan")
    return float(np.median(np.linalg.norm(trial.positions_m[both, a] - trial.positions_m[both, b], axis=1)))


def key_of(label: str) -> str:
    """Return a key that is equal for all spellings of a name: without prefix up to the last colon,
    punctuation and case.
    """
    return re.sub(r"[^0-9a-z]", "", label.rpartition(":")[2].casefold())


def without_prefix(labels: Sequence[str], ending: str = "") -> list[str]:
    """Return labels without the part up to a colon and without a common beginning.

    ending: characters that may end a prefix; "" for any prefix except a side ("mixamorig").
    """
    plain = [label.rpartition(":")[2].strip() for label in labels]
    prefix = _shared(plain, ending)
    return [label.removeprefix(prefix) or label for label in plain]


def _shared(labels: Sequence[str], ending: str) -> str:
    """Return the longest prefix that at least the share ``SHARED`` of the labels have in common, or ""."""
    beginning, most = "", max(2, SHARED * len(labels))
    while True:
        following = Counter(
            label[: len(beginning) + 1]
            for label in labels
            if len(label) > len(beginning) and label.startswith(beginning)
        )
        longer, count = max(following.items(), key=lambda pair: pair[1], default=("", 0))
        if count < most:
            break
        beginning = longer
    marks = ending or "_- ."
    prefix = beginning[: 1 + max(beginning.rfind(mark) for mark in marks)]
    if not prefix and not ending and len(beginning) >= 4:
        prefix = beginning
    return "" if _SIDE.fullmatch(prefix.strip(marks)) else prefix
