"""Vertical axis and handedness of a recording, from the file's statement and the person's stance and motion.

Files state the axis wrongly or not at all. ezc3d and BTK write no Y_SCREEN. The zero pose of Bandai Namco's
BVH files is not a standing pose (Bandai-Namco-Research-Motiondataset issue 9). Some BVH files hold a z-up
motion beside a y-up zero pose (bvhio issues 1 and 11). A person may lie, so a trunk along an axis does not
prove the vertical. Proofs are: the person goes far without leaving the level; the pelvis moves along the
trunk while both feet stay; the soles are flat on the lowest level.

A mirrored recording has left-handed axes, or two axes exchanged without a sign. No rotation of the axes mends
that, and twisted legs fit it to millimetres. With the left hip on the left, the toes of a mirror image point
backwards. Constants are untuned unless a source is given.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float64, Int64
from sensors.errors import CloudError, Note, Setting
from synth.body.skeleton import JOINTS

AXES = ("x", "y", "z", "-x", "-y", "-z")
GIVEN = "the user"  # source of an axis that is used without a check
UPRIGHT_DEG = 45.0  # greatest angle between trunk and vertical of an upright person
MOST, SOME = 0.5, 0.25  # share of upright frames: most of a recording, and enough of a walk
FAR_M = 0.7  # way of the pelvis beyond which a person walks; a person in bed turns over within it
CLIMB = 0.6  # greatest rise of the pelvis by its way: stairs rise by 0.6
SQUAT_M, STAY_M = 0.12, 0.06  # squat: least way of the pelvis along the trunk, greatest way of the ankles
FLAT_DEG = 20.0  # greatest angle of a flat sole; feet at rest in bed hang by 30 and more
ANKLE_TO_TOE = (-25.0, 25.0)  # degrees; rise from ankle to ball of a flat foot, and its spread over skeletons
FLOOR_M = (-0.08, 0.2)  # least and greatest height of the lowest marker over a floor at 0
ORIGIN_M = 0.01  # a pelvis that stays nearer to the origin is the origin
_UPPER = (
    ("head", "neck", "spine_upper", "left_clavicle", "right_clavicle"),
    ("left_shoulder", "right_shoulder"),
)
_MIDDLE = (("pelvis",), ("left_hip", "right_hip"))
# Joints of a person's parts; the second group where the first is not seen.
_LOWER = (("left_ankle", "right_ankle", "left_knee", "right_knee"),)
# Mean of ``feet_ahead`` of a mirror image, at most. Measured: 0.82 to 0.98 over 96 takes of the CMU library,
# 0.28 and more over 15 single poses, 0.17 and more in 20 exercises on the floor.
MIRRORED = -0.2
MIRROR_LINE = (
    "left and right are exchanged (left-handed axes, two axes exchanged, or names): "
    "the recording is mirrored back"
)
FOOT_M = 0.05  # least distance of two places that show a foot's direction


class Upward(NamedTuple):
    """Stated vertical direction. axis: one of ``AXES`` or ""; by: source of the statement; usual: direction
    in most files of that kind.
    """

    axis: str = ""
    by: str = ""
    usual: str = "y"


UNSTATED = Upward()


def given(axis: str) -> Upward:
    """Return a direction that is used without a check. Raises CloudError for other names than ``AXES``."""
    if axis not in AXES:
        raise CloudError(f"vertical axis {axis!r} is unknown; give {', '.join(AXES)}")
    return Upward(axis, GIVEN)


def direction(axis: str) -> Float64:
    return np.asarray(np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0))


@dataclass(frozen=True)
class _Person:
    """Measures of a person: extents (F, 3) of trunk and whole person, positions (F, 3) of pelvis and ankles,
    markers, and soles.
    """

    rises: tuple[Float64, Float64]
    pelvis: Float64
    ankles: tuple[Float64, Float64]
    points: Float64
    soles: tuple[tuple[Float64, float, float], ...]

    def upright(self, axis: str) -> float:
        """Return the share of frames in which the trunk, or the whole person, stands along an axis."""
        lengths = np.array([np.linalg.norm(rise, axis=1) for rise in self.rises])
        along = np.array([rise @ direction(axis) for rise in self.rises])
        known = lengths.max(axis=0) > 0
        stands = (along > np.cos(np.radians(UPRIGHT_DEG)) * lengths).any(axis=0)
        return float(stands[known].mean()) if known.any() else 0.0

    def moves_upright(self, axis: str) -> bool:
        """Return whether the person walks or squats with the trunk along an axis."""
        up = direction(axis)
        climb = _way(self.pelvis @ up)
        across = self.pelvis[:, up == 0]
        walked = float(np.linalg.norm([_way(column) for column in across.T]))
        squats = climb > SQUAT_M and max(_way(ankle @ up) for ankle in self.ankles) < STAY_M
        return (walked > FAR_M and climb < CLIMB * walked) or squats

    def stands_flat(self, axis: str) -> bool | None:
        """Return whether the soles are level in most frames, None without markers of heel and toes."""
        if not self.soles:
            return None
        up = direction(axis)
        flat = [np.abs(np.degrees(np.arcsin(way @ up)) - rest) < most for way, rest, most in self.soles]
        return bool(np.concatenate(flat).mean() > MOST)

    def on_floor(self, axis: str) -> bool:
        """Return whether the lowest markers are at 0, as the floor is in laboratories.

        Positions estimated by networks are relative to the pelvis and show no floor.
        """
        if np.nanmax(np.abs(self.pelvis), initial=0) < ORIGIN_M:
            return False
        heights = (self.points @ direction(axis)).ravel()
        heights = heights[np.isfinite(heights)]
        return bool(FLOOR_M[0] < np.quantile(heights, 0.02) < FLOOR_M[1]) if heights.size else False

    def grounded(self, axis: str, instead: str) -> bool:
        """Return whether a floor is more probable below ``axis`` than below ``instead``."""
        return self.on_floor(axis) or not (instead and self.on_floor(instead))

    def stands(self, axis: str, instead: str) -> bool:
        """Return whether the person stands with ``axis`` up, rather than lies with ``instead`` up."""
        flat = self.stands_flat(axis)
        if flat is None:
            return self.on_floor(axis) and not (instead and self.on_floor(instead))
        return flat and self.grounded(axis, instead)


def find_vertical(
    positions_m: Float64, joint: Int64, at_m: Float64, stated: Upward, standing: bool = False
) -> tuple[str, tuple[str, ...]]:
    """Return the vertical axis of markers (F, M, 3) in metres, and a sentence on each assumption.

    joint, at_m: (M,) and (M, 3) of the marker set. standing: True if the person stands.
    """
    if stated.by == GIVEN:
        return stated.axis, ()
    person = _person(positions_m, joint, at_m)
    shares = {axis: person.upright(axis) for axis in AXES}
    best = max(AXES, key=lambda axis: shares[axis])
    if stated.axis and shares[stated.axis] >= MOST:
        return stated.axis, _doubt(person, stated)
    if standing and shares[best] >= MOST:
        return best, (_stands(best, stated),)
    moves = shares[best] >= SOME and person.moves_upright(best)
    if not stated.axis:
        return _unstated(person, shares, best, moves, stated.usual)
    if not moves and shares[best] < MOST:
        return stated.axis, ()
    if person.grounded(best, stated.axis) and (moves or person.stands(best, stated.axis)):
        other = stated.axis if person.on_floor(stated.axis) else ""
        return best, (_or_else(_stands(best, stated), other),)
    lies = f"by {stated.by} ({stated.axis} up) the person lies"
    return stated.axis, (Note(f"{lies}; if the person stands, {best} is up", Setting.UP),)


def _stands(axis: str, stated: Upward) -> str:
    """Return the note that a standing person's axis differs from the stated axis."""
    if stated.axis:
        return f"{stated.by} states {stated.axis} up, but the person stands along {axis}, which is used"
    return f"no vertical axis is stated; the person stands along {axis}, which is used"


def _doubt(person: _Person, stated: Upward) -> tuple[str, ...]:
    """Return a sentence if the person stands in mid-air with the stated axis up, but lies on the floor with
    another.
    """
    if person.on_floor(stated.axis) or person.moves_upright(stated.axis) or person.stands_flat(stated.axis):
        return ()
    across = [axis for axis in ("y", "z", "-y", "-z") if axis[-1] != stated.axis[-1]]
    other = next((axis for axis in across if person.on_floor(axis)), "")
    stands = f"by {stated.by} ({stated.axis} up) the person stands"
    return (Note(f"{stands}; if the person lies, {other} is up", Setting.UP),) if other else ()


def zero_pose_axis(positions: Float64, joint: Int64) -> str:
    """Return y or z if the zero pose (1, M, 3) stands along it, else "": LAFAN1 and Xsens lie along x."""
    rise = _person(positions, joint, np.zeros((len(joint), 3))).rises[1][0]
    axis = int(np.argmax(rise))
    return "xyz"[axis] if axis and rise[axis] > 0.7 * np.linalg.norm(rise) > 0 else ""


def _unstated(
    person: _Person, shares: dict[str, float], best: str, moves: bool, usual: str
) -> tuple[str, tuple[str, ...]]:
    """Return the likeliest axis of a file that states none, and a sentence. moves: True if the person walks
    or squats along ``best``.
    """
    grounds = [axis for axis in (usual, "y", "z") if person.on_floor(axis) and shares[axis] < MOST]
    ground = "" if person.on_floor(best) else next(iter(grounds), "")
    if moves or (shares[best] >= MOST and person.stands(best, ground)):
        return best, (_or_else(_stands(best, UNSTATED), grounds[0] if grounds else ""),)
    stands = person.on_floor(best) and shares[best] >= MOST
    lying = "" if stands else next(iter(grounds), usual if best[-1] == "x" else "")
    used = lying or (best if shares[best] >= MOST else usual)
    how = "lies" if shares[used] < MOST else "stands"
    other = best if used != best else next(axis for axis in (usual, "z", "y") if axis != used)
    line = (
        f"no vertical axis is stated and the motion does not decide it: {used} is used, so the person {how}"
    )
    return used, (_or_else(line, other),)


def _or_else(line: str, other: str) -> str:
    """Return a note with another possible axis, "" = none."""
    return Note(f"{line}; else {other} is up", Setting.UP) if other else line


def _person(positions_m: Float64, joint: Int64, at_m: Float64) -> _Person:
    names = np.array([JOINTS[int(j)].name for j in joint])

    def middle(of: tuple[str, ...]) -> Float64:
        return _middle(positions_m, np.isin(names, of))

    upper, pelvis, lower = (_first(*map(middle, of)) for of in (_UPPER, _MIDDLE, _LOWER))
    upper, lower = _first(upper, pelvis), _first(lower, pelvis)
    rises = np.nan_to_num(upper - pelvis), np.nan_to_num(upper - lower)
    trunk = _first(pelvis, upper)
    left, right = (middle((f"{side}_ankle",)) for side in ("left", "right"))
    soles = [_sole(positions_m, names == f"{side}_ankle", at_m) for side in ("left", "right")]
    return _Person(
        rises, trunk, (left, right), positions_m, tuple(sole for sole in soles if sole is not None)
    )


def _sole(positions_m: Float64, on_foot: Bool, at_m: Float64) -> tuple[Float64, float, float] | None:
    """Return a foot's directions (n, 3) from heel to toe, their elevation at rest and its spread, degrees."""
    ends = ends_of_foot(positions_m, on_foot, at_m)
    if ends is None:
        return None
    back, front = ends
    rest = at_m[front] - at_m[back]
    ways = positions_m[:, front] - positions_m[:, back]
    length = np.linalg.norm(ways, axis=1)
    usable = length > 0.02
    if not usable.any():
        return None
    flat = (float(np.degrees(np.arcsin(rest[2] / np.linalg.norm(rest)))), FLAT_DEG)
    return ways[usable] / length[usable, None], *(flat if at_m[back].any() else ANKLE_TO_TOE)


def _first(*places: Float64) -> Float64:
    found = places[0]
    for other in places[1:]:
        found = np.where(np.isfinite(found), found, other)
    return found


def _way(values: Float64) -> float:
    """Return the range of values (F,) between the 1st and 99th percentile, 0 without values."""
    finite = values[np.isfinite(values)]
    return float(np.subtract(*np.quantile(finite, (0.99, 0.01)))) if finite.size else 0.0


def is_mirrored(positions_m: Float64, joint: Int64, at_m: Float64) -> bool:
    """Return whether the feet show that markers (F, M, 3) in metres are a mirror image.

    joint, at_m: (M,) and (M, 3) of the marker set.
    """
    ahead = feet_ahead(positions_m, joint, at_m)
    known = ahead[np.isfinite(ahead)]
    return bool(known.size) and float(known.mean()) < MIRRORED


def feet_ahead(positions_m: Float64, joint: Int64, at_m: Float64) -> Float64:
    """Return a measure (2 F,) of how far both feet point forwards, NaN where not seen; positive in every
    posture.

    The measure is the triple product of the directions from right to left, up the shank and along the foot.
    """
    names = np.array([JOINTS[int(j)].name for j in joint])
    side = np.where(np.char.startswith(names, "left_hip"), 1, 0) - np.char.startswith(names, "right_hip")
    side = np.where(names == "pelvis", np.sign(at_m[:, 0]), side)
    across = _middle(positions_m, side > 0) - _middle(positions_m, side < 0)
    found = [np.empty(0)]
    for of in ("left", "right"):
        ends = ends_of_foot(positions_m, names == f"{of}_ankle", at_m)
        if ends is not None:
            knee, ankle = (_middle(positions_m, names == f"{of}_{place}") for place in ("knee", "ankle"))
            foot = positions_m[:, ends[1]] - positions_m[:, ends[0]]
            found.append((np.cross(_unit(across), _unit(knee - ankle)) * _unit(foot)).sum(axis=1))
    return np.concatenate(found)


def ends_of_foot(positions_m: Float64, on_foot: Bool, at_m: Float64) -> tuple[int, int] | None:
    """Return the columns of a foot's hindmost and foremost marker, None without two."""
    columns = np.flatnonzero(on_foot & np.isfinite(positions_m).any(axis=(0, 2)))
    if not len(columns):
        return None
    back, front = columns[np.argmax(at_m[columns, 1])], columns[np.argmin(at_m[columns, 1])]
    return None if np.linalg.norm(at_m[front] - at_m[back]) < FOOT_M else (int(back), int(front))


def _middle(positions: Float64, chosen: Bool) -> Float64:
    """Return the mean (F, 3) of the seen markers among the chosen columns, NaN without any."""
    seen = np.isfinite(positions[:, chosen])
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(seen, positions[:, chosen], 0).sum(axis=1) / seen.sum(axis=1))


def _unit(ways: Float64) -> Float64:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))
