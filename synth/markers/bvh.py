"""BVH files: a skeleton's own rotations become points at its joints, and those are solved like markers."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import read_bounded
from synth.markers.joint_places import marker_set_of_joints
from synth.markers.marker_files import Markers
from synth.markers.markerset import MarkerSet, upright_axis

MAX_FILE_BYTES = 300_000_000
"""A quarter of an hour of 100 joints at 120 frames/s."""
MAX_CENTRES = 20_000_000
"""Frames times joints, about 60 bytes and 2 us each: half an hour of 100 joints at 120 frames/s."""
LEG_M = 0.82
"""BVH has no unit: the skeleton is scaled to this length from hip to ankle."""
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


def _markers(path: Path, bones: list[Bone], centres: Float64, rate: float) -> tuple[Markers, MarkerSet]:
    parents = np.array([bone.parent for bone in bones])
    try:
        columns, places, leg = marker_set_of_joints([bone.name for bone in bones], parents, centres)
    except CloudError as error:
        raise type(error)(f"{path}: {error}") from error
    still = _centres(bones, np.zeros((1, sum(len(bone.channels) for bone in bones))))
    up = upright_axis(still[:, columns], places)
    return Markers(places.names, centres[:, columns] * LEG_M / leg, rate, "m", up), places
