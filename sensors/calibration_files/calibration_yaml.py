"""Calibrations as OpenCV YAML: the files of iai_kinect2, and the same for the thermal camera.

A folder holds ``calib_ir.yaml``, ``calib_color.yaml``, ``calib_pose.yaml`` (ir -> colour),
``calib_depth.yaml`` (depthShift, millimetres that kinect2_bridge.cpp adds to depth), and of ours
``calib_thermal.yaml`` and ``calib_pose_thermal.yaml``. Cameras are read by ``camera_text``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from sensors.calibration_files.camera_text import read_camera_text, scan
from sensors.errors import CalibrationError
from sensors.files.atomic import replacing
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES, Pose, RigCalibration, load_calibration

FILES = {"depth": "calib_ir.yaml", "color": "calib_color.yaml", "thermal": "calib_thermal.yaml"}
POSES = {"color": "calib_pose.yaml", "thermal": "calib_pose_thermal.yaml"}
SHIFT = "calib_depth.yaml"
SIZES = {"depth": (424, 512), "color": (1080, 1920), "thermal": (120, 160)}  # (h, w); iai_kinect2 has none
T = TypeVar("T")


def open_calibration(path: Path) -> RigCalibration:
    """Read a rig's calibration: a JSON file, or a folder of YAML files. Raises CalibrationError where it is
    missing or malformed.
    """
    return read_yaml(path) if path.is_dir() else load_calibration(path)


def read_yaml(folder: Path) -> RigCalibration:
    """Read a folder of YAML files; colour and thermal may be absent. Raises CalibrationError where a file is
    missing or malformed.
    """
    depth, color, thermal = (_lens(folder, name) for name in ("depth", "color", "thermal"))
    if depth is None:
        raise CalibrationError(f"{folder} has no {FILES['depth']}; give a folder that iai_kinect2 wrote")
    poses = {f"{name}_from_depth": _read(folder, file, _pose) for name, file in POSES.items()}
    # One of iai_kinect2's own units has no shift.
    shift_mm = _read(folder, SHIFT, lambda text: _numbers(text, "depthShift", 1)[0]) or 0.0
    return RigCalibration(depth, color, thermal=thermal, depth_shift_mm=shift_mm, **poses)


def write_yaml(folder: Path, calibration: RigCalibration) -> None:
    """Write the folder that ``read_yaml`` reads; files of the same names are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, file in FILES.items():
        camera: Intrinsics | None = getattr(calibration, name)
        if camera is not None:
            projection = np.eye(4)
            projection[:3, :3] = camera.matrix
            fields: dict[str, Any] = {
                "image_width": camera.width,
                "image_height": camera.height,
                "cameraMatrix": camera.matrix,
                "distortionCoefficients": np.array([camera.distortion]),
                "rotation": np.eye(3),
                "projection": projection,
            }
            _write(folder / file, fields)
    for name, file in POSES.items():
        pose: Pose | None = getattr(calibration, f"{name}_from_depth")
        if pose is not None:
            _write(folder / file, {"rotation": pose.rotation, "translation": pose.translation_m[:, None]})
    _write(folder / SHIFT, {"depthShift": float(calibration.depth_shift_mm)})


def _write(path: Path, fields: dict[str, Any]) -> None:
    # In memory, because OpenCV takes the format from the suffix, which a temporary file lacks.
    storage = cv2.FileStorage(".yaml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    for key, value in fields.items():
        storage.write(key, value)
    with replacing(path) as temporary:
        temporary.write_text(storage.releaseAndGetString(), encoding="utf-8")


def _read(folder: Path, file: str, parse: Callable[[str], T]) -> T | None:
    """Return the parsed text of ``file``, possibly prefixed with a device's name; None without such a
    file.
    """
    found = sorted(folder.glob(f"*{file}"))
    if len(found) > 1:
        raise CalibrationError(f"{folder} has {len(found)} files *{file}; keep one device's file")
    if not found:
        return None
    data = read_bounded(found[0], MAX_CALIBRATION_BYTES, "give a calibration file", CalibrationError)
    try:
        return parse(data.decode())
    except ValueError as error:
        raise CalibrationError(
            f"calibration {found[0]} cannot be read ({error}); restore it from a copy"
        ) from error


def _lens(folder: Path, name: str) -> Intrinsics | None:
    return _read(folder, FILES[name], lambda text: read_camera_text(text, SIZES[name])[0])


def _pose(text: str) -> Pose:
    return Pose(np.reshape(_numbers(text, "rotation", 9), (3, 3)), np.array(_numbers(text, "translation", 3)))


def _numbers(text: str, key: str, count: int) -> list[float]:
    """Return the ``count`` numbers of a key. Raises ValueError for more or fewer."""
    numbers = scan(text)[0].get(key.lower(), [])
    if len(numbers) != count:
        raise ValueError(f"{key} has {len(numbers)} numbers: give {count}")
    return numbers
