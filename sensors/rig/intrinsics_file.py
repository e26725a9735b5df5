"""Intrinsics as various programs write them in JSON, and what goes with them.

Read are ours (``fx fy cx cy width height``, optionally ``k1 k2 p1 p2 k3`` and ``depth_unit_mm``),
librealsense's (``fx fy ppx ppy width height``, optionally ``coeffs model depth_scale``), and Open3D's
(``intrinsic_matrix`` by columns, ``width height``, optionally ``depth_scale``).
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sensors.errors import CalibrationError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES

_OURS = frozenset({"fx", "fy", "cx", "cy", "width", "height"})
_OURS_OPTIONAL = frozenset({"k1", "k2", "p1", "p2", "k3", "depth_unit_mm"})
_REALSENSE = frozenset({"fx", "fy", "ppx", "ppy", "width", "height"})
_PINHOLES = ("", "none", "distortion.none", "brown_conrady", "distortion.brown_conrady", "brown conrady")


@dataclass(frozen=True)
class FoundIntrinsics:
    """Intrinsics of a file. unit_mm: millimetres of a depth step; aligned: colour has the depth's pixels."""

    depth: Intrinsics
    unit_mm: float = 1.0
    aligned: bool = False


def read_intrinsics(file: Path, shape: tuple[int, int] | None = None) -> FoundIntrinsics:
    """Read a JSON file; ``shape`` (h, w) is taken where an Open3D file has none. Raises CalibrationError."""
    fields = _fields(file)
    try:
        if "intrinsic_matrix" in fields:
            return _from_open3d(fields, shape)
        if "ppx" in fields:
            return _from_realsense(file, fields)
    except (TypeError, ValueError, KeyError, IndexError, OverflowError) as error:
        raise CalibrationError(f"{file} is malformed ({error!r}); correct it") from error
    return _from_ours(file, fields)


def _from_ours(file: Path, fields: dict[str, Any]) -> FoundIntrinsics:
    if not set(fields) >= _OURS or set(fields) - _OURS - _OURS_OPTIONAL:
        raise CalibrationError(f"{file} must hold {sorted(_OURS)}, optionally {sorted(_OURS_OPTIONAL)}")
    for name, value in fields.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
            raise CalibrationError(f"{file} says {name} is {str(value)[:40]!r}; give a finite number")
    numbers = dict(fields)
    unit_mm = _unit(float(numbers.pop("depth_unit_mm", 1.0)), file)
    size = {side: int(numbers.pop(side)) for side in ("width", "height")}
    return FoundIntrinsics(Intrinsics(**size, **numbers), unit_mm)


def _from_realsense(file: Path, fields: dict[str, Any]) -> FoundIntrinsics:
    """librealsense's ``rs2_intrinsics``; an inverse lens of all zeros is none."""
    if not set(fields) >= _REALSENSE:
        raise CalibrationError(f"{file} must hold {sorted(_REALSENSE)}")
    coefficients = [float(x) for x in fields.get("coeffs", [0.0] * 5)]
    model = str(fields.get("model", "")).lower()
    if any(coefficients) and (model not in _PINHOLES or len(coefficients) != 5):
        raise CalibrationError(f"{file} has lens model {model[:40]!r}; only Brown-Conrady, or none, is read")
    size, numbers = _numbers(fields, ("width", "height")), _numbers(fields, ("fx", "fy", "ppx", "ppy"))
    camera = Intrinsics(int(size[0]), int(size[1]), *numbers, *(coefficients if any(coefficients) else ()))
    return FoundIntrinsics(camera, _unit(1000 * float(fields.get("depth_scale", 0.001)), file))


def _from_open3d(fields: dict[str, Any], shape: tuple[int, int] | None) -> FoundIntrinsics:
    """Open3D's PinholeCameraIntrinsic, as its RealSense recorder writes it for depth aligned to colour."""
    height, width = (fields["height"], fields["width"]) if "width" in fields else shape or (0, 0)
    matrix = np.array(fields["intrinsic_matrix"], np.float64).reshape(3, 3).T
    camera = Intrinsics(
        int(width), int(height), *(float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    )
    steps_per_m = float(fields.get("depth_scale", 1000.0))
    if not 1 <= steps_per_m <= 1e6:
        raise ValueError(f"depth_scale {steps_per_m}")
    return FoundIntrinsics(camera, 1000 / steps_per_m, aligned=True)


def _numbers(fields: dict[str, Any], names: tuple[str, ...]) -> list[float]:
    values = [float(fields[name]) for name in names]
    if not all(abs(value) < 1e9 for value in values):
        raise ValueError(f"{names} are {values}")
    return values


def _unit(unit_mm: float, file: Path) -> float:
    if not 0 < unit_mm <= 1000:
        raise CalibrationError(f"{file} says depth_unit_mm is {unit_mm}; give a number above 0, up to 1000")
    return unit_mm


def _fields(file: Path) -> dict[str, Any]:
    data = read_bounded(file, MAX_CALIBRATION_BYTES, "give intrinsics")
    try:
        fields = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{file} is not JSON ({error}); correct it") from error
    if not isinstance(fields, dict):
        raise CalibrationError(f"{file} must hold {sorted(_OURS)}, optionally {sorted(_OURS_OPTIONAL)}")
    return fields
