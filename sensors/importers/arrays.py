"""Depth images in NumPy files (.npy, .npz) as a source of frames; nothing in them is ever executed.

A .npy holds depth (h, w) or (n, h, w), integers in millimetres or floats in metres. A .npz holds it as
``depth``, or as its only array; ``K``, the 3x3 camera matrix, may lie beside it. Otherwise intrinsics are in
``NAME.json`` or ``intrinsics.json`` beside the file (see ``intrinsics_file``).
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError, FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.npz import array_sizes, load_arrays
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame, mm_from_metres, mm_from_units, regular_times_ns
from sensors.rig.intrinsics_file import first_intrinsics
from sensors.rig.rig_calibration import RigCalibration

NPY_MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK\x03\x04"
MAX_UNPACKED_BYTES = 1 << 30
"""Bytes of a .npz's depth and K, which are unpacked into memory as a whole; chosen by eye."""

_READ = ("depth", "K")


class DepthArrays(FrameSource):
    """A NumPy file as a ``FrameSource``. Raises FormatError, or CalibrationError without intrinsics.

    notes: what is absent, where the intrinsics are from.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.stem
        arrays, names = _load(path)
        self._depth = _depth(path, arrays, names)
        camera, self._unit_mm, origin = _intrinsics(path, arrays.get("K"), self._depth.shape[1:])
        self.calibration, self.times_ns = RigCalibration(camera), regular_times_ns(len(self._depth))
        unread = sorted(set(names) - set(arrays))
        self.notes = (
            origin,
            *(f"array {name[:60]!r} is not read" for name in unread),
            "no colour images",
            "no thermal images",
            "no time stamps: 30 frames a second assumed",
        )

    def _frame(self, index: int) -> RigFrame:
        image = self._depth[index]
        whole = image.dtype.kind in "iu"
        depth_mm = mm_from_units(image, self._unit_mm) if whole else mm_from_metres(image)
        return RigFrame(index, int(self.times_ns[index]), depth_mm)


def _load(path: Path) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """``depth`` and ``K``, or the only array, by name, and the names of all; a .npy stays on disk."""
    remedy = "save depth as a .npy file, or split it"
    try:
        with path.open("rb") as file:
            single = file.read(len(NPY_MAGIC)) == NPY_MAGIC
        if single:
            return {"depth": np.load(path, mmap_mode="r", allow_pickle=False)}, ["depth"]
    except Exception as error:  # numpy raises half a dozen kinds at damaged headers
        raise FormatError(f"{path} holds no plain array ({error}); save it with numpy.save") from error
    names = list(array_sizes(path, remedy))
    return load_arrays(path, MAX_UNPACKED_BYTES, remedy, names if len(names) == 1 else _READ), names


def _depth(path: Path, arrays: dict[str, NDArray[Any]], names: list[str]) -> NDArray[Any]:
    """The depth array as (n, h, w)."""
    depth = arrays.get("depth", next(iter(arrays.values())) if len(names) == 1 else None)
    if depth is None:
        others = ", ".join(name[:30] for name in sorted(names)[:8])
        raise FormatError(f"{path} holds no array 'depth' (it has {others or 'none'}); rename it to 'depth'")
    if depth.ndim not in (2, 3) or depth.dtype.kind not in "iuf" or 0 in depth.shape:
        raise FormatError(
            f"{path}: depth is {depth.dtype} {depth.shape}; give (h, w) or (n, h, w), integers in "
            "millimetres or floats in metres"
        )
    images = depth.reshape(-1, *depth.shape[-2:])
    if max(images.shape[1:]) > MAX_IMAGE_SIDE:
        raise FormatError(f"{path}: depth is {depth.shape}; give at most {MAX_IMAGE_SIDE} pixels a side")
    return images


def _intrinsics(
    path: Path, matrix: NDArray[Any] | None, shape: tuple[int, ...]
) -> tuple[Intrinsics, float, str]:
    height, width = shape
    if matrix is not None:
        if matrix.shape != (3, 3) or matrix.dtype.kind not in "iuf":
            raise CalibrationError(f"{path}: K is {matrix.dtype} {matrix.shape}; give the 3x3 camera matrix")
        fx, cx, fy, cy = (float(matrix[at]) for at in ((0, 0), (0, 2), (1, 1), (1, 2)))
        return Intrinsics(width, height, fx, fy, cx, cy), 1.0, "intrinsics from the file's K"
    files = [path.with_suffix(".json"), path.with_name("intrinsics.json")]
    found, origin = first_intrinsics(files, (height, width))
    return found.depth, found.unit_mm, origin
