"""Calibration of the rig: intrinsics of each camera and the poses between them."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import FloatArray, Intrinsics

MAX_CALIBRATION_BYTES = 1_000_000


@dataclass(frozen=True)
class Pose:
    """Rigid transform named ``to_from``: p_to = rotation @ p_from + translation_m.

    rotation: float64 (3, 3), orthonormal, determinant +1. translation_m: float64 (3,).
    Raises CalibrationError otherwise.
    """

    rotation: NDArray[np.float64]
    translation_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        rotation, translation = np.asarray(self.rotation, float), np.asarray(self.translation_m, float)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise CalibrationError(
                f"pose has rotation {rotation.shape} and translation {translation.shape}; "
                "give (3, 3) and (3,)"
            )
        orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
        if not orthonormal or np.linalg.det(rotation) < 0 or not np.isfinite(translation).all():
            raise CalibrationError("pose is not a rigid transform; give a rotation matrix and finite metres")

    def apply(self, points_m: FloatArray) -> NDArray[np.float64]:
        """Map points (..., 3) from the source frame to the target frame."""
        return np.asarray(points_m @ self.rotation.T + self.translation_m, np.float64)

    def inverse(self) -> "Pose":
        """The pose that maps back."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation_m)

    def __matmul__(self, other: "Pose") -> "Pose":
        """``a_from_b @ b_from_c`` is ``a_from_c``."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m)

    @staticmethod
    def identity() -> "Pose":
        """The pose that moves nothing."""
        return Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class RigCalibration:
    """Intrinsics of the rig's cameras and their poses relative to the depth camera.

    Colour and thermal are optional, but each needs both its intrinsics and its pose.
    """

    depth: Intrinsics
    color: Intrinsics | None = None
    color_from_depth: Pose | None = None
    thermal: Intrinsics | None = None
    thermal_from_depth: Pose | None = None

    def __post_init__(self) -> None:
        for name, camera, pose in (
            ("color", self.color, self.color_from_depth),
            ("thermal", self.thermal, self.thermal_from_depth),
        ):
            if (camera is None) != (pose is None):
                missing = "intrinsics" if camera is None else f"pose {name}_from_depth"
                raise CalibrationError(f"calibration of the {name} camera lacks its {missing}; give both")


def calibration_to_json(calibration: RigCalibration) -> dict[str, Any]:
    """A calibration as plain JSON values; poses as row-major rotation and metres."""
    fields: dict[str, Any] = {}
    for name, value in vars(calibration).items():
        if isinstance(value, Intrinsics):
            fields[name] = asdict(value)
        elif isinstance(value, Pose):
            fields[name] = {
                "rotation": value.rotation.tolist(),
                "translation_m": value.translation_m.tolist(),
            }
    return fields


def calibration_from_json(fields: object) -> RigCalibration:
    """Inverse of ``calibration_to_json``. Raises CalibrationError naming the offending entry."""
    if not isinstance(fields, dict) or "depth" not in fields:
        raise CalibrationError(
            "calibration has no 'depth' entry; give at least the depth camera's intrinsics"
        )
    known = {"depth", "color", "thermal", "color_from_depth", "thermal_from_depth"}
    if unknown := sorted(set(fields) - known):
        raise CalibrationError(f"calibration has unknown entry {unknown[0]!r}; use {sorted(known)}")
    values: dict[str, Any] = {}
    for name, entry in fields.items():
        try:
            values[name] = _pose(entry) if name.endswith("_from_depth") else _intrinsics(entry)
        except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
            raise CalibrationError(
                f"calibration entry {name!r} is malformed ({error}); correct it"
            ) from error
    return RigCalibration(**values)


def load_calibration(path: Path) -> RigCalibration:
    """Read a calibration from a JSON file. Raises CalibrationError."""
    data = read_bounded(path, MAX_CALIBRATION_BYTES, "give a rig calibration file", CalibrationError)
    try:
        return calibration_from_json(json.loads(data))
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"calibration {path} cannot be read ({error}); give a JSON file") from error


def save_calibration(path: Path, calibration: RigCalibration) -> None:
    """Write a calibration as JSON."""
    path.write_text(json.dumps(calibration_to_json(calibration), indent=2) + "\n", encoding="utf-8")


def _intrinsics(entry: dict[str, Any]) -> Intrinsics:
    numbers = {k: int(v) if k in ("width", "height") else float(v) for k, v in entry.items()}
    return Intrinsics(**numbers)  # type: ignore[arg-type]


def _pose(entry: dict[str, Any]) -> Pose:
    return Pose(np.asarray(entry["rotation"], np.float64), np.asarray(entry["translation_m"], np.float64))
