"""ITOP's test images as published: HDF5 files of depth and labels (Haque et al., ECCV 2016).

``ITOP_VIEW_test_depth_map.h5`` holds ``data`` (n, 240, 320), float16 metres, and ``id`` (n,), "PERSON_FRAME".
``ITOP_VIEW_test_labels.h5`` holds ``id``, ``is_valid`` (n,), ``visible_joints`` (n, 15) and
``real_world_coordinates`` (n, 15, 3), float16 metres, x right, y up, z forward. Only valid frames are read.
Sizes are checked before memory is taken, and no link to another file is followed.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from annotate.array_types import Int64
from eval.benchmark.benchmark_set import BenchmarkSet
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame, mm_from_metres, regular_times_ns
from sensors.rig.rig_calibration import RigCalibration

if TYPE_CHECKING:
    import h5py

VIEWS = ("side", "top")
CAMERA = Intrinsics(320, 240, 1 / 0.0035, 1 / 0.0035, 160.0, 120.0)
"""Camera of both views: x = (u - 160) 0.0035 z, in the code of V2V-PoseNet and of A2J."""
JOINTS = (
    *("head", "neck", "right_shoulder", "left_shoulder", "right_elbow", "left_elbow", "right_hand"),
    *("left_hand", "torso", "right_hip", "left_hip", "right_knee", "left_knee", "right_foot", "left_foot"),
)
"""ITOP's order; left and right are the person's own."""
KINDS = {"iub": "integers", "f": "floats", "SO": "texts"}
"""Codes of ``numpy.dtype.kind`` of ITOP's datasets, and their names."""
MAX_FRAMES = 200_000  # five times the frames of ITOP's largest file; bounds memory
MAX_CHUNK_BYTES = 1 << 24  # of a block, unpacked as a whole; 100 frames of ITOP
MAX_ITEM_BYTES = 64  # of a number or an id; ITOP's ids have 8


def paths_of(folder: Path, view: str) -> tuple[Path, Path]:
    """Return the paths of a view's depth images and labels. view: "side" or "top"."""
    return folder / f"ITOP_{view}_test_depth_map.h5", folder / f"ITOP_{view}_test_labels.h5"


def read_itop(folder: Path, view: str) -> BenchmarkSet:
    """Return a view's valid test frames with their true joints; images are read when used.

    Raises FormatError where a file is not in ITOP's layout.
    """
    images, labels = paths_of(folder, view)
    with _opened(labels) as file:
        ids = _ids(file)
        n, m = len(ids), len(JOINTS)
        valid = np.flatnonzero(_array(file, "is_valid", (n,), "iub")[()] == 1)
        true_m = _array(file, "real_world_coordinates", (n, m, 3), "f")[()][valid].astype(np.float64)
        visible = _array(file, "visible_joints", (n, m), "iub")[()][valid] == 1
    if not len(valid):
        raise FormatError(f"{labels} has no valid frame; download it again")
    if not np.isfinite(true_m).all():
        raise FormatError(f"{labels} has joints of valid frames that are not finite; download it again")
    with _opened(images) as file:
        _array(file, "data", (n, *CAMERA.shape), "f")
        if _ids(file) != ids:
            raise FormatError(f"{images} has other ids than {labels.name}; give files of one release")
    subjects = tuple(f"person {ids[i].split('_')[0]}" for i in valid)
    return BenchmarkSet(ItopFrames(images, valid), JOINTS, true_m * (1.0, -1.0, 1.0), visible, subjects)


class ItopFrames(FrameSource):
    """Frame source over a checked file of ITOP's depth images. chosen: ascending image indices (F,)."""

    notes = ("no colour images", "no thermal images")

    def __init__(self, path: Path, chosen: Int64) -> None:
        self._file, self._chosen = path, chosen
        self.path, self.name = path, path.stem
        self.calibration = RigCalibration(CAMERA)
        self.times_ns = regular_times_ns(int(chosen[-1]) + 1)[chosen]

    def _frame(self, index: int) -> RigFrame:
        with _opened(self._file) as file:
            depth_mm = mm_from_metres(file["data"][int(self._chosen[index])])
        return RigFrame(index, int(self.times_ns[index]), depth_mm)


@contextmanager
def _opened(path: Path) -> "Iterator[h5py.File]":
    """Open an HDF5 file. Raises FormatError for a file that h5py cannot open or read."""
    import h5py

    packed = path.with_name(f"{path.name}.gz")
    if not path.is_file():
        raise FormatError(f"{path} is missing; {'unpack its .gz' if packed.exists() else 'download it'}")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{path} cannot be read ({error}); download it again") from error


def _array(file: "h5py.File", name: str, shape: tuple[int, ...] | None, kinds: str) -> "h5py.Dataset":
    """Return the dataset ``name`` without reading its values.

    shape: required, None = (n,). kinds: a key of ``KINDS``. Raises FormatError for a
    missing, different or too large dataset.
    """
    import h5py

    where = f"{file.filename}: {name!r}"
    if (link := file.get(name, getlink=True)) is None:
        raise FormatError(f"{where} is missing; download it again")
    data = file[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(data, h5py.Dataset) or data.is_virtual or data.external:
        raise FormatError(f"{where} is not an array of this file; download it again")
    shape = shape or (data.size if data.ndim == 1 and data.size else 1,)
    if data.shape != shape or shape[0] > MAX_FRAMES or data.dtype.kind not in kinds:
        raise FormatError(
            f"{where} is {data.dtype} {data.shape}; give {KINDS[kinds]} {shape}, at most {MAX_FRAMES} frames,"
            " as ITOP publishes them"
        )
    sizes = [data.dtype.itemsize * math.prod(data.chunks or (1,))]
    if data.chunks:
        data.id.chunk_iter(lambda chunk: sizes.append(chunk.size))
    for what, size, most in (
        ("values", data.dtype.itemsize, MAX_ITEM_BYTES),
        ("blocks", max(sizes), MAX_CHUNK_BYTES),
    ):
        if size > most:
            raise FormatError(
                f"{where} has {what} of {size} bytes; give at most {most}, as ITOP publishes it"
            )
    return data


def _ids(file: "h5py.File") -> list[str]:
    """Return the ids of all frames. Raises FormatError for too many or malformed ids."""
    data = _array(file, "id", None, "SO")
    ids = []
    for i in range(len(data)):
        value = data[i]
        if not isinstance(value, bytes) or len(value) > MAX_ITEM_BYTES:
            raise FormatError(
                f"{file.filename}: 'id' holds another value than a short text; download it again"
            )
        ids.append(value.decode("ascii", "replace"))
    return ids
