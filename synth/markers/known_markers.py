"""Markers of a recording that a marker set has: places (F, M, 3) in metres, z up."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, Float64
from sensors.errors import CloudError
from synth.body.skeleton import JOINTS, shortest_arc
from synth.markers.marker_files import UNITS_M, Markers
from synth.markers.markerset import MIN_MARKERS, MarkerSet, key_of

PERSON_M = (0.5, 3.0)
"""Diagonal of the box about a person's markers in any posture, metres: least and most. Chosen by eye."""
SAME_PERSON = 0.12
"""Share by which distances of markers on one bone differ between two people. Chosen by eye."""
FAR_M = 100.0
"""Farthest coordinate of a marker in a capture room, metres. Chosen by eye."""
_UPPER = ("head", "spine_upper", "left_clavicle", "right_clavicle")
_LOWER = ("left_ankle", "right_ankle", "left_knee", "right_knee")


@dataclass(frozen=True)
class KnownMarkers:
    """positions_m: float64 (F, M, 3) world, z up, NaN where not seen, one column per marker of the set;
    unknown: labels that the set does not know."""

    positions_m: Float64
    unknown: tuple[str, ...]

    @property
    def seen(self) -> Bool:
        """Flags (F, M) of the markers that a frame holds."""
        return np.asarray(np.isfinite(self.positions_m).all(axis=2))


def known_markers(markers: Markers, markerset: MarkerSet, up: Float64 | None = None) -> KnownMarkers:
    """Pick the set's markers out of a recording and bring them to metres, z up.

    up: the file's vertical direction, when it is known from elsewhere. Raises CloudError when too few markers
    are known or seen, or when their unit contradicts the size of a person.
    """
    columns: dict[str, int] = {}
    for column, label in enumerate(markers.labels):
        columns.setdefault(key_of(label), column)
    wanted = {key_of(name): place for place, name in enumerate(markerset.names)}
    found = [(columns[key], place) for key, place in wanted.items() if key in columns]
    if len(found) < MIN_MARKERS:
        raise CloudError(
            f"only {len(found)} of the {len(wanted)} markers of set {markerset.name!r} are in the recording; "
            "give a marker-set file that fits it"
        )
    picked = np.full((len(markers.positions), len(markerset.names), 3), np.nan)
    for column, place in found:
        picked[:, place] = markers.positions[:, column]
    picked *= _unit_m(picked, markers.unit)
    if up is None:
        up = up_direction(markers, markerset, picked)
    world = picked @ shortest_arc(up, np.array([0.0, 0.0, 1.0])).T
    world[np.abs(world).max(axis=2) > FAR_M] = np.nan
    unknown = tuple(label for label in markers.labels if key_of(label) not in wanted)
    return KnownMarkers(world, unknown)


def up_direction(markers: Markers, markerset: MarkerSet, positions: Float64) -> Float64:
    """Vertical direction (3,) of a file: as declared, else where the trunk stands over the legs, else y."""
    result = np.zeros(3)
    if markers.up >= 0:
        result[markers.up] = 1.0
        return result
    names = np.array([JOINTS[j].name for j in markerset.joint])
    upper = _mean(positions[:, np.isin(names, _UPPER)])
    lower = _mean(positions[:, np.isin(names, _LOWER)])
    rise = _mean((upper - lower)[:, None].swapaxes(0, 1))[0]
    axis = int(np.argmax(np.abs(rise)))
    clear = np.isfinite(rise).all() and abs(rise[axis]) > 0.7 * np.linalg.norm(rise)
    result[axis if clear else 1] = np.sign(rise[axis]) if clear else 1.0
    return result


def _mean(positions: Float64) -> Float64:
    """Mean over axis 1 of what is finite, NaN where nothing is."""
    finite = np.isfinite(positions)
    count = finite.sum(axis=1)
    return np.asarray(
        np.where(count > 0, np.where(finite, positions, 0).sum(axis=1) / np.maximum(count, 1), np.nan)
    )


def _unit_m(positions: Float64, unit: str) -> float:
    """Metres per unit, checked by the size of the body."""
    span = _span(positions)
    if unit in UNITS_M:
        size = span * UNITS_M[unit]
        if not PERSON_M[0] <= size <= PERSON_M[1]:
            raise CloudError(
                f"the file declares {unit!r}, so the person's markers span {size:.3g} m; "
                f"a person's span {PERSON_M[0]} to {PERSON_M[1]} m: correct the unit"
            )
        return UNITS_M[unit]
    for scale in (1.0, 0.01, 0.001):
        if PERSON_M[0] <= span * scale <= PERSON_M[1]:
            return scale
    raise CloudError(
        f"the markers span {span:.3g} {unit or 'units'}, no person's size in m, cm or mm; scale them"
    )


def _span(positions: Float64) -> float:
    """Median diagonal of the box around the markers, over the frames that hold most of them."""
    count = np.isfinite(positions).all(axis=2).sum(axis=1)
    full = positions[count >= max(4, 0.8 * count.max())]
    if not len(full):
        raise CloudError("no frame holds four known markers; record again")
    return float(np.median(np.linalg.norm(np.nanmax(full, axis=1) - np.nanmin(full, axis=1), axis=1)))


def check_same_person(trial: KnownMarkers, static: KnownMarkers, markerset: MarkerSet) -> None:
    """Raises CloudError when distances between markers on one bone differ between a trial and its static."""
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
    """Median distance of two markers over the frames that hold both, NaN when none does."""
    both = trial.seen[:, a] & trial.seen[:, b]
    if not both.any():
        return float("nan")
    return float(np.median(np.linalg.norm(trial.positions_m[both, a] - trial.positions_m[both, b], axis=1)))
