"""Joints of other skeletons as a marker set: every joint of a known name becomes a marker at one of our
joints.

Tools differ in bone lengths, rest poses and axes, but agree on joint positions. Head and hands have a marker
at the bone's end too. Rotations about a bone that move no joint (the forearm, the head on its axis) are lost.
"""

import re
from collections.abc import Collection, Sequence

import numpy as np

from annotate.array_types import Bool, Float64, Int64
from sensors.errors import CloudError, FormatError
from synth.body.skeleton import JOINT_ID
from synth.data_files import table
from synth.motion_files.marker_set import MIN_MARKERS, MarkerSet, without_prefix

# names of joints, the best first, by our kind of joint, in the order of filling
_NAMES = table("joint_names")
_KINDS = {name for names in _NAMES.values() for name in names}
_TRUNK = ("pelvis", "neck", "head", "head_end", "nose")
_FACE = ("nose", "eye", "ear")  # points of a head that has no joint of its own
_SIDES = (
    re.compile(r"(?P<side>left|right|l|r)[ _.-]*(?P<rest>.+)"),
    re.compile(r"(?P<rest>.+?)[ _.-]*(?P<side>left|right)"),
    re.compile(r"(?P<rest>.+?)[ _.-](?P<side>l|r)"),
)
# names without a side in VRM ("C_Hips") and AdvancedSkeleton ("Root_M")
_MIDDLE = re.compile(r"[cm][ _.-](.+)|(.+)[ _.-][cm]")
_JOINT = re.compile(r"[ _.-](jnt|joint|bone)$")  # ending of DeepMotion's names ("l_upleg_JNT")
# Least length of a hand by the leg's: with ASF's shorter bones the hand is the wrist. SMPL's hand has 0.1.
KNUCKLES = 0.06
_BEASTS = re.compile(r"tail|paw|hoof|wing|snout", re.IGNORECASE)  # joints of animals
# Least and greatest share of the leg's length of any person (Pheasant & Haslegrave 2005), with room for
# cartoon figures; a dog's trunk has 1.5.
_PROPORTIONS = {"thigh": (0.35, 0.65), "arm": (0.4, 1.1), "trunk": (0.3, 1.0)}


def marker_set_of_joints(
    names: Sequence[str], parents: Int64, centres: Float64
) -> tuple[list[int], MarkerSet, float]:
    """Return the columns of the known joints, their marker set, and the leg's length in the file's unit.

    parents: (J,) index of each joint's parent, -1 for the root. centres: (F, J, 3). Raises CloudError for too
    few known joints, or a skeleton that is not a person's.
    """
    places = _places(names, parents, centres)
    _check_known(names, places)
    leg = _check_person(names, places, centres)
    rows = [_row(place) for place in places]
    joint, at, spread = (np.array(column) for column in zip(*rows, strict=True))
    known = MarkerSet("joints", tuple(places), joint.astype(np.int64), at, spread, np.ones(len(rows)))
    return list(places.values()), known, leg


def _check_known(names: Sequence[str], places: Collection[str]) -> None:
    shown = f"{', '.join(names[:6])}, ..."
    legs = [f"{side}_{joint}" for side in ("left", "right") for joint in ("hip", "knee", "ankle")]
    lacking = [joint for joint in legs if joint not in places]
    if len(places) < MIN_MARKERS or len(lacking) == len(legs):
        raise CloudError(
            f"its joints are unknown ({shown}); rename them like LeftUpLeg, LeftLeg, LeftFoot "
            "(docs/markers.md)"
        )
    if any(joint.startswith("left_") for joint in lacking):
        raise CloudError(
            f"its joints ({shown}) lack {', '.join(lacking)}; add or rename them (docs/markers.md)"
        )


def _places(names: Sequence[str], parents: Int64, centres: Float64) -> dict[str, int]:
    """Return the index of the best joint for each position of our skeleton ("left_knee", "head",
    "left_toe").
    """
    apart = _apart(parents, centres)
    plain = without_prefix(names)
    named: dict[tuple[str, str], int] = {}
    for i, name in enumerate(plain):
        for side, kind in _readings(name) if apart[i] else ():
            named.setdefault((side, kind), i)
    found: dict[str, int] = {}
    for side in ("", "left_", "right_"):
        for kind, best in _NAMES.items():
            here = [named[side, name] for name in best if (side, name) in named]
            free = [i for i in here if i not in found.values()]
            if free and (kind in _TRUNK) == (not side):
                found[side + kind] = free[0]
        _at_wrist(side, found, centres)
    if "head" in found:
        found = {place: i for place, i in found.items() if place.rpartition("_")[2] not in _FACE}
    for end, of in (("head_end", "head"), ("left_hand_end", "left_wrist"), ("right_hand_end", "right_wrist")):
        tips = [
            i for i in np.flatnonzero(parents == found.get(of, -2)) if apart[i] and i not in found.values()
        ]
        if end not in found and tips and (len(tips) == 1 or of != "head"):
            found[end] = int(tips[len(tips) // 2])
    return found


def _at_wrist(side: str, found: dict[str, int], centres: Float64) -> None:
    wrist, hand = found.get(f"{side}wrist"), found.get(f"{side}hand_end")
    hip, knee = found.get(f"{side}hip"), found.get(f"{side}knee")
    if wrist is None or hand is None or hip is None or knee is None:
        return
    if _length(centres, wrist, hand) < KNUCKLES * 2 * _length(centres, hip, knee):
        found[f"{side}wrist"] = hand
        del found[f"{side}hand_end"]


def _length(centres: Float64, a: int, b: int) -> float:
    lengths = np.linalg.norm(centres[:, a] - centres[:, b], axis=-1)
    known = lengths[~np.isnan(lengths)]
    return float(np.median(known)) if len(known) else float("nan")


def _apart(parents: Int64, centres: Float64) -> Bool:
    """Return flags (J,) of joints at a distance from their parent; other joints have no position of their
    own.
    """
    away = np.nan_to_num(np.linalg.norm(centres - centres[:, parents], axis=2)).max(axis=0)
    return np.asarray((away > 1e-3 * away.max()) | (parents < 0), np.bool_)


def _readings(name: str) -> list[tuple[str, str]]:
    """Return (side, known name) pairs that a joint's name may mean; side is "left_", "right_" or ""."""
    label = _JOINT.sub("", name.casefold())
    found = [("", label)]
    if match := _MIDDLE.fullmatch(label):
        found.append(("", match[1] or match[2]))
    for pattern in _SIDES:
        if match := pattern.fullmatch(label):
            found.append(("left_" if match["side"][0] == "l" else "right_", match["rest"]))
    bare = [(side, re.sub(r"[^a-z0-9]", "", rest)) for side, rest in found]
    return [(side, rest) for side, rest in bare if rest in _KINDS]


def _check_person(names: Sequence[str], places: dict[str, int], centres: Float64) -> float:
    """Return the leg's length. Raises CloudError or FormatError for a skeleton that is not a person's."""
    beast = next((name for name in names if _BEASTS.search(name)), None)
    if beast is not None:
        raise CloudError(f"its joint {beast[:40]!r} is not a person's; give the motion of a person")

    def length(a: str, b: str) -> float:
        return _length(centres, places[a], places[b]) if a in places and b in places else float("nan")

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


# Joint, and place in metres from it, of points of the left half of a face.
_POINTS = {
    "nose": ("head", (0.0, -0.11, 0.03)),
    "eye": ("head", (0.032, -0.085, 0.06)),
    "ear": ("head", (0.075, 0.0, 0.05)),
}


def _row(place: str) -> tuple[int, tuple[float, float, float], float]:
    side, _, kind = place.partition("_") if "_" in place else ("", "", place)
    if kind == "toe":
        return JOINT_ID[f"{side}_ankle"], (0.0, -0.15, -0.05), 0.05
    if kind == "hand_end":
        return JOINT_ID[f"{side}_wrist"], (0.0, 0.0, -0.09), 0.05
    if place == "head_end":
        return JOINT_ID["head"], (0.0, 0.0, 0.15), 0.05
    if kind in _POINTS:
        joint, at = _POINTS[kind]
        return JOINT_ID[joint], (at[0] if side == "left" else -at[0], *at[1:]), 0.03
    # Limbs hinge at the joints of the file; its hips, collar and neck differ from tool to tool.
    exact = kind in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    return JOINT_ID[place], (0.0, 0.0, 0.0), 0.005 if exact else 0.03
