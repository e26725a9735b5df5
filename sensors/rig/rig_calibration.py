"""Calibration of the rig: intrinsics of each camera and the poses between them."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError, fault_of
from sensors.files.bounded import read_bounded
from sensors.rig.camera import FloatArray, Intrinsics

MAX_CALIBRATION_BYTES = 1_000_000
LARGEST_SHIFT_MM = 500.0  # a larger one is a wrong unit (a Kinect v2: -13 to -50 mm)


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
            shapes = f"{rotation.shape} and {translation.shape}"
            raise CalibrationError(f"rotation and translation are {shapes}; give (3, 3) and (3,)")
        orthonormal = np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-4
        if not orthonormal or np.linalg.det(rotation) < 0 or not np.isfinite(translation).all():
            raise CalibrationError("pose is not a rigid transform; give a rotation matrix and finite metres")

    def apply(self, points_m: FloatArray) -> NDArray[np.float64]:
        """Map points (..., 3) from the source frame to the target frame."""
        return np.asarray(points_m @ self.rotation.T + self.translation_m, np.float64)

    def inverse(self) -> "Pose":
        """Return ``from_to``."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation_m)

    def __matmul__(self, other: "Pose") -> "Pose":
        """Compose: ``a_from_b @ b_from_c`` is ``a_from_c``."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m)

    @staticmethod
    def identity() -> "Pose":
        """Return the neutral pose."""
        return Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class RigCalibration:
    """Intrinsics of the rig's cameras and their poses relative to the depth camera.

    Colour and thermal are optional, but each needs both intrinsics and pose. depth_shift_mm: to add to every
    depth reading (iai_kinect2's depthShift). Fusion adds the shift; recorded images stay as the camera gave
    them. Raises CalibrationError for a camera without pose, or an impossible shift.
    """

    depth: Intrinsics
    color: Intrinsics | None = None
    color_from_depth: Pose | None = None
    thermal: Intrinsics | None = None
    thermal_from_depth: Pose | None = None
    depth_shift_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("color", "thermal"):
            camera, pose = getattr(self, name), getattr(self, f"{name}_from_depth")
            if (camera is None) != (pose is None):
                missing = "intrinsics" if camera is None else f"pose {name}_from_depth"
                raise CalibrationError(f"calibration of the {name} camera lacks its {missing}; give both")
        if not abs(self.depth_shift_mm) <= LARGEST_SHIFT_MM:
            raise CalibrationError(
                f"depth shift {self.depth_shift_mm:g} mm is impossible; "
                f"give millimetres from {-LARGEST_SHIFT_MM:g} to {LARGEST_SHIFT_MM:g}"
            )


def calibration_to_json(calibration: RigCalibration) -> dict[str, Any]:
    """Return a calibration as plain JSON values; poses by rows and in metres, a shift of 0 left out."""
    fields: dict[str, Any] = {}
    for name, value in vars(calibration).items():
        if isinstance(value, Intrinsics):
            fields[name] = asdict(value)
        elif isinstance(value, Pose):
            fields[name] = {key: numbers.tolist() for key, numbers in vars(value).items()}
        elif value:
            fields[name] = float(value)
    return fields


def calibration_from_json(fields: object) -> RigCalibration:
    """Invert ``calibration_to_json``. Raises CalibrationError naming the faulty entry."""
    if not isinstance(fields, dict) or "depth" not in fields:
        raise CalibrationError("calibration has no 'depth' entry; give the depth camera's intrinsics")
    known = set(RigCalibration.__dataclass_fields__)
    if unknown := sorted(set(fields) - known):
        raise CalibrationError(
            f"calibration has unknown entry {unknown[0]!r}; use {', '.join(sorted(known))}"
        )
    values: dict[str, Any] = {}
    for name, entry in fields.items():
        try:
            if name == "depth_shift_mm":
                values[name] = float(entry)
            elif name.endswith("_from_depth"):
                values[name] = Pose(
                    *(np.asarray(entry[k], np.float64) for k in ("rotation", "translation_m"))
                )
            else:
                sizes = {key: int(entry[key]) for key in ("width", "height")}
                values[name] = Intrinsics(**{**{k: float(v) for k, v in entry.items()}, **sizes})  # type: ignore[arg-type]
        except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
            raise CalibrationError(
                f"calibration entry {name!r} is malformed ({fault_of(error)}); "
                "correct that entry or calibrate again"
            ) from error
        except CalibrationError as error:
            raise CalibrationError(f"calibration entry {name!r}: {error}") from error
    return RigCalibration(**values)


def load_calibration(path: Path) -> RigCalibration:
    """Read a calibration from a JSON file. Raises CalibrationError where it is missing or malformed."""
    data = read_bounded(path, MAX_CALIBRATION_BYTES, "give a rig calibration file", CalibrationError)
    try:
        return calibration_from_json(json.loads(data))
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"calibration {path} cannot be read ({error}); give a JSON file") from error
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


def save_calibration(path: Path, calibration: RigCalibration) -> None:
    """Write a calibration as JSON."""
    path.write_text(json.dumps(calibration_to_json(calibration), indent=2) + "\n", encoding="utf-8")


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternion (x, y, z, w) of a rotation matrix (3, 3), by its largest component.

    Source: Shepperd 1978. SciPy's result differs in the last bit and would change the bytes of recordings.
    """
    m, trace = rotation, np.trace(rotation)
    largest = int(np.argmax([*np.diag(m), trace]))
    if largest == 3:
        q = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + trace])
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = np.empty(4)
        q[i], q[3] = 1 - trace + 2 * m[i, i], m[k, j] - m[j, k]
        q[j], q[k] = m[j, i] + m[i, j], m[k, i] + m[i, k]
    return np.asarray(q / np.linalg.norm(q))


def rotation_of(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a quaternion (x, y, z, w). Raises ValueError at length 0."""
    length = float(np.linalg.norm(quaternion))
    if not 0 < length < np.inf:
        raise ValueError(f"a quaternion has length {length:g}")
    x, y, z, w = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
