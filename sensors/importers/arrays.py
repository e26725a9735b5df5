"""Depth images in NumPy files (.npy, .npz) as a source of frames; pickled objects are never loaded.

A .npy holds depth (h, w) or (n, h, w), integers in millimetres or floats in metres (see ``depth_check``);
axes of length 1 are ignored. A .npz holds depth under ``depth`` or another name of ``_DEPTHS``, or as its
only array. It may also hold the camera. The camera is a 3x3, 3x4 or 4x4 matrix or fx, fy, cx, cy under one of
``_MATRICES``, or four arrays ``fx``, ``fy``, ``cx``, ``cy``. Otherwise intrinsics are in ``NAME.json`` or
``intrinsics.json`` beside the file (see ``intrinsics_file``). MATLAB's axis order (h, w, n) is recognised if
only that order fits the camera.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.camera_text import pinhole_of
from sensors.calibration_files.intrinsics_file import FoundIntrinsics, first_intrinsics
from sensors.checks.camera_check import check_camera, is_centred
from sensors.checks.depth_check import judge_depth, spread
from sensors.errors import CalibrationError, FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.files.npz import array_sizes, load_arrays
from sensors.files.own_files import own_file
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame, regular_times_ns
from sensors.rig.rig_calibration import RigCalibration

NPY_MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK\x03\x04"
MAX_UNPACKED_BYTES = 1 << 30  # of a .npz's depth and camera, unpacked as a whole; untuned
CHANNELS = (3, 4)  # last axes of arrays (h, w, n) that may be colour, or colour and depth
FEW = 32  # a shorter axis counts images, where no intrinsics state the size; untuned

_DEPTHS = ("depth", "depths", "depth_map", "depth_maps", "depth_image", "depth_images")
_MATRICES = (
    *("K", "intrinsics", "intrinsic", "intrinsic_matrix"),
    *("camera_matrix", "camera_intrinsics", "cam_K"),
)
_NUMBERS = ("fx", "fy", "cx", "cy")
_READ = (*_DEPTHS, *_MATRICES, *_NUMBERS)

Arrays = dict[str, NDArray[Any]]


class DepthArrays(FrameSource):
    """A NumPy file as a ``FrameSource``. Raises FormatError, or CalibrationError without intrinsics.

    notes: missing and assumed data, origin of the intrinsics.
    """

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        self.path, self.name = path, path.stem
        arrays, names = _load(path)
        found, self._depth, notes = _camera(path, arrays, _depth(path, arrays, names), options.intrinsics)
        self.times_ns = regular_times_ns(len(self._depth), options.period_ns)
        self.calibration = RigCalibration(found.depth)
        samples = [self._depth[at] for at in spread(len(self._depth))]
        self._reading = judge_depth(samples, options.depth_unit_mm or found.unit_mm, str(path))
        self.notes = (
            *notes,
            *self._reading.notes,
            *(f"array {name[:60]!r} is not read" for name in sorted(set(names) - set(arrays))),
            "no colour images",
            "no thermal images",
            f"no time stamps: {options.rate}",
        )

    def _frame(self, index: int) -> RigFrame:
        image = np.ascontiguousarray(self._depth[index])
        return RigFrame(index, int(self.times_ns[index]), self._reading.to_mm(image))


def _load(path: Path) -> tuple[Arrays, list[str]]:
    """Read the arrays by name, or the only array, and list the names of all; a .npy is memory-mapped."""
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


def _depth(path: Path, arrays: Arrays, names: list[str]) -> NDArray[Any]:
    """Return the depth array as it is, with three axes."""
    name = next((name for name in (*_DEPTHS, *(names if len(names) == 1 else ())) if name in arrays), None)
    if name is None:
        if own := own_file(path):
            raise FormatError(f"{path} {own.instead_of('a recording')}")
        others = ", ".join(name[:30] for name in sorted(names)[:8])
        raise FormatError(f"{path} holds no array 'depth' (it has {others or 'none'}); rename it to 'depth'")
    depth = arrays[name]
    sides = [side for side in depth.shape if side != 1]
    if len(sides) not in (2, 3) or depth.dtype.kind not in "iuf" or 0 in depth.shape:
        raise FormatError(
            f"{path}: depth is {depth.dtype} {depth.shape}; give (h, w) or (n, h, w), integers in "
            "millimetres or floats in metres"
        )
    return depth.reshape(-1, *sides[-2:])


class _Camera(NamedTuple):
    """Camera, depth as (n, h, w), and notes on the camera's origin and on exchanged axes."""

    found: FoundIntrinsics
    depth: NDArray[Any]
    notes: tuple[str, ...]


def _camera(path: Path, arrays: Arrays, depth: NDArray[Any], declared: Path | None) -> _Camera:
    """Return the camera with its depth. Raises CalibrationError without camera, FormatError for images that
    are too large.
    """
    numbers = None if declared else _numbers(path, arrays)
    if numbers is None:
        files = [declared] if declared else [path.with_suffix(".json"), path.with_name("intrinsics.json")]
        last = depth.shape[2] < FEW and min(depth.shape[:2]) >= FEW
        found, origin = first_intrinsics(files, depth.shape[:2] if last else depth.shape[1:])
        others = depth.shape[:2] == found.depth.shape != depth.shape[1:]
    else:
        centre = numbers[2], numbers[3]
        others = not is_centred(centre, depth.shape[1:]) and is_centred(centre, depth.shape[:2])
    if others and depth.shape[2] in CHANNELS:
        raise FormatError(
            f"{path}: depth is {depth.shape}, where the last axis may be colour; give depth alone, (n, h, w)"
        )
    depth = np.moveaxis(depth, 2, 0) if others else depth
    height, width = depth.shape[1:]
    if max(height, width) > MAX_IMAGE_SIDE:
        raise FormatError(f"{path}: depth is {depth.shape}; give at most {MAX_IMAGE_SIDE} pixels a side")
    if numbers is not None:
        found = FoundIntrinsics(check_camera(Intrinsics(width, height, *numbers), str(path)))
        name = next((name for name in _MATRICES if name in arrays), "fx, fy, cx, cy")
        origin = f"intrinsics from the file's {name}"
    note = f"axes of depth are (h, w, n): {len(depth)} images of {width}x{height}"
    return _Camera(found, depth, (origin, note) if others else (origin,))


def _numbers(path: Path, arrays: Arrays) -> tuple[float, ...] | None:
    """Return fx, fy, cx, cy of the file's own arrays; None without such arrays. Raises CalibrationError where
    they are not a camera's.
    """
    name = next((name for name in _MATRICES if name in arrays), None)
    if name is not None:
        matrix = arrays[name]
        if matrix.ndim == 3 and len(matrix) and (matrix == matrix[0]).all():
            matrix = matrix[0]
        try:
            if matrix.dtype.kind not in "iuf" or matrix.ndim > 2:
                raise ValueError(f"it is {matrix.dtype} {matrix.shape}")
            return pinhole_of(matrix.astype(float).ravel().tolist())
        except ValueError as error:
            raise CalibrationError(
                f"{path}: {name} is not a camera matrix ({error}); give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            ) from error
    if any(each not in arrays for each in _NUMBERS):
        return None
    values = [arrays[each] for each in _NUMBERS]
    if any(value.size != 1 or value.dtype.kind not in "iuf" for value in values):
        raise CalibrationError(f"{path}: fx, fy, cx, cy are not single numbers; give one each")
    return tuple(float(value.item()) for value in values)
