"""BVH files: a skeleton's rotations are converted to joint positions, which are solved like markers.

Nonconforming files are read too. Names may contain blanks (3ds Max Biped: "Bip01 L Thigh") and be in Latin-1.
Numbers may have decimal commas. The stated number of frames may be wrong; Blender ignores it too
(``io_anim_bvh/import_bvh.py``).
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError, fault_of
from sensors.files.bounded import read_bounded
from synth.motion_files.joint_places import marker_set_of_joints
from synth.motion_files.marker_files import Markers
from synth.motion_files.marker_set import MIN_MARKERS, MarkerSet, key_of
from synth.motion_files.vertical_axis import Upward, zero_pose_axis

MAX_FILE_BYTES = 300_000_000  # a quarter of an hour of 100 joints at 120 frames/s
# frames times joints, 60 bytes and 2 us each: half an hour of 100 joints at 120 frames/s
MAX_CENTRES = 20_000_000
LEG_M = 0.82  # BVH has no unit: the skeleton is scaled to this length from hip to ankle
STILL = 1e-3  # share of its offset that a joint moves at most by empty position channels; untuned
FARTHEST = 1e9  # greater numbers are neither places nor angles
_BEGIN = re.compile(r"^[ \t]*HIERARCHY\b", re.IGNORECASE | re.MULTILINE)
_MIDDLE = re.compile(r"\bMOTION\s+(?=Frames\s*:)", re.IGNORECASE)
_CHANNEL = re.compile("[xyz](position|rotation)")


class Bone(NamedTuple):
    """Joint of a BVH: parent (-1 root), offset in the file's unit, channels and their first column."""

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]
    column: int


class BvhText(NamedTuple):
    """Bones of a BVH, values (F, C) of their channels, seconds per frame, and a sentence on each
    assumption.
    """

    bones: list[Bone]
    rows: Float64
    seconds: float
    assumed: list[str]


def read_bvh(path: Path) -> tuple[Markers, MarkerSet]:
    """Read joint centres as markers in metres, in the file's axes, and the marker set of these joints.

    Raises FormatError for a damaged or too large file, CloudError for unknown joints.
    """
    data = read_bounded(path, MAX_FILE_BYTES, "cut the motion")
    try:
        text = parse_bvh(data)
        if len(text.rows) * len(text.bones) > MAX_CENTRES:
            raise FormatError(
                f"the motion has {len(text.rows)} frames of {len(text.bones)} joints; cut it to at most "
                f"{MAX_CENTRES} joint positions in all"
            )
        return _markers(text)
    except (ValueError, IndexError) as error:
        raise FormatError(f"{path} is a damaged BVH ({fault_of(error)}); export it again") from error
    except CloudError as error:
        raise type(error)(f"{path}: {error}", *error.settings) from error


def _markers(text: BvhText) -> tuple[Markers, MarkerSet]:
    bones, rows = text.bones, text.rows
    kept, line = _keeping_offset(bones, rows)
    centres = _centres(bones, rows, kept)
    parents = np.array([bone.parent for bone in bones])
    columns, places, leg = marker_set_of_joints([bone.name for bone in bones], parents, centres)
    still = _centres(bones, np.zeros((1, rows.shape[1])), [True] * len(bones))
    axis = zero_pose_axis(still[:, columns], places.joint)
    scale = f"no unit is stated; the leg is taken to be {LEG_M} m long"
    line = (*_several_people(bones), *line)
    found = Markers(places.names, centres[:, columns] * LEG_M / leg, 1 / text.seconds, "m")
    up = Upward(axis, "the zero pose" if axis else "", "y")
    return replace(found, up=up, assumed=(*text.assumed, *line, scale)), places


def _keeping_offset(bones: list[Bone], rows: Float64) -> tuple[list[bool], tuple[str, ...]]:
    """Return flags of the bones whose OFFSET is added to their position channels, and a sentence on them.

    Position channels replace the OFFSET in Blender's ``import_bvh.py``, bvhio (issue 5) and Holden's
    ``BVH.py`` (DeepMotionEditing); three.js (``BVHLoader.js``) adds them. Here they are added if positions of
    most joints lead less than half way along the OFFSET. Positions that stay 0 have no effect.
    """
    moved, shares = [], []
    for i, bone in enumerate(bones):
        columns = [c for c, channel in enumerate(bone.channels) if channel.endswith("position")]
        offset = np.array(bone.offset)
        if bone.parent < 0 or not columns or not offset.any():
            continue
        axes = ["xyz".index(bone.channels[c][0]) for c in columns]
        at = rows[:, bone.column + np.array(columns)]
        if np.abs(at).max() > STILL * np.linalg.norm(offset):
            moved.append(i)
            shares.append(float(np.median(at @ offset[axes])) / float(offset @ offset))
    added = bool(shares) and float(np.median(shares)) < 0.5
    keep = [
        bone.parent >= 0 and (added or (i not in moved and any(bone.offset))) for i, bone in enumerate(bones)
    ]
    if not moved:
        return keep, ()
    how = "are added to their OFFSET" if added else "replace their OFFSET"
    return keep, (f"positions of {len(moved)} joints beside the root {how}",)


def _several_people(bones: list[Bone]) -> tuple[str, ...]:
    people: list[set[str]] = []
    for bone in bones:
        if bone.parent < 0:
            people.append(set())
        people[-1].add(key_of(bone.name))
    alike = [own for own in people if len(own & people[0]) >= MIN_MARKERS]
    return (f"the file holds {len(alike)} people; the first is used",) if len(alike) > 1 else ()


def _centres(bones: list[Bone], rows: Float64, keep: list[bool]) -> Float64:
    """Return the world positions (F, B, 3) of all joints in the file's unit; ``keep`` marks kept OFFSETs."""
    positions = np.empty((len(rows), len(bones), 3))
    turned: list[Rotation] = []
    for i, bone in enumerate(bones):
        offset = np.tile(bone.offset, (len(rows), 1)).astype(float)
        turn = Rotation.identity(len(rows))
        for k, channel in enumerate(bone.channels):
            values, axis = rows[:, bone.column + k], "xyz".index(channel[0])
            if channel.endswith("position"):
                offset[:, axis] = offset[:, axis] + values if keep[i] else values
            else:
                turn = turn * Rotation.from_euler("XYZ"[axis], np.radians(values)[:, None])
        if bone.parent < 0:
            positions[:, i] = offset
            turned.append(turn)
        else:
            positions[:, i] = positions[:, bone.parent] + turned[bone.parent].apply(offset)
            turned.append(turned[bone.parent] * turn)
    return positions


def parse_bvh(data: bytes) -> BvhText:
    """Parse a BVH's bytes. Raises FormatError, ValueError or IndexError for damaged ones."""
    assumed: list[str] = []
    text = _decoded(data, assumed).rstrip("\0\x1a \t\r\n")
    begin, middle = _BEGIN.search(text), _MIDDLE.search(text)
    if begin is None:
        raise FormatError("the file has no HIERARCHY; give a BVH file")
    hierarchy, motion = text[begin.end() :], ""
    if middle is not None:
        hierarchy, motion = text[begin.end() : middle.start()], text[middle.end() :]
    bones = _hierarchy(hierarchy.split())
    rows, seconds = _motion(motion.replace(",", "."), sum(len(bone.channels) for bone in bones), assumed)
    return BvhText(bones, rows, seconds, assumed)


def _decoded(data: bytes, assumed: list[str]) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        assumed.append("names are not in UTF-8 and are read as Latin-1")
        return data.decode("latin-1")


def _hierarchy(tokens: list[str]) -> list[Bone]:
    bones: list[Bone] = []
    open_bones: list[int] = []
    at, columns, name = 0, 0, ""
    while at < len(tokens):
        word = tokens[at].upper()
        if word in ("ROOT", "JOINT", "END"):
            brace = tokens.index("{", at)
            name = " ".join(tokens[at + 1 : brace]) if word != "END" else f"{bones[open_bones[-1]].name}_end"
            at = brace
        elif word == "{":
            bone, at = _bone(tokens, at + 1, name, columns, open_bones[-1] if open_bones else -1)
            bones.append(bone)
            open_bones.append(len(bones) - 1)
            columns += len(bone.channels)
        elif word == "}":
            open_bones.pop()
            at += 1
        else:
            raise FormatError(f"{tokens[at][:40]!r} is not a BVH keyword; export it again")
    if open_bones or not columns:
        raise FormatError("the hierarchy is cut short; copy it again")
    return bones


def _bone(tokens: list[str], at: int, name: str, column: int, parent: int) -> tuple[Bone, int]:
    if tokens[at].upper() != "OFFSET":
        raise FormatError(f"joint {name[:40]!r} has no OFFSET; export it again")
    x, y, z = (float(v.replace(",", ".")) for v in tokens[at + 1 : at + 4])
    if not max(abs(x), abs(y), abs(z)) < FARTHEST:
        raise FormatError(f"joint {name[:40]!r} has the OFFSET {x:g} {y:g} {z:g}; export it again")
    at += 4
    channels: tuple[str, ...] = ()
    if tokens[at].upper() == "CHANNELS":
        count = int(tokens[at + 1])
        channels = tuple(c.lower() for c in tokens[at + 2 : at + 2 + count])
        if len(channels) != count or not all(map(_CHANNEL.fullmatch, channels)):
            shown = " ".join(channels)[:60]
            raise FormatError(f"joint {name[:40]!r} has {count} channels, read as {shown!r}; export it again")
        at += 2 + count
    return Bone(name, parent, (x, y, z), channels, column), at


def _motion(text: str, columns: int, assumed: list[str]) -> tuple[Float64, float]:
    head = re.match(r"\s*Frames\s*:\s*(\d+)\s+Frame\s+Time\s*:\s*(\S+)", text, re.IGNORECASE)
    if head is None:
        raise FormatError("the file has no number of frames with a frame time; copy it again")
    stated, seconds = int(head[1]), float(head[2])
    if not 1e-4 <= seconds <= 1:
        raise FormatError(f"the frame time is {seconds}; give seconds from 0.0001 to 1")
    body = text[head.end() :]
    numbers = np.fromstring(body, sep=" ")
    whole = stated if numbers.size == stated * columns else _whole_rows(body, numbers.size, columns)
    if not whole or not (np.abs(numbers) < FARTHEST).all():
        held = f"the file claims {stated} frames of {columns} finite numbers and holds {numbers.size}"
        raise FormatError(f"{held}; copy it again")
    if rest := numbers.size - whole * columns:
        assumed.append(f"the last frame is cut off after {rest} of {columns} numbers and was left out")
    if whole != stated:
        assumed.append(f"frames: the file states {stated} and holds {whole}")
    return numbers[: whole * columns].reshape(whole, columns), seconds


def _whole_rows(body: str, numbers: int, columns: int) -> int:
    """Return the number of whole rows; 0 unless each row has ``columns`` numbers, the last perhaps fewer."""
    lengths = [len(line.split()) for line in body.splitlines() if line.strip()]
    alike = all(length == columns for length in lengths[:-1]) and sum(lengths) == numbers
    return numbers // columns if lengths and alike and lengths[-1] <= columns else 0
