"""Files of joint positions: many takes of people's joints in one ``.npz``, as of motion libraries."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError
from sensors.files.npz import load_arrays
from synth.markers.archives import JOINTS_REMEDY
from synth.markers.joint_places import marker_set_of_joints
from synth.markers.marker_files import Markers
from synth.markers.markerset import MarkerSet, known_markers
from synth.markers.vertical import GIVEN, Upward

MAX_BYTES = 1_000_000_000
"""Of a file unpacked: six hours of 40 joints at 30 frames/s in int16 take 150 MB."""
FRAMES_PER_SECOND = 30.0
"""Where the file has none: what motion libraries are thinned to."""
_EXTRAS = {"joint_names", "parents", "frames_per_second"}


def read_joint_file(path: Path) -> tuple[dict[str, Markers], MarkerSet]:
    """Takes by name, their joints as markers in metres (see ``joint_places``), and the set of these.

    The file holds joint_names (J,) text, parents (J,) indices (-1 for the root) and arrays (F, J, 3) of
    numbers, each a take; frames_per_second, else 30. Unit (m, cm, mm) and vertical axis are found by the
    people's size and stance. Raises FormatError where it holds something else, CloudError when its joints are
    unknown or no person's.
    """
    arrays = load_arrays(path, MAX_BYTES, JOINTS_REMEDY)
    try:
        names = [str(name) for name in arrays["joint_names"]]
        parents = arrays["parents"].astype(np.int64)
        rate = float(arrays.get("frames_per_second", FRAMES_PER_SECOND))
        takes = {name: _take(name, a, len(names)) for name, a in arrays.items() if name not in _EXTRAS}
        if parents.shape != (len(names),) or not ((parents >= -1) & (parents < len(names))).all():
            raise FormatError(f"parents are {parents.shape}; {JOINTS_REMEDY}")
        if not takes:
            raise FormatError(f"it holds no take; {JOINTS_REMEDY}")
        columns, places, _ = marker_set_of_joints(names, parents, np.concatenate(list(takes.values())))
    except CloudError as error:
        raise type(error)(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({error}); {JOINTS_REMEDY}") from error
    known = {name: take[:, columns] for name, take in takes.items()}
    together = Markers(places.names, np.concatenate(list(known.values())), rate)
    up = Upward(known_markers(together, places).up, GIVEN)
    return {name: Markers(places.names, take, rate, "", up) for name, take in known.items()}, places


def _take(name: str, array: NDArray[Any], joints: int) -> Float64:
    if array.ndim != 3 or array.shape[1:] != (joints, 3) or not len(array) or array.dtype.kind not in "iuf":
        raise FormatError(f"{name[:40]!r} is {array.dtype} {array.shape}; {JOINTS_REMEDY}")
    return np.asarray(array, np.float64)
