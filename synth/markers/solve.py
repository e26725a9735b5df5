"""Solution of joint angles from markers: fit the person to the recording, then each frame in turn.

Constants are untuned unless a source is given.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from sensors.errors import CloudError, Setting
from synth.markers.kinematics import State, Subject, markers_at
from synth.markers.motion_file import BRIDGED, GHOST, MISSING, SEEN, SWAPPED, MarkerReport, Motion
from synth.markers.person_fit import LENIENT_M, Template, fit_from_nothing, fit_shape, posture_prior
from synth.markers.posture_fit import ROBUST_M, Observed, Prior, fit_posture
from synth.motion_files.marker_files import POSE_RATE, Markers
from synth.motion_files.marker_set import (
    KnownMarkers,
    MarkerSet,
    check_same_person,
    choose_marker_set,
    known_markers,
)
from synth.motion_files.vertical_axis import GIVEN, Upward

CALIBRATION_FRAMES = 30
STATIC_FRAMES = 10  # frames of a recording, and of its static trial, that the person is fitted to
MIN_SEEN = 4  # a frame with fewer markers keeps the posture before it
BRIDGE_SECONDS = 0.25  # longest gap that is bridged by a straight line
BRIDGE_WEIGHT = 0.05  # of a bridged marker beside a seen one's 1
GHOST_M = 0.08  # distance from the posture of the others beyond which a marker is a ghost
SAME_LENGTHS_M = 0.004  # greatest median difference of the bones of one person in two takes
# ratio to the median marker's distance from its place on the body beyond which a marker is unsteady
UNSTEADY = 3.0
# least such distance. Measured on a runner: 13 mm for a filled-in heel marker, others up to 7 mm
UNSTEADY_M = 0.01
UNSTEADY_WEIGHT = 0.1
MOST_UNSTEADY = 4  # each takes another fit of the person
TRACK_STEPS = 15  # greatest number of Levenberg-Marquardt steps a frame


def solve(
    markers: Markers,
    static: Markers | None = None,
    markerset: MarkerSet | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> Motion:
    """Return the joint angles of a recording.

    static: static trial of the same person, which improves the fit. markerset: None = the shipped set with
    most of the labels. advance: called with 1 for each frame. Raises CloudError for unknown or unseen
    markers, impossible sizes, or another person's static trial.
    """
    trial, person, markerset, assumed = fit_person(markers, static, markerset)
    motion = _track(trial, person, markerset, markers.frames_per_second, advance)
    return replace(motion, report=replace(motion.report, assumed=assumed))


def fit_person(
    markers: Markers, static: Markers | None = None, markerset: MarkerSet | None = None
) -> tuple[KnownMarkers, Subject, MarkerSet, tuple[str, ...]]:
    """Return known markers, the person, the marker set with fitted weights, and sentences on assumptions.

    Arguments and errors as in ``solve``.
    """
    markerset = markerset or choose_marker_set(markers.labels)
    trial, standing = _trials(markers, static, markerset)
    assumed = [*markers.assumed, *trial.assumed]
    frames = _calibration_frames(trial, CALIBRATION_FRAMES)
    if static is not None and standing is not None:
        frames = np.concatenate([frames, _calibration_frames(standing, STATIC_FRAMES)])
        assumed += [f"static trial: {line}" for line in (*static.assumed, *standing.assumed)]
    person, markerset, unsteady = _steady_person(frames, markerset)
    return trial, person, markerset, tuple(dict.fromkeys((*assumed, *unsteady)))


def places_m(markers: Markers, static: Markers | None = None, markerset: MarkerSet | None = None) -> Float64:
    """Return the positions (F, M, 3) of markers in the world frame of ``solve``, NaN where unseen."""
    trial, _ = _trials(markers, static, markerset or choose_marker_set(markers.labels))
    return trial.positions_m


def _trials(
    markers: Markers, static: Markers | None, markerset: MarkerSet
) -> tuple[KnownMarkers, KnownMarkers | None]:
    """Return the known markers of recording and static trial; the static trial gives the vertical axis."""
    if static is None:
        return known_markers(markers, markerset), None
    standing = known_markers(static, markerset, standing=True)
    given = markers.up if markers.up.by == GIVEN else Upward(standing.up, GIVEN)
    trial = known_markers(replace(markers, up=given), markerset)
    check_same_person(trial, standing, markerset)
    return trial, standing


def solve_takes(takes: dict[str, Markers], markerset: MarkerSet) -> dict[str, Motion]:
    """Return the joint angles of takes of joint positions; takes of one person are fitted together.

    Raises CloudError as ``solve`` does.
    """
    trials = {name: known_markers(take, markerset) for name, take in takes.items()}
    people: list[tuple[Float64, list[str]]] = []
    for name, trial in trials.items():
        lengths = _lengths(trial)
        alike = next((names for known, names in people if _same(known, lengths)), None)
        if alike is None:
            people.append((lengths, [name]))
        else:
            alike.append(name)
    motions = {}
    for _, names in people:
        each = max(1, CALIBRATION_FRAMES // len(names))
        chosen = names[:: -(-len(names) // CALIBRATION_FRAMES)]
        frames = np.concatenate([_calibration_frames(trials[name], each) for name in chosen])
        person, _ = _person(frames, markerset)
        for name in names:
            rate = takes[name].frames_per_second
            motion = _track(trials[name], person, markerset, rate)
            motions[name] = replace(motion, report=replace(motion.report, assumed=takes[name].assumed))
    return {name: motions[name] for name in takes}


def _lengths(trial: KnownMarkers) -> Float64:
    apart = np.linalg.norm(np.diff(trial.positions_m, axis=1), axis=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmedian(apart, axis=0))


def _same(a: Float64, b: Float64) -> bool:
    """Return whether two skeletons are one person's: equal limb lengths, and nearly equal other distances."""
    return bool(np.nanmedian(np.abs(a - b)) < SAME_LENGTHS_M)


def _steady_person(frames: Float64, markerset: MarkerSet) -> tuple[Subject, MarkerSet, list[str]]:
    """Return the person, the marker set with less weight on markers that slide on their bones, and sentences
    on these markers.
    """
    lines: list[str] = []
    person, off_m = _person(frames, markerset)
    steady = off_m > 0
    for _ in range(MOST_UNSTEADY):
        worst = int(np.argmax(np.where(steady, off_m, 0)))
        if not off_m[worst] > max(UNSTEADY * float(np.median(off_m[steady])), UNSTEADY_M):
            break
        others = np.arange(len(steady)) != worst
        steady &= others
        name, off_mm = markerset.names[worst], 1000 * off_m[worst]
        lines.append(f"{name} moves on its bone by {off_mm:.0f} mm and counts for a tenth")
        markerset = replace(markerset, weight=np.where(others, 1, UNSTEADY_WEIGHT) * markerset.weight)
        person, off_m = _person(frames, markerset)
    return person, markerset, lines


def _person(frames: Float64, markerset: MarkerSet) -> tuple[Subject, Float64]:
    """Return the person fitted to frames (K, M, 3), and each marker's RMS residual (M,), 0 if unseen."""
    weights = np.isfinite(frames).all(axis=2) * markerset.weight
    template = Template.of(markerset)
    shape, states = fit_shape(template, template.shape(1.0), frames, weights)
    person = template.subject(shape)
    places = np.array([markers_at(state, person) for state in states])
    squared = np.where(weights > 0, ((places - frames) ** 2).sum(axis=2), 0.0)
    return person, np.sqrt(squared.sum(axis=0) / np.maximum((weights > 0).sum(axis=0), 1))


def _calibration_frames(trial: KnownMarkers, count: int) -> Float64:
    seen = trial.seen.sum(axis=1)
    stretches = np.array_split(np.arange(len(seen)), min(count, len(seen)))
    chosen = np.array([s[np.argmax(seen[s])] for s in stretches])
    chosen = chosen[seen[chosen] >= max(MIN_SEEN, 0.5 * seen.max())]
    if not len(chosen):
        raise CloudError(
            "no frame holds enough markers of the set; check the marker set, or record again",
            Setting.MARKERSET,
        )
    return np.asarray(trial.positions_m[chosen])


def _track(
    trial: KnownMarkers,
    subject: Subject,
    markerset: MarkerSet,
    rate: float,
    advance: Callable[[int], None] = lambda _: None,
) -> Motion:
    positions, status = bridge(trial.positions_m, round(BRIDGE_SECONDS * rate))
    used = np.asarray(trial.seen.any(axis=0))
    prior = posture_prior(200, 12 * min(4.0, max(1.0, 60 / rate)))
    tracker = _Tracker(subject, prior, markerset.weight)
    error = np.full(status.shape, np.nan, np.float32)
    angles: list[Float64] = []
    pelvis: list[Float64] = []
    state: State | None = None
    for f, observed in enumerate(positions):
        if (status[f] == SEEN).sum() >= MIN_SEEN:
            before = None if rate <= POSE_RATE else state
            state, error[f] = tracker.frame(before, observed, status[f])
        if state is not None:
            angles += [state.angles_rad] * (f + 1 - len(angles))
            pelvis += [state.pelvis_m] * (f + 1 - len(pelvis))
        advance(1)
    names = tuple(name for name, here in zip(markerset.names, used, strict=True) if here)
    report = MarkerReport(names, error[:, used], status[:, used], trial.unknown)
    return Motion(np.array(angles), np.array(pelvis), rate, subject.bones_m, report)


class _Tracker(NamedTuple):
    subject: Subject
    prior: Prior
    weight: Float64

    def frame(self, before: State | None, observed: Float64, status: UInt8) -> tuple[State, Float32]:
        """Return a frame's posture and its markers' errors; ghosts (false markers) and swaps are marked in
        ``status``.
        """
        seen, weight = np.asarray(status == SEEN), self.weight
        weights = np.where(seen, weight, np.where(status == BRIDGED, BRIDGE_WEIGHT * weight, 0.0))
        if before is None:
            before = self._anew(np.where(seen[:, None], observed, np.nan), weights)
        observed = unswap(observed, markers_at(before, self.subject), status)
        clean = np.nan_to_num(observed)
        state = self._fit(before, Observed(clean, weights))
        distance = self._distances(state, clean)
        if (distance[seen] > GHOST_M).any():
            state = self._refitted(before, state, observed, weights)
            distance = self._distances(state, clean)
        ghosts = np.asarray(seen & (distance > GHOST_M))
        if ghosts.any():
            status[ghosts] = GHOST
            state = self._fit(state, Observed(clean, np.where(ghosts, 0.0, weights)))
            distance = self._distances(state, clean)
        counted = (status == SEEN) | (status == SWAPPED)
        return state, np.where(counted, distance, np.nan).astype(np.float32)

    def _fit(self, start: State, observed: Observed, steps: int = TRACK_STEPS) -> State:
        return fit_posture(start, self.subject, observed, self.prior, steps=steps)[0]

    def _anew(self, observed: Float64, weights: Float64) -> State:
        return fit_from_nothing(self.subject, observed, weights, self.prior)[0]

    def _distances(self, state: State, observed: Float64) -> Float64:
        return np.asarray(np.linalg.norm(markers_at(state, self.subject) - observed, axis=1))

    def _refitted(self, before: State, state: State, observed: Float64, weights: Float64) -> State:
        """Return the best of three fits, before a marker counts as a ghost: as tracked, tracked longer, and
        from scratch.
        """
        clean = np.nan_to_num(observed)
        plain = self._fit(before, Observed(clean, weights, LENIENT_M), 3 * TRACK_STEPS)
        followed = self._fit(plain, Observed(clean, weights))
        anew = self._anew(np.where((weights > 0)[:, None], observed, np.nan), weights)

        def misfit(candidate: State) -> float:
            squared = self._distances(candidate, clean) ** 2
            return float((weights * squared / (1 + squared / ROBUST_M**2)).sum())

        return min((state, followed, anew), key=misfit)


def bridge(positions_m: Float64, longest: int) -> tuple[Float64, UInt8]:
    """Fill gaps of up to ``longest`` frames by linear interpolation; return positions (F, M, 3) and status
    uint8 (F, M).
    """
    filled = positions_m.copy()
    seen = np.asarray(np.isfinite(positions_m).all(axis=2))
    status = np.where(seen, SEEN, MISSING).astype(np.uint8)
    for m in range(seen.shape[1]):
        known = np.flatnonzero(seen[:, m])
        for start in np.flatnonzero((np.diff(known) > 1) & (np.diff(known) <= longest + 1)):
            a, b = known[start], known[start + 1]
            share = np.arange(1, b - a)[:, None] / (b - a)
            filled[a + 1 : b, m] = (1 - share) * filled[a, m] + share * filled[b, m]
            status[a + 1 : b, m] = BRIDGED
    return filled, status


def unswap(observed_m: Float64, predicted_m: Float64, status: UInt8) -> Float64:
    """Return a frame's markers, with two labels exchanged where that brings both nearer to the prediction.

    observed_m, predicted_m: (M, 3); exchanged ones are marked in ``status``. The test is the difference of
    summed squares, 2 (x_i - x_j) . (p_j - p_i). It must be negative enough, and each marker must come nearer
    than half the pair's distance.
    """
    usable = np.flatnonzero(np.isin(status, (SEEN, SWAPPED)))
    x, p = observed_m[usable], predicted_m[usable]
    across = p[:, None] - p[None, :]
    length = np.linalg.norm(across, axis=2)
    along = np.einsum("ijk,ijk->ij", x[:, None] - x[None, :], across)
    exchanged = np.linalg.norm(x[:, None] - p[None, :], axis=2)
    suspects = (along < -0.5 * length**2) & (np.maximum(exchanged, exchanged.T) < 0.5 * length)
    pairs = np.argwhere(np.triu(suspects, 1))
    if not len(pairs):
        return observed_m
    result, taken = observed_m.copy(), set[int]()
    for i, j in pairs[np.argsort((exchanged + exchanged.T)[tuple(pairs.T)])]:
        if i in taken or j in taken:
            continue
        taken |= {int(i), int(j)}
        result[usable[[i, j]]] = observed_m[usable[[j, i]]]
        status[usable[[i, j]]] = SWAPPED
    return result
