"""Calibrations as OpenCV YAML: the files of iai_kinect2, and the same for the thermal camera.

A folder holds ``calib_ir.yaml``, ``calib_color.yaml``, ``calib_pose.yaml`` (ir -> colour),
``calib_depth.yaml`` (depthShift, millimetres that kinect2_bridge.cpp adds to depth), and of ours
``calib_thermal.yaml`` and ``calib_pose_thermal.yaml``. The keys of OpenCV's own calibration sample
(camera_matrix, image_width, ...) are read as well.
"""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sensors.errors import CalibrationError
from sensors.files.atomic import replacing
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES, Pose, RigCalibration, load_calibration

FILES = {"depth": "calib_ir.yaml", "color": "calib_color.yaml", "thermal": "calib_thermal.yaml"}
POSES = {"color": "calib_pose.yaml", "thermal": "calib_pose_thermal.yaml"}
SHIFT = "calib_depth.yaml"
SIZES = {"depth": (512, 424), "color": (1920, 1080), "thermal": (160, 120)}  # iai_kinect2 states none
_ENTRY = re.compile(  # a key with a number, or with a matrix as OpenCV writes it
    r"^(\w+): *(?:([-+]?\d+\.?\d*(?:e[-+]?\d+)?)\s*$|!!opencv-matrix\s+rows:[^\[]*\bdata: *\[([^\]]*)\])",
    re.MULTILINE,
)


def open_calibration(path: Path) -> RigCalibration:
    """Read a rig's calibration: a JSON file, or a folder of YAML files. Raises CalibrationError."""
    return read_yaml(path) if path.is_dir() else load_calibration(path)


def read_yaml(folder: Path) -> RigCalibration:
    """Read a folder of YAML files; colour and thermal may be absent. Raises CalibrationError."""
    depth, color, thermal = (_lens(folder, name) for name in ("depth", "color", "thermal"))
    if depth is None:
        raise CalibrationError(f"{folder} has no {FILES['depth']}; give a folder that iai_kinect2 wrote")
    poses = {f"{name}_from_depth": _pose(folder, name) for name in POSES}
    return RigCalibration(depth, color, thermal=thermal, depth_shift_mm=_shift_mm(folder), **poses)


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


class _Fields:
    """Numbers of a YAML file by key. OpenCV's own parser writes beyond its memory at corrupt files."""

    def __init__(self, path: Path) -> None:
        self._path = path
        data = read_bounded(path, MAX_CALIBRATION_BYTES, "give a calibration file", CalibrationError)
        try:
            entries = [match.groups() for match in _ENTRY.finditer(data.decode())]
            self._fields = {
                key: [float(n) for n in (number or numbers).split(",")] for key, number, numbers in entries
            }
        except ValueError as error:
            raise CalibrationError(f"calibration {path} cannot be read ({error}); restore it") from error
        if not np.isfinite([number for numbers in self._fields.values() for number in numbers]).all():
            raise CalibrationError(f"calibration {path} holds numbers that are not finite; restore it")

    @classmethod
    def existing(cls, folder: Path, file: str) -> "_Fields | None":
        """Read the file of this name, or with a device's name before it; None where none exists."""
        found = sorted(path for path in folder.glob(f"*{file}") if path.is_file())
        if len(found) > 1:
            raise CalibrationError(f"{folder} has {len(found)} files for {file}; keep one device's there")
        return cls(found[0]) if found else None

    def numbers(self, *keys: str, counts: tuple[int, ...]) -> list[float]:
        """Return the numbers of the first of these keys, by rows. Raises CalibrationError."""
        values = next((self._fields[key] for key in keys if key in self._fields), [])
        if not values:
            raise CalibrationError(f"{self._path} has no {keys[0]}; give an OpenCV calibration file")
        if len(values) not in counts:
            raise CalibrationError(f"{self._path}: {keys[0]} has {len(values)} numbers; give {counts[0]}")
        return values

    def whole(self, key: str) -> int:
        """Return a whole number, 0 where the key is missing."""
        return int(self._fields.get(key, [0])[0])


def _lens(folder: Path, name: str) -> Intrinsics | None:
    if (fields := _Fields.existing(folder, FILES[name])) is None:
        return None
    fx, _, cx, _, fy, cy = fields.numbers("cameraMatrix", "camera_matrix", counts=(9,))[:6]
    lens = fields.numbers("distortionCoefficients", "distortion_coefficients", counts=(4, 5))
    width, height = fields.whole("image_width"), fields.whole("image_height")
    size = (width, height) if width and height else SIZES[name]
    return Intrinsics(*size, fx, fy, cx, cy, *lens)


def _pose(folder: Path, name: str) -> Pose | None:
    if (fields := _Fields.existing(folder, POSES[name])) is None:
        return None
    rotation = np.reshape(fields.numbers("rotation", counts=(9,)), (3, 3))
    return Pose(rotation, np.array(fields.numbers("translation", counts=(3,))))


def _shift_mm(folder: Path) -> float:
    """Return depthShift; 0 without the file, which one of iai_kinect2's own units lacks."""
    fields = _Fields.existing(folder, SHIFT)
    return 0.0 if fields is None else fields.numbers("depthShift", counts=(1,))[0]
