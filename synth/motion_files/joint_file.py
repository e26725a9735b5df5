"""Files of joints: takes of joint positions in one ``.npz``, or the rotations of an AMASS file.

AMASS holds only rotations; bone lengths would follow from SMPL's body model, whose licence forbids shipping
it. All rotations are about the axes of one T-pose. So they can drive any body with SMPL's joints in a T-pose,
here the reference body of this project.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64, Int64
from sensors.errors import CloudError, FormatError, fault_of
from sensors.files.npz import array_sizes, load_arrays
from synth.body.body import reference_body
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, alignment, forward
from synth.motion_files.joint_places import marker_set_of_joints
from synth.motion_files.marker_files import POSE_RATE, Markers
from synth.motion_files.marker_set import MarkerSet, known_markers
from synth.motion_files.vertical_axis import GIVEN, Upward

REMEDY = "give joint_names (J,), takes of shape (F, J, 3), and optionally parents (J,)"
# Arrays of which a file of joints has one: names, rotations of AMASS, or places of SMPL's joints.
JOINT_ARRAYS = {"joint_names", "poses", "joints", "joints3d", "joints_3d", "joint_positions", "smpl_joints"}
MAX_BYTES = 1_000_000_000  # of an unpacked file: six hours of 40 joints at 30 frames/s in int16 take 150 MB
FRAMES_PER_SECOND = 30.0  # of a file without a rate: motion libraries are thinned to it
# Median over the frames of the fastest joint's way, by the leg's length: 7 m/s all the time at 30 frames a
# second; untuned.
SEPARATE_WAY = 0.3
# names of the rate: ours, others', AMASS's of SMPL+H and of SMPL-X
_RATES = ("frames_per_second", "fps", "mocap_framerate", "mocap_frame_rate")
_EXTRAS = {"joint_names", "parents", *_RATES}
# Our joint at each of SMPL's 24, in SMPL's order; "" for its two points on each limb's end.
_OURS = {
    "Pelvis": "pelvis", "L_Hip": "left_hip", "R_Hip": "right_hip", "Spine1": "spine_lower",
    "L_Knee": "left_knee", "R_Knee": "right_knee", "Spine2": "spine_middle",
    "L_Ankle": "left_ankle", "R_Ankle": "right_ankle", "Spine3": "spine_upper",
    "L_Foot": "", "R_Foot": "", "Neck": "neck", "L_Collar": "left_clavicle", "R_Collar": "right_clavicle",
    "Head": "head", "L_Shoulder": "left_shoulder", "R_Shoulder": "right_shoulder",
    "L_Elbow": "left_elbow", "R_Elbow": "right_elbow", "L_Wrist": "left_wrist", "R_Wrist": "right_wrist",
    "L_Hand": "", "R_Hand": "",
}  # fmt: skip
SMPL_JOINTS = tuple(_OURS)
SMPL_PARENTS = np.array(
    [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21], np.int64
)
SMPL_COUNTS = (22, 24)  # joints of SMPL without and with the knuckles
BODY = 22  # joints whose rotations come first in SMPL, SMPL+H and SMPL-X
# ball of the foot from the ankle, knuckles from the wrist, along SMPL's axes; untuned
_FOOT_M, _HAND_M = (0.0, -0.06, 0.13), 0.085


@dataclass(frozen=True)
class _Joints:
    """Names of J joints, their parents (J,), takes (F, J, 3) by name, and a sentence on each assumption."""

    names: tuple[str, ...]
    parents: Int64
    takes: dict[str, Float64]
    assumed: tuple[str, ...] = ()


def read_joint_file(path: Path) -> tuple[dict[str, Markers], MarkerSet]:
    """Read takes by name, their joints as markers in metres (see ``joint_places``), and the marker set.

    The file holds joint_names (J,) text, parents (J,) indices (-1 for the root; optional) and arrays (F, J,
    3), each a take. Or it holds one array "joints" (F, 22 or 24, 3) in SMPL's order, or AMASS's poses and
    trans. The rate is frames_per_second, else 30, or 1 for separate poses. Unit (m, cm, mm) and vertical axis
    follow from size and
    stance. Raises FormatError for other content, CloudError for unknown joints or another skeleton than a
    person's.
    """
    named = "joint_names" in array_sizes(path, REMEDY)
    wanted = None if named else JOINT_ARRAYS | {"trans", *_RATES}
    arrays = load_arrays(path, MAX_BYTES, REMEDY, wanted)
    try:
        found = _joints(path.stem, arrays)
        together = np.concatenate(list(found.takes.values()))
        columns, places, leg = marker_set_of_joints(found.names, found.parents, together)
        rate, lines = _rate(arrays, [take[:, columns] for take in found.takes.values()], leg)
        whole = known_markers(Markers(places.names, together[:, columns], rate), places)
    except CloudError as error:
        raise type(error)(f"{path}: {error}", *error.settings) from error
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({fault_of(error)}); {REMEDY}") from error
    up, assumed = Upward(whole.up, GIVEN), (*found.assumed, *whole.assumed, *lines)
    markers = {
        name: Markers(places.names, take[:, columns], rate, whole.unit, up, assumed)
        for name, take in found.takes.items()
    }
    return markers, places


def read_joints(path: Path) -> tuple[Markers, MarkerSet]:
    """Return the only take of a file, and its marker set. Raises CloudError for several takes, and as
    ``read_joint_file``.
    """
    takes, places = read_joint_file(path)
    if len(takes) > 1:
        raise CloudError(f"{path} has {len(takes)} takes; give the file to 'synth film' or 'synth generate'")
    return next(iter(takes.values())), places


def _rate(arrays: dict[str, NDArray[Any]], takes: list[Float64], leg: float) -> tuple[float, tuple[str, ...]]:
    """Return frames a second and sentences on its assumption. leg: its length in the takes' unit."""
    stated = next((float(arrays[name]) for name in _RATES if name in arrays), None)
    if stated is not None:
        return stated, ()
    ways = [np.nan_to_num(np.linalg.norm(np.diff(take, axis=0), axis=2)).max(axis=1) for take in takes]
    between = np.concatenate(ways)
    if len(between) and np.median(between) > SEPARATE_WAY * leg:
        return POSE_RATE, ("no rate is stated; the frames are taken to be separate poses; else give fps",)
    return FRAMES_PER_SECOND, ()


def _joints(stem: str, arrays: dict[str, NDArray[Any]]) -> _Joints:
    if "joint_names" in arrays:
        return _named(arrays)
    if "poses" in arrays:
        if "trans" not in arrays:
            raise FormatError("it holds poses without trans; give AMASS's file as it is, or joint positions")
        places = joints_of_rotations(_numbers("poses", arrays["poses"]), _numbers("trans", arrays["trans"]))
        line = "SMPL's rotations turn a body of this project, 1.70 m tall, in place of the person's own"
        return _Joints(SMPL_JOINTS[:BODY], SMPL_PARENTS[:BODY], {stem: places}, (line,))
    takes = {name: a for name, a in arrays.items() if name in JOINT_ARRAYS}
    counts = {a.shape[1] if a.ndim == 3 else 0 for a in takes.values()}
    if len(counts) != 1 or not counts <= set(SMPL_COUNTS):
        shapes = ", ".join(f"{name} {a.shape}" for name, a in takes.items())
        raise FormatError(f"{shapes} without joint_names is not (F, 22 or 24, 3) of SMPL; {REMEDY}")
    count = counts.pop()
    line = f"{count} joints without names are taken to be SMPL's, in SMPL's order"
    return _Joints(
        SMPL_JOINTS[:count], SMPL_PARENTS[:count], {n: _take(n, a, count) for n, a in takes.items()}, (line,)
    )


def _named(arrays: dict[str, NDArray[Any]]) -> _Joints:
    names = tuple(str(name) for name in arrays["joint_names"])
    parents = arrays["parents"].astype(np.int64) if "parents" in arrays else np.full(len(names), -1)
    if parents.shape != (len(names),):
        raise FormatError(f"parents are {parents.shape} for {len(names)} joints; {REMEDY}")
    if not ((parents >= -1) & (parents < len(names))).all():
        raise FormatError(f"parents are {parents.min()} to {parents.max()}; give -1 to {len(names) - 1}")
    takes = {name: _take(name, a, len(names)) for name, a in arrays.items() if name not in _EXTRAS}
    if not takes:
        raise FormatError(f"it holds no take; {REMEDY}")
    return _Joints(names, parents, takes)


def _take(name: str, array: NDArray[Any], joints: int) -> Float64:
    if array.ndim != 3 or array.shape[1:] != (joints, 3) or not len(array) or array.dtype.kind not in "iuf":
        raise FormatError(f"{name[:40]!r} is {array.dtype} {array.shape} for {joints} joint_names; {REMEDY}")
    return np.asarray(array, np.float64)


def _numbers(name: str, array: NDArray[Any]) -> Float64:
    if array.dtype.kind not in "iuf" or not array.size:
        raise FormatError(f"{name} is {array.dtype} {array.shape}; give numbers of one frame or more")
    if not np.isfinite(array).all():
        raise FormatError(f"{name} has values that are not finite; copy the file again")
    return np.asarray(array, np.float64)


def joints_of_rotations(poses: Float64, root_m: Float64) -> Float64:
    """Return the positions (F, 22, 3) of SMPL's joints, metres, in the file's axes.

    poses: (F, 3 n) axis-angle rotations of n joints, at least 22. root_m: (F, 3). Raises FormatError for
    other shapes.
    """
    frames = len(poses)
    if poses.ndim != 2 or poses.shape[1] < 3 * BODY or poses.shape[1] % 3 or root_m.shape != (frames, 3):
        raise FormatError(
            f"poses are {poses.shape} and trans {root_m.shape}; give (F, 66 or more) and (F, 3)"
        )
    rest = _t_pose_m()
    turns = [Rotation.from_rotvec(poses[:, 3 * j : 3 * j + 3]) for j in range(BODY)]
    places = np.empty((frames, BODY, 3))
    places[:, 0] = root_m
    for j in range(1, BODY):
        parent = int(SMPL_PARENTS[j])
        places[:, j] = places[:, parent] + turns[parent].apply(rest[j] - rest[parent])
        turns[j] = turns[parent] * turns[j]
    return places


def _t_pose_m() -> Float64:
    """Return SMPL's joints (24, 3) in a T-pose: x to the left, y up, z ahead."""
    body = reference_body()
    angles = np.zeros((N_JOINTS, 3))
    for side in ("left", "right"):
        angles[JOINT_ID[f"{side}_shoulder"], 1] = np.pi / 2
    _, joints = forward(Posture(angles, np.zeros(3)), body.joints_m, alignment(body.joints_m))
    ours = joints @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    places = np.array([ours[JOINT_ID[name]] if name else np.zeros(3) for name in _OURS.values()])
    for j, name in enumerate(SMPL_JOINTS):
        if name.endswith("Foot"):
            places[j] = places[SMPL_PARENTS[j]] + _FOOT_M
        elif name.endswith("Hand"):
            places[j] = places[SMPL_PARENTS[j]] + [_HAND_M if name[0] == "L" else -_HAND_M, 0, 0]
    return places
