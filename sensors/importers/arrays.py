"""Depth images in NumPy files (.npy, .npz) as a source of frames; nothing in them is ever executed.

A .npy holds depth (h, w) or (n, h, w), integers in millimetres or floats in metres. A .npz holds it as
``depth``, or as its only array; ``K``, the 3x3 camera matrix, may lie beside it. Otherwise intrinsics are in
``NAME.json`` or ``intrinsics.json`` beside the file (see ``intrinsics_file``).
"""

import io
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError, FormatError
from sensors.files.limits import MAX_IMAGE_SIDE
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FRAME_PERIOD_NS, RigFrame, mm_from_metres, mm_from_units
from sensors.rig.intrinsics_file import read_intrinsics
from sensors.rig.rig_calibration import RigCalibration

NPY_MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK\x03\x04"
MAX_ARRAY_BYTES = 1 << 32
MAX_UNPACKED_BYTES = 1 << 30
"""Of a .npz, which is read into memory as a whole."""
MAX_ZIP_RATIO = 1100
"""Deflate reaches 1032; what claims more is no array."""

_READ = ("depth", "K")
_UNREADABLE = (
    *(ValueError, TypeError, SyntaxError, TokenError, KeyError, OverflowError, MemoryError),
    *(RuntimeError, zipfile.BadZipFile, zlib.error, EOFError),
)


class DepthArrays:
    """A NumPy file as a ``FrameSource``. Raises FormatError, or CalibrationError without intrinsics.

    notes: what is absent, where the intrinsics are from.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.stem
        arrays, names = _load(path)
        self._depth = _depth(path, arrays, names)
        camera, self._unit_mm, origin = _intrinsics(path, arrays.get("K"), self._depth.shape[1:])
        self.calibration = RigCalibration(camera)
        unread = sorted(set(names) - set(arrays))
        self.notes = (
            origin,
            *(f"array {name[:60]!r} is not read" for name in unread),
            "no colour images",
            "no thermal images",
            "no time stamps: 30 frames a second assumed",
        )

    def __len__(self) -> int:
        return len(self._depth)

    def __iter__(self) -> Iterator[RigFrame]:
        for index, image in enumerate(self._depth):
            whole = image.dtype.kind in "iu"
            depth_mm = mm_from_units(image, self._unit_mm) if whole else mm_from_metres(image)
            yield RigFrame(index, index * FRAME_PERIOD_NS, depth_mm)


def _load(path: Path) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """``depth`` and ``K``, or the only array, by name, and the names of all; a .npy stays on disk."""
    try:
        if path.stat().st_size > MAX_ARRAY_BYTES:
            raise FormatError(f"{path} is larger than {MAX_ARRAY_BYTES} bytes; split it")
        with path.open("rb") as file:
            single = file.read(len(NPY_MAGIC)) == NPY_MAGIC
        if single:
            return {"depth": np.load(path, mmap_mode="r", allow_pickle=False)}, ["depth"]
        with zipfile.ZipFile(path) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            wanted = members if len(members) == 1 else {n: i for n, i in members.items() if n in _READ}
            for info in wanted.values():
                _check_member(info)
            if (size := sum(info.file_size for info in wanted.values())) > MAX_UNPACKED_BYTES:
                raise FormatError(f"{path} unpacks to {size} bytes; save depth as a .npy file, or split it")
            return {name: _member(archive, info) for name, info in wanted.items()}, list(members)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error}); give a .npy or .npz file") from error
    except _UNREADABLE as error:
        raise FormatError(f"{path} holds no plain arrays ({error}); save it with numpy.savez") from error


def _check_member(info: zipfile.ZipInfo) -> None:
    if info.file_size > min(MAX_ARRAY_BYTES, MAX_ZIP_RATIO * info.compress_size + 1000):
        raise ValueError(f"{info.filename[:60]!r} claims {info.file_size} bytes")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{info.filename[:60]!r} is compressed by method {info.compress_type}")


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(info) as member:
        data = member.read(info.file_size)
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read_header is None:
        raise ValueError(f"array format {version}")
    shape, fortran, dtype = read_header(stream)
    if dtype.hasobject or min(shape, default=0) < 0:
        raise ValueError(f"it is {dtype} {shape}")
    values = np.frombuffer(data, dtype, offset=stream.tell())
    return values.reshape(shape, order="F" if fortran else "C")


def _depth(path: Path, arrays: dict[str, NDArray[Any]], names: list[str]) -> NDArray[Any]:
    """The depth array as (n, h, w)."""
    depth = arrays.get("depth", next(iter(arrays.values())) if len(names) == 1 else None)
    if depth is None:
        others = ", ".join(name[:30] for name in sorted(names)[:8])
        raise FormatError(f"{path} holds no array 'depth' but {others or 'nothing'}; name it so")
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
    for file in (path.with_suffix(".json"), path.with_name("intrinsics.json")):
        if file.is_file():
            found = read_intrinsics(file, (height, width))
            return found.depth, found.unit_mm, f"intrinsics from {file.name}"
    raise CalibrationError(
        f"{path} has no intrinsics; add {path.with_suffix('.json')} holding "
        f'{{"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": {width}, "height": {height}}} '
        "with the depth camera's four numbers in pixels"
    )
