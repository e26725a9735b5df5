"""Whole motion on one body, smooth from frame to frame: on a floor, and on one seat for a sitter.

Constants are untuned.
"""

from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Float64
from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import Posture
from synth.markers.person_fit import leg_length_m, zero_bones
from synth.motion.grounded import Grounded
from synth.motion.placed import cleared, heading_rad, standing
from synth.pose.postures import rest_on
from synth.surface.furniture import FLOOR, Chair, Seat

LEASH_M = 0.8  # greatest way from the middle: longer walks are drawn together
STRIDE_S = 0.5  # time over which a way is a walk rather than swaying
CALM_S = 0.06  # time over which contacts begin and end
TRIED_SITS = 8  # seated frames whose median height a seat has


@dataclass(frozen=True, eq=False)
class Performance:
    """Postures of every frame in a room: a sitter faces -y from a seat; else the middle is the origin."""

    body: Body
    postures: tuple[Posture, ...]
    seat: Seat | None


def perform(body: Body, grounded: Grounded) -> Performance:
    seat, place, turn = _stage(body, grounded)
    way = _way(body, grounded, turn)
    way += (place - way[grounded.sits].mean(axis=0)) if seat is not None else 0.0
    solids = [FLOOR, *(seat.solids() if seat is not None else [])]
    raw, settled = [], []
    for f in range(len(grounded)):
        posture, wanted = standing(body, grounded, f, turn)
        posture = replace(posture, pelvis_m=posture.pelvis_m + np.append(way[f], 0.0))
        raw.append(posture)
        settled.append(cleared(body, posture, wanted, solids))
    return Performance(body, _calmed(raw, settled, grounded.frames_per_second), seat)


def _stage(body: Body, grounded: Grounded) -> tuple[Seat | None, Float64, float]:
    """Return the seat, if any, the pelvis' place (2,) on it, and the turn to face -y."""
    frames = np.flatnonzero(grounded.sits) if grounded.sits.any() else np.arange(len(grounded))
    headings = np.array([heading_rad(grounded.angles_rad[f, 0]) for f in frames])
    turn = -float(np.arctan2(np.sin(headings).mean(), np.cos(headings).mean()))
    if not grounded.sits.any():
        return None, np.zeros(2), turn
    trunk, places, heights = flesh_of(body).trunk, [], []
    for f in frames[:: -(-len(frames) // TRIED_SITS)]:
        posture, _ = standing(body, grounded, int(f), turn)
        vertices, joints = pose(body, posture)
        heights.append(float(vertices[trunk, 2].min()))
        seat = replace(Chair(), height=heights[-1] + Chair().give_m)
        places.append((posture.pelvis_m + rest_on(seat, vertices[trunk], joints, 0.0))[:2])
    height = float(np.median(heights)) + Chair().give_m
    return replace(Chair(), height=height), np.median(places, axis=0), turn


def _way(body: Body, grounded: Grounded, turn: float) -> Float64:
    """Return the pelvis' way (F, 2), scaled to the body's legs, long walks drawn together."""
    from scipy.ndimage import gaussian_filter1d

    scale = leg_length_m(zero_bones(body.joints_m)) / grounded.leg_m
    c, s = np.cos(turn), np.sin(turn)
    way = scale * grounded.path_m @ np.array([[c, s], [-s, c]])
    line = gaussian_filter1d(way, STRIDE_S * grounded.frames_per_second, axis=0, mode="nearest")
    middle = (line.min(axis=0) + line.max(axis=0)) / 2
    farthest = float(np.linalg.norm(line - middle, axis=1).max())
    return np.asarray(way - line + (line - middle) * min(1.0, LEASH_M / max(farthest, 1e-9)))


def _calmed(raw: list[Posture], settled: list[Posture], rate: float) -> tuple[Posture, ...]:
    from scipy.ndimage import gaussian_filter1d

    given, angles = (np.array([posture.angles_rad for posture in some]) for some in (raw, settled))
    pelvis = np.array([posture.pelvis_m for posture in settled])
    change = (angles - given + np.pi) % (2 * np.pi) - np.pi
    calm = given + gaussian_filter1d(change, CALM_S * rate, axis=0, mode="nearest")
    pelvis[:, 2] = gaussian_filter1d(pelvis[:, 2], CALM_S * rate / 2, mode="nearest")
    return tuple(Posture(a, p) for a, p in zip(calm, pelvis, strict=True))
