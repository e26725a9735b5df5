"""Joints of other skeletons as a marker set: every joint of a known name is a point at a joint of ours.

Bone lengths, rest poses and axes of skeletons differ from tool to tool; what they share is where the joints
are. Head and hands have a point at the bone's end too. What turns about a bone without moving a joint (the
forearm, the head on its axis) is lost.
"""

import re
from collections.abc import Sequence

import numpy as np

from annotate.array_types import Bool, Float64, Int64
from sensors.errors import CloudError, FormatError
from synth.body.skeleton import JOINT_ID
from synth.markers.markerset import MIN_MARKERS, MarkerSet
from synth.shipped import table

_RANKS = {
    name: (kind, rank) for kind, names in table("joint_names").items() for rank, name in enumerate(names)
}
"""Kind of joint, and how good a name for it this is (0 best), by the name without side and prefix."""
_TRUNK = ("pelvis", "neck", "head", "head_end")
_PREFIX, _SUFFIX = re.compile(r"(left|right|l|r)"), re.compile(r"[._-](left|right|l|r)$")
_BEASTS = re.compile(r"tail|paw|hoof|wing|snout", re.IGNORECASE)
"""Joints that no person has."""
_PROPORTIONS = {"thigh": (0.35, 0.65), "arm": (0.4, 1.1), "trunk": (0.3, 1.0)}
"""Of the leg's length: least and most of any person (Pheasant & Haslegrave 2005), with room for cartoon
figures; a dog's trunk has 1.5."""


def marker_set_of_joints(
    names: Sequence[str], parents: Int64, centres: Float64
) -> tuple[list[int], MarkerSet, float]:
    """Columns of the joints that are known, their marker set, and the leg's length in the file's unit.

    parents: (J,) index of each joint's parent, -1 for the root. centres: (F, J, 3). Raises CloudError when
    too few are known or the skeleton is no person's.
    """
    places = _places(names, parents, centres)
    legs = [f"left_{joint}" in places for joint in ("hip", "knee", "ankle")]
    shown = f"{', '.join(names[:6])}, ..."
    if len(places) < MIN_MARKERS or not all(legs):
        raise CloudError(f"unknown joints ({shown}); rename them like LeftUpLeg, LeftLeg, LeftFoot")
    leg = _check_person(names, places, centres)
    rows = [_row(place) for place in places]
    joint, at, spread = (np.array(column) for column in zip(*rows, strict=True))
    known = MarkerSet("joints", tuple(places), joint.astype(np.int64), at, spread, np.ones(len(rows)))
    return list(places.values()), known, leg


def _places(names: Sequence[str], parents: Int64, centres: Float64) -> dict[str, int]:
    """Index of the best joint for each of our places ("left_knee", "head", "left_toe")."""
    apart = _apart(parents, centres)
    ranked: dict[str, list[tuple[int, int]]] = {}
    for i, name in enumerate(names):
        place, rank = _place_of(name)
        if place and apart[i]:
            ranked.setdefault(place, []).append((rank, i))
    found = {place: min(candidates)[1] for place, candidates in ranked.items()}
    for end, of in (("head_end", "head"), ("left_hand_end", "left_wrist"), ("right_hand_end", "right_wrist")):
        tips = [i for i in np.flatnonzero(parents == found.get(of, -2)) if apart[i]]
        if end not in found and tips and (len(tips) == 1 or of != "head"):
            found[end] = int(tips[len(tips) // 2])
    return found


def _apart(parents: Int64, centres: Float64) -> Bool:
    """Joints (J,) that are not where their parent is: those that are have no place of their own."""
    away = np.nan_to_num(np.linalg.norm(centres - centres[:, parents], axis=2)).max(axis=0)
    return np.asarray((away > 1e-3 * away.max()) | (parents < 0), np.bool_)


def _place_of(name: str) -> tuple[str | None, int]:
    """Our place that a joint's name stands for, None if it is none of them; and the rank of the name."""
    label = name.rpartition(":")[2].casefold()
    prefixed, suffixed = _PREFIX.match(label), _SUFFIX.search(label)
    readings: list[tuple[str | None, str]] = [(None, label)]
    readings += [(prefixed[1], label[prefixed.end() :])] if prefixed else []
    readings += [(suffixed[1], label[: suffixed.start()])] if suffixed else []
    for side, rest in readings:
        kind, rank = _RANKS.get(re.sub(r"[^a-z0-9]", "", rest), (None, 0))
        if kind and (kind in _TRUNK) == (side is None):
            return (kind if side is None else f"{'left' if side[0] == 'l' else 'right'}_{kind}"), rank
    return None, 0


def _check_person(names: Sequence[str], places: dict[str, int], centres: Float64) -> float:
    """The leg's length. Raises CloudError, FormatError for the skeleton of no person."""
    beast = next((name for name in names if _BEASTS.search(name)), None)
    if beast is not None:
        raise CloudError(f"its joint {beast[:40]!r} is not a person's; give the motion of a person")

    def length(a: str, b: str) -> float:
        ends = [places.get(end) for end in (a, b)]
        if None in ends:
            return float("nan")
        return float(np.nanmedian(np.linalg.norm(centres[:, ends[0]] - centres[:, ends[1]], axis=-1)))

    thigh, leg = length("left_hip", "left_knee"), length("left_hip", "left_knee")
    leg += length("left_knee", "left_ankle")
    if not leg > 0:
        raise FormatError("its legs have no length; export it again")
    arm = length("left_shoulder", "left_elbow") + length("left_elbow", "left_wrist")
    measured = {"thigh": thigh, "arm": arm, "trunk": length("left_hip", "left_shoulder")}
    for what, (low, high) in _PROPORTIONS.items():
        if measured[what] < low * leg or measured[what] > high * leg:
            share = measured[what] / leg
            raise CloudError(
                f"its {what} is {share:.2f} of a leg, not a person's; give the motion of a person"
            )
    return leg


def _row(place: str) -> tuple[int, tuple[float, float, float], float]:
    """Joint, place in metres from it and spread of one point."""
    side, _, kind = place.partition("_")
    if kind == "toe":
        return JOINT_ID[f"{side}_ankle"], (0.0, -0.15, -0.05), 0.05
    if kind == "hand_end":
        return JOINT_ID[f"{side}_wrist"], (0.0, 0.0, -0.09), 0.05
    if place == "head_end":
        return JOINT_ID["head"], (0.0, 0.0, 0.15), 0.05
    # Limbs hinge at the joints of the file; its hips, collar and neck differ from tool to tool.
    exact = kind in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    return JOINT_ID[place], (0.0, 0.0, 0.0), 0.005 if exact else 0.03
