"""Intrinsics as various programs write them; keys: docs/formats.md.

JSON is read by its keys where they are known; all other files are read by ``camera_text``. The known ones
are:

- ours: ``fx fy cx cy width height``, optionally ``k1 k2 p1 p2 k3`` and ``depth_unit_mm``
- librealsense's: ``fx fy ppx ppy width height``, optionally ``coeffs model depth_scale``
- Open3D's: ``intrinsic_matrix`` by columns, ``width height``, optionally ``depth_scale``
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sensors.calibration_files.camera_text import read_camera_text
from sensors.calibration_files.lens_models import realsense_intrinsics
from sensors.checks.camera_check import check_camera
from sensors.errors import CalibrationError, Setting, fault_of
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES

_OURS = frozenset({"fx", "fy", "cx", "cy", "width", "height"})
_OPTIONAL = frozenset({"k1", "k2", "p1", "p2", "k3", "depth_unit_mm"})


class FoundIntrinsics(NamedTuple):
    """Intrinsics of a file.

    unit_mm: millimetres of a depth step, None = not stated. aligned: True if colour and depth share their
    pixels.
    """

    depth: Intrinsics
    unit_mm: float | None = None
    aligned: bool = False


def first_intrinsics(files: list[Path], shape: tuple[int, int]) -> tuple[FoundIntrinsics, str]:
    """Return intrinsics of depth images (h, w) from the first existing file, and a note on its name.

    Raises CalibrationError where none exists.
    """
    file = next((file for file in files if file.exists()), None)
    if file is None:
        raise CalibrationError(
            f"the depth images have no intrinsics; add {files[0]} holding "
            f'{{"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": {shape[1]}, "height": {shape[0]}}} '
            "with the depth camera's four numbers in pixels, or give such a file",
            Setting.INTRINSICS,
        )
    return read_intrinsics(file, shape), f"intrinsics from {file.name}"


def read_intrinsics(file: Path, shape: tuple[int, int] = (0, 0)) -> FoundIntrinsics:
    """Read a file of intrinsics. shape: (h, w), used where the file states no size. Raises CalibrationError
    where it is malformed.
    """
    data = read_bounded(file, MAX_CALIBRATION_BYTES, "give intrinsics", CalibrationError)
    try:
        found = _found(data.decode(json.detect_encoding(data), errors="replace"), shape)
    except CalibrationError as error:
        raise CalibrationError(f"{file}: {error}", *error.settings) from error
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise CalibrationError(f"{file} is malformed ({fault_of(error)}); correct the file") from error
    if found.unit_mm is not None and not 0 < found.unit_mm <= 1000:
        raise CalibrationError(f"{file} has depth steps of {found.unit_mm} mm; give more than 0, up to 1000")
    check_camera(found.depth, str(file))
    return found


def _found(text: str, shape: tuple[int, int]) -> FoundIntrinsics:
    fields = json.loads(text) if text.lstrip().startswith("{") else None
    if fields is not None and "intrinsic_matrix" in fields:
        return _from_open3d(fields, shape)
    if fields is not None and "ppx" in fields:
        return _from_realsense(fields)
    if fields is not None and set(fields) <= _OURS | _OPTIONAL:
        return _from_ours(fields)
    return FoundIntrinsics(*read_camera_text(text, shape))


def _from_ours(fields: dict[str, Any]) -> FoundIntrinsics:
    if lacking := ", ".join(sorted(_OURS - set(fields))):
        raise ValueError(f"it lacks {lacking}")
    wrong = {key: value for key, value in fields.items() if type(value) not in (int, float)}
    if wrong:
        shown = ", ".join(f"{key} is {str(value)[:40]!r}" for key, value in wrong.items())
        raise ValueError(f"{shown}, not a number")
    size = {side: int(fields[side]) for side in ("width", "height")}
    numbers = {name: float(value) for name, value in fields.items()}
    unit_mm = numbers.pop("depth_unit_mm", None)
    return FoundIntrinsics(Intrinsics(**{**numbers, **size}), unit_mm)  # type: ignore[arg-type]


def _from_realsense(fields: dict[str, Any]) -> FoundIntrinsics:
    """Read librealsense's ``rs2_intrinsics``; pyrealsense2 writes its models as ``distortion.NAME``."""
    lens = [float(x) for x in fields.get("coeffs", [])]
    if any(lens) and len(lens) != 5:
        raise ValueError(f"coeffs has {len(lens)} numbers: give k1, k2, p1, p2, k3")
    numbers = [float(fields[name]) for name in ("fx", "fy", "ppx", "ppy")]
    pinhole = Intrinsics(int(fields["width"]), int(fields["height"]), *numbers)
    model = str(fields.get("model", "")).lower().removeprefix("distortion.")
    camera = realsense_intrinsics(pinhole, model or "none", lens) if any(lens) else pinhole
    scale = fields.get("depth_scale")
    return FoundIntrinsics(camera, None if scale is None else 1000 * float(scale))


def _from_open3d(fields: dict[str, Any], shape: tuple[int, int]) -> FoundIntrinsics:
    """Read Open3D's PinholeCameraIntrinsic, which its RealSense recorder writes for aligned depth."""
    height, width = (fields["height"], fields["width"]) if "width" in fields else shape
    (fx, _, _), (_, fy, _), (cx, cy, _) = np.array(fields["intrinsic_matrix"], float).reshape(3, 3).tolist()
    camera = Intrinsics(int(width), int(height), fx, fy, cx, cy)
    if "depth_scale" not in fields:
        return FoundIntrinsics(camera, None, aligned=True)
    steps_per_m = float(fields["depth_scale"])
    if not 1 <= steps_per_m <= 1e6:
        raise ValueError(f"depth_scale is {steps_per_m:g}: give 1 to 1000000 steps a metre")
    return FoundIntrinsics(camera, 1000 / steps_per_m, aligned=True)
