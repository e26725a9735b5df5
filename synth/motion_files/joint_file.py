"""Files of joints: takes of people's joint positions in one ``.npz``, or the rotations of an AMASS file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64, Int64
from sensors.errors import CloudError, FormatError
from sensors.files.npz import array_sizes, load_arrays
from synth.motion_files.archives import JOINT_ARRAYS, JOINTS_REMEDY
from synth.motion_files.joint_places import marker_set_of_joints
from synth.motion_files.marker_files import Markers
from synth.motion_files.marker_set import MarkerSet, known_markers
from synth.motion_files.smpl import BODY, SMPL_COUNTS, SMPL_JOINTS, SMPL_PARENTS, joints_of_rotations
from synth.motion_files.vertical_axis import GIVEN, Upward

MAX_BYTES = 1_000_000_000
"""Of a file unpacked: six hours of 40 joints at 30 frames/s in int16 take 150 MB."""
FRAMES_PER_SECOND = 30.0
"""Where the file has none: what motion libraries are thinned to."""
_RATES = ("frames_per_second", "fps", "mocap_framerate", "mocap_frame_rate")
"""Names of the rate: ours, others', AMASS's of SMPL+H and of SMPL-X."""
_EXTRAS = {"joint_names", "parents", *_RATES}


@dataclass(frozen=True)
class _Joints:
    """Names of J joints, their parents (J,), takes (F, J, 3) by name, and a line on each assumption."""

    names: tuple[str, ...]
    parents: Int64
    takes: dict[str, Float64]
    assumed: tuple[str, ...] = ()


def read_joint_file(path: Path) -> tuple[dict[str, Markers], MarkerSet]:
    """Takes by name, their joints as markers in metres (see ``joint_places``), and the set of these.

    The file holds joint_names (J,) text, parents (J,) indices (-1 for the root; they may be left out) and
    arrays (F, J, 3) of numbers, each a take; or one array "joints" (F, 22 or 24, 3) in SMPL's order; or
    AMASS's poses and trans. frames_per_second, else 30. Unit (m, cm, mm) and vertical axis are found by the
    people's size and stance. Raises FormatError where it holds something else, CloudError when its joints are
    unknown or no person's.
    """
    named = "joint_names" in array_sizes(path, JOINTS_REMEDY)
    wanted = None if named else JOINT_ARRAYS | {"trans", *_RATES}
    arrays = load_arrays(path, MAX_BYTES, JOINTS_REMEDY, wanted)
    try:
        found = _joints(path.stem, arrays)
        rate = next((float(arrays[name]) for name in _RATES if name in arrays), FRAMES_PER_SECOND)
        together = np.concatenate(list(found.takes.values()))
        columns, places, _ = marker_set_of_joints(found.names, found.parents, together)
        whole = known_markers(Markers(places.names, together[:, columns], rate), places)
    except CloudError as error:
        raise type(error)(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({error}); {JOINTS_REMEDY}") from error
    up, assumed = Upward(whole.up, GIVEN), (*found.assumed, *whole.assumed)
    markers = {
        name: Markers(places.names, take[:, columns], rate, whole.unit, up, assumed)
        for name, take in found.takes.items()
    }
    return markers, places


def read_joints(path: Path) -> tuple[Markers, MarkerSet]:
    """Return the only take of a file of joints, and its marker set. Raises CloudError as ``read_joint_file``
    does, and where the file has several takes."""
    takes, places = read_joint_file(path)
    if len(takes) > 1:
        raise CloudError(
            f"{path} has {len(takes)} takes; give the file to 'synth film --take' or 'synth generate'"
        )
    return next(iter(takes.values())), places


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
        raise FormatError(f"{shapes} without joint_names is no (F, 22 or 24, 3) of SMPL; {JOINTS_REMEDY}")
    count = counts.pop()
    line = f"{count} joints without names are taken to be SMPL's, in SMPL's order"
    return _Joints(
        SMPL_JOINTS[:count], SMPL_PARENTS[:count], {n: _take(n, a, count) for n, a in takes.items()}, (line,)
    )


def _named(arrays: dict[str, NDArray[Any]]) -> _Joints:
    names = tuple(str(name) for name in arrays["joint_names"])
    parents = arrays["parents"].astype(np.int64) if "parents" in arrays else np.full(len(names), -1)
    if parents.shape != (len(names),) or not ((parents >= -1) & (parents < len(names))).all():
        raise FormatError(f"parents are {parents.shape}; {JOINTS_REMEDY}")
    takes = {name: _take(name, a, len(names)) for name, a in arrays.items() if name not in _EXTRAS}
    if not takes:
        raise FormatError(f"it holds no take; {JOINTS_REMEDY}")
    return _Joints(names, parents, takes)


def _take(name: str, array: NDArray[Any], joints: int) -> Float64:
    if array.ndim != 3 or array.shape[1:] != (joints, 3) or not len(array) or array.dtype.kind not in "iuf":
        raise FormatError(f"{name[:40]!r} is {array.dtype} {array.shape}; {JOINTS_REMEDY}")
    return np.asarray(array, np.float64)


def _numbers(name: str, array: NDArray[Any]) -> Float64:
    if array.dtype.kind not in "iuf" or not len(array) or not np.isfinite(array).all():
        raise FormatError(f"{name} are no finite numbers; copy the file again")
    return np.asarray(array, np.float64)
