"""BVH files: a skeleton's own rotations become points at its joints, and those are solved like markers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError
from sensors.files.bounded import read_bounded
from synth.motion_files.bvh_text import Bone, BvhText, parse_bvh
from synth.motion_files.joint_places import marker_set_of_joints
from synth.motion_files.marker_files import Markers
from synth.motion_files.marker_names import key_of
from synth.motion_files.marker_set import MIN_MARKERS, MarkerSet
from synth.motion_files.vertical_axis import Upward, zero_pose_axis

MAX_FILE_BYTES = 300_000_000
"""A quarter of an hour of 100 joints at 120 frames/s."""
MAX_CENTRES = 20_000_000
"""Frames times joints, about 60 bytes and 2 us each: half an hour of 100 joints at 120 frames/s."""
LEG_M = 0.82
"""BVH has no unit: the skeleton is scaled to this length from hip to ankle."""
STILL = 1e-3
"""Share of its offset that a joint moves at most by position channels without content. Untuned."""


def read_bvh(path: Path) -> tuple[Markers, MarkerSet]:
    """Read the joint centres of a BVH as markers in metres, in the file's axes, and the set of these joints.

    Raises FormatError when the file is damaged or of impossible size, CloudError when its joints are unknown.
    """
    data = read_bounded(path, MAX_FILE_BYTES, "cut the motion")
    try:
        text = parse_bvh(data)
        if len(text.rows) * len(text.bones) > MAX_CENTRES:
            raise FormatError(f"{len(text.rows)} frames of {len(text.bones)} joints; cut the motion")
        return _markers(text)
    except (ValueError, IndexError) as error:
        raise FormatError(f"{path}: damaged BVH ({error}); export it again") from error
    except CloudError as error:
        raise type(error)(f"{path}: {error}") from error


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
    """Return flags of the bones that keep their OFFSET beside position channels, and a line on them.

    Position channels replace the OFFSET in Blender's ``import_bvh.py``, bvhio (issue 5) and Holden's
    ``BVH.py`` (DeepMotionEditing); three.js (``BVHLoader.js``) adds them to it. Where the positions of most
    joints lead less than half way along the OFFSET, they are displacements; positions that stay 0 are none.
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
    """Return a line where a file has several skeletons whose joints have the names of the first: those are
    used."""
    people: list[set[str]] = []
    for bone in bones:
        if bone.parent < 0:
            people.append(set())
        people[-1].add(key_of(bone.name))
    alike = [own for own in people if len(own & people[0]) >= MIN_MARKERS]
    return (f"the file holds {len(alike)} people; the first is used",) if len(alike) > 1 else ()


def _centres(bones: list[Bone], rows: Float64, keep: list[bool]) -> Float64:
    """Return the world positions (F, B, 3) of all joints, in the file's unit.

    keep: bones that keep their OFFSET.
    """
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
