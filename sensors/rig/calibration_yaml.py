"""Calibrations as OpenCV YAML: the files of iai_kinect2, and the same for the thermal camera.

A folder holds ``calib_ir.yaml``, ``calib_color.yaml``, ``calib_pose.yaml`` (ir -> colour),
``calib_depth.yaml`` (depthShift in millimetres), and of ours ``calib_thermal.yaml`` and
``calib_pose_thermal.yaml``. The entries of OpenCV's own calibration sample (camera_matrix, image_width, ...)
are read as well.
"""

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError
from sensors.files.atomic import replacing
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES, Pose, RigCalibration, load_calibration

FILES = {"depth": "calib_ir.yaml", "color": "calib_color.yaml", "thermal": "calib_thermal.yaml"}
POSES = {"color": "calib_pose.yaml", "thermal": "calib_pose_thermal.yaml"}
SHIFT = "calib_depth.yaml"
SIZES = {"depth": (512, 424), "color": (1920, 1080), "thermal": (160, 120)}
"""iai_kinect2 names no sizes: they are the Kinect v2's, and the Optris PI200's."""

MAX_COLUMNS, MAX_BRACKETS = 1000, 200
"""OpenCV's parser calls itself for every bracket and every column that a value stands further right; it
writes lines of 80 columns and one bracket a matrix."""


def open_calibration(path: Path) -> RigCalibration:
    """Read a rig's calibration: a JSON file, or a folder of YAML files. Raises CalibrationError."""
    return read_yaml(path) if path.is_dir() else load_calibration(path)


def read_yaml(folder: Path) -> RigCalibration:
    """Read a folder of YAML files; colour and thermal may be absent. Raises CalibrationError."""
    lenses = {name: _lens(folder, name) for name in FILES}
    if lenses["depth"] is None:
        raise CalibrationError(f"{folder} has no {FILES['depth']}; give a folder that iai_kinect2 wrote")
    poses = {name: _pose(_existing(folder, file)) for name, file in POSES.items()}
    return RigCalibration(
        lenses["depth"], lenses["color"], poses["color"], lenses["thermal"], poses["thermal"]
    )


def write_yaml(folder: Path, calibration: RigCalibration, depth_shift_mm: float = 0.0) -> None:
    """Write the folder that ``read_yaml`` reads; files there of the same names are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, file in FILES.items():
        camera: Intrinsics | None = getattr(calibration, name)
        if camera is not None:
            projection = np.eye(4)
            projection[:3, :3] = camera.matrix
            fields: dict[str, NDArray[np.float64] | float | int] = {
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
    _write(folder / SHIFT, {"depthShift": float(depth_shift_mm)})


def _write(path: Path, fields: dict[str, NDArray[np.float64] | float | int]) -> None:
    # OpenCV tells the format by the suffix, which a temporary file lacks: it writes to memory.
    storage = cv2.FileStorage(".yaml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    for key, value in fields.items():
        storage.write(key, value)
    with replacing(path) as temporary:
        temporary.write_text(storage.releaseAndGetString(), encoding="utf-8")


def _existing(folder: Path, file: str) -> Path | None:
    """The file by its name, or with a device's name before it; None where there is none."""
    found = sorted(path for path in folder.glob(f"*{file}") if path.is_file())
    if len(found) > 1:
        raise CalibrationError(
            f"{folder} has {len(found)} files for {file}; keep the files of one device in a folder"
        )
    return found[0] if found else None


def _lens(folder: Path, name: str) -> Intrinsics | None:
    path = _existing(folder, FILES[name])
    if path is None:
        return None
    matrix = _matrix(path, ("cameraMatrix", "camera_matrix"), (9,))
    lens = _matrix(path, ("distortionCoefficients", "distortion_coefficients"), (4, 5))
    storage = _open(path)
    try:
        width, height = (int(storage.getNode(f"image_{side}").real()) for side in ("width", "height"))
    except (ValueError, OverflowError) as error:
        raise CalibrationError(f"{path}: the image's size is not a number; restore it") from error
    if not (width and height):
        width, height = SIZES[name]
    k1, k2, p1, p2, k3 = np.append(lens, 0.0)[:5].tolist()
    fx, _, cx, _, fy, cy = matrix[:6].tolist()
    return Intrinsics(width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3)


def _pose(path: Path | None) -> Pose | None:
    if path is None:
        return None
    return Pose(_matrix(path, ("rotation",), (9,)).reshape(3, 3), _matrix(path, ("translation",), (3,)))


def _matrix(path: Path, keys: tuple[str, ...], sizes: tuple[int, ...]) -> NDArray[np.float64]:
    """The first of these entries, flattened."""
    storage = _open(path)
    for key in keys:
        try:
            values = storage.getNode(key).mat()
        except cv2.error as error:
            raise CalibrationError(f"{path}: {key} is not a matrix; restore it") from error
        if values is not None:
            if values.size not in sizes or not np.isfinite(values).all():
                raise CalibrationError(f"{path}: {key} is {values.shape}; give {sizes[0]} finite numbers")
            return np.asarray(values, np.float64).ravel()
    raise CalibrationError(f"{path} has no {keys[0]}; give an OpenCV calibration file")


def _open(path: Path) -> cv2.FileStorage:
    data = read_bounded(path, MAX_CALIBRATION_BYTES, "give a calibration file", CalibrationError)
    try:
        return cv2.FileStorage(_flat(data.decode()), cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
    except (ValueError, cv2.error, SystemError) as error:
        raise CalibrationError(f"calibration {path} cannot be read ({error}); restore it") from error


def _flat(text: str) -> str:
    """The text, where its depth cannot exhaust the stack of OpenCV's parser. Raises ValueError."""
    # OpenCV tells JSON and XML by their first characters, and their parsers recurse as well.
    if not text.startswith("%YAML"):
        raise ValueError("it does not start with %YAML")
    # Brackets that close are not counted: one in a comment or a string closes nothing.
    if text.count("[") + text.count("{") > MAX_BRACKETS:
        raise ValueError(f"more than {MAX_BRACKETS} lists")
    if max(map(len, re.split(r"[\r\n]", text))) > MAX_COLUMNS:
        raise ValueError(f"a line of more than {MAX_COLUMNS} columns")
    return text
