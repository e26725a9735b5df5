"""BVH files: a skeleton's own rotations become points on its bones, and those are solved like markers.

Bone lengths, rest poses and axes of BVH files differ from tool to tool; what they share is where the joints
are. So every joint of a known name gives a point at its centre, head and hands also at the bone's end. What
turns about a bone without moving a joint (the forearm, the head on its axis) is lost.
"""

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import read_bounded
from synth.body.skeleton import JOINT_ID
from synth.markers.marker_files import Markers
from synth.markers.markerset import MIN_MARKERS, MarkerSet
from synth.shipped import table

MAX_FILE_BYTES = 300_000_000
"""A quarter of an hour of 100 joints at 120 frames/s."""
MAX_CENTRES = 20_000_000
"""Frames times joints, about 60 bytes and 2 us each: half an hour of 100 joints at 120 frames/s."""
LEG_M = 0.82
"""BVH has no unit: the skeleton is scaled to this length from hip to ankle."""
_NAMES = {name: kind for kind, names in table("bvh").items() for name in names}
"""Kinds of joints by their names in BVH files, without side and prefix."""
_CHANNEL = re.compile("[xyz](position|rotation)")


class Bone(NamedTuple):
    """One joint of a BVH: parent (-1 root), offset in the file's unit, channels and their first column."""

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]
    column: int


def read_bvh(path: Path) -> tuple[Markers, MarkerSet]:
    """Joint centres of a BVH as markers in metres, y up, and the marker set of these joints.

    Raises FormatError when the file is damaged or of impossible size, CloudError when its joints are unknown.
    """
    data = read_bounded(path, MAX_FILE_BYTES, "cut the motion")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} cannot be read ({error}); give a BVH file") from error
    try:
        hierarchy, _, motion = text.partition("MOTION")
        bones = _hierarchy(hierarchy.split())
        rows, seconds = _motion(motion, sum(len(b.channels) for b in bones))
        if len(rows) * len(bones) > MAX_CENTRES:
            raise FormatError(f"{len(rows)} frames of {len(bones)} joints; cut the motion")
    except (ValueError, IndexError) as error:
        raise FormatError(f"{path}: damaged BVH ({error}); export it again") from error
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error
    return _markers(path, bones, _centres(bones, rows), 1 / seconds)


def _hierarchy(tokens: list[str]) -> list[Bone]:
    if tokens[:1] != ["HIERARCHY"]:
        raise FormatError("no HIERARCHY; give a BVH file")
    bones: list[Bone] = []
    open_bones: list[int] = []
    at, columns, name = 1, 0, ""
    while at < len(tokens):
        word = tokens[at].upper()
        if word in ("ROOT", "JOINT", "END"):
            name = tokens[at + 1] if word != "END" else f"{bones[open_bones[-1]].name}_end"
            at += 2
        elif word == "{":
            if tokens[at + 1].upper() != "OFFSET":
                raise FormatError(f"joint {name[:40]!r} has no OFFSET; export it again")
            x, y, z = (float(v) for v in tokens[at + 2 : at + 5])
            at += 5
            channels: tuple[str, ...] = ()
            if tokens[at].upper() == "CHANNELS":
                count = int(tokens[at + 1])
                channels = tuple(c.lower() for c in tokens[at + 2 : at + 2 + count])
                if len(channels) != count or not all(map(_CHANNEL.fullmatch, channels)):
                    shown = " ".join(channels)[:60]
                    raise FormatError(f"joint {name[:40]!r} has channels {shown}; export it again")
                at += 2 + count
            bones.append(Bone(name, open_bones[-1] if open_bones else -1, (x, y, z), channels, columns))
            open_bones.append(len(bones) - 1)
            columns += len(channels)
        elif word == "}":
            open_bones.pop()
            at += 1
        else:
            raise FormatError(f"{tokens[at][:40]!r} is not a BVH keyword; export it again")
    if open_bones or not columns:
        raise FormatError("the hierarchy is cut short; copy it again")
    return bones


def _motion(text: str, columns: int) -> tuple[Float64, float]:
    """Channels (F, C) of all frames, and seconds a frame."""
    head = re.match(r"\s*Frames:\s*(\d+)\s+Frame\s+Time:\s*(\S+)", text, re.IGNORECASE)
    if head is None:
        raise FormatError("no number of frames and frame time; copy it again")
    frames, seconds = int(head[1]), float(head[2])
    if not 1e-4 <= seconds <= 1:
        raise FormatError(f"frame time {seconds}; give seconds from 0.0001 to 1")
    numbers = np.fromstring(text[head.end() :], sep=" ")
    if frames < 1 or numbers.size != frames * columns or not np.isfinite(numbers).all():
        raise FormatError(
            f"claims {frames} frames of {columns} finite numbers and holds {numbers.size}; copy it again"
        )
    return numbers.reshape(frames, columns), seconds


def _centres(bones: list[Bone], rows: Float64) -> Float64:
    """World positions (F, B, 3) of all joints, in the file's unit."""
    positions = np.empty((len(rows), len(bones), 3))
    turned: list[Rotation] = []
    for i, bone in enumerate(bones):
        offset = np.tile(bone.offset, (len(rows), 1)).astype(float)
        turn = Rotation.identity(len(rows))
        for k, channel in enumerate(bone.channels):
            values, axis = rows[:, bone.column + k], "xyz".index(channel[0])
            if channel.endswith("position"):
                offset[:, axis] = values if bone.parent < 0 else offset[:, axis] + values
            else:
                turn = turn * Rotation.from_euler("XYZ"[axis], np.radians(values)[:, None])
        if bone.parent < 0:
            positions[:, i] = offset
            turned.append(turn)
        else:
            positions[:, i] = positions[:, bone.parent] + turned[bone.parent].apply(offset)
            turned.append(turned[bone.parent] * turn)
    return positions


def _place_of(name: str) -> str | None:
    """Our joint ("left_knee", "head", "left_toe") of a BVH joint's name, None if it is none of them."""
    plain = re.sub(r"[^a-z0-9]", "", name.rpartition(":")[2].casefold())
    for prefix, side in (("left", "left_"), ("right", "right_"), ("l", "left_"), ("r", "right_")):
        kind = _NAMES.get(plain.removeprefix(prefix)) if plain.startswith(prefix) else None
        if kind not in (None, "pelvis", "neck", "head"):
            return f"{side}{kind}"
    kind = _NAMES.get(plain)
    return kind if kind in ("pelvis", "neck", "head") else None


def _markers(path: Path, bones: list[Bone], centres: Float64, rate: float) -> tuple[Markers, MarkerSet]:
    places: dict[str, int] = {}
    for i, bone in enumerate(bones):
        place = _place_of(bone.name)
        if place:
            places.setdefault(place, i)
    for end, of in (("head_end", "head"), ("left_hand_end", "left_wrist"), ("right_hand_end", "right_wrist")):
        tip = next((i for i, bone in enumerate(bones) if bone.parent == places.get(of)), None)
        if tip is not None and math.hypot(*bones[tip].offset) > 0:
            places[end] = tip
    legs = [places.get(f"left_{joint}") for joint in ("hip", "knee", "ankle")]
    if len(places) < MIN_MARKERS or None in legs:
        raise CloudError(f"{path}: unknown joints ({', '.join(b.name for b in bones[:6])}, ...); rename them")
    leg = sum(math.hypot(*bones[i].offset) for i in legs[1:] if i is not None)
    if not leg > 0:
        raise FormatError(f"{path}: its legs have no length; export it again")
    rows = [_row(place) for place in places]
    joint, at, spread = (np.array(column) for column in zip(*rows, strict=True))
    names = tuple(places)
    markers = Markers(names, centres[:, list(places.values())] * LEG_M / leg, rate, "m", 1)
    return markers, MarkerSet("bvh", names, joint.astype(np.int64), at, spread, np.ones(len(names)))


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
