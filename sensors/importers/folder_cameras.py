"""Cameras of an image folder, by its calibration, its intrinsics, or a file that the user declares."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from sensors.calibration_files.intrinsics_file import FoundIntrinsics, first_intrinsics, read_intrinsics
from sensors.checks.depth_check import spread
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.files.flir_jpeg import read_flir
from sensors.files.images import image_shape
from sensors.importers.folder_files import JPEGS, STREAMS, Files
from sensors.rig.rig_calibration import Pose, RigCalibration, load_calibration

TEXTS = ("json", "yaml", "yml", "xml", "txt")
CALIBRATION = "calibration.json"
INTRINSICS = (
    *("intrinsics.json", "intrinsic.json", "camera_intrinsic.json", "camera_intrinsics.json"),
    *(f"{name}.{kind}" for name in ("depth_intrinsics", "intrinsics_depth") for kind in TEXTS),
    *("intrinsic_depth.txt", "intrinsic/intrinsic_depth.txt", "intrinsics/intrinsic_depth.txt"),
    *(f"{name}.{kind}" for name in ("depth_camera_info", "camera_info") for kind in TEXTS),
    *(f"{name}.{kind}" for name in ("intrinsics", "intrinsic", "camera") for kind in TEXTS),
    *("camera-intrinsics.txt", "camera_intrinsics.txt", "K.txt", "cam_K.txt"),
    *("calibration.txt", "calib.txt", "calibration.yaml", "calibration.yml"),
)
"""Files in which programs write the depth camera's numbers; the first that exists is read: ours, Open3D's,
ScanNet's (SensReader/python/SensorData.py), ROS's, 3DMatch's, SUN RGB-D's and ETH3D's."""


class FolderCameras(NamedTuple):
    """Calibration; millimetres of a depth step if a file states it; notes on their origin."""

    calibration: RigCalibration
    unit_mm: float | None
    notes: tuple[str, ...]


def cameras_of(path: Path, first: Path, color: Files, thermal: Files, declared: Path | None) -> FolderCameras:
    """Return the cameras of a folder's images, by its files or the declared one.

    first: a depth image. declared: a file of intrinsics, or None. Raises CalibrationError.
    """
    shape = image_shape(read_bounded(first), str(first))
    files = [path / name for name in INTRINSICS]
    if declared is not None:
        found, origin = read_intrinsics(declared, shape), f"intrinsics from {declared.name}"
    elif (path / CALIBRATION).is_file():
        stated = any(file.is_file() for file in files)
        unit_mm = first_intrinsics(files, shape)[0].unit_mm if stated else None
        return FolderCameras(
            load_calibration(path / CALIBRATION), unit_mm, (f"calibration from {CALIBRATION}",)
        )
    else:
        found, origin = first_intrinsics(files, shape)
    calibration = RigCalibration(found.depth)
    notes, fits = _aligned("colour", color, found)
    if fits:
        calibration = replace(calibration, color=found.depth, color_from_depth=Pose.identity())
    more, fits = _aligned("thermal", thermal, found)
    if fits:
        calibration = replace(calibration, thermal=found.depth, thermal_from_depth=Pose.identity())
    return FolderCameras(calibration, found.unit_mm, (origin, *notes, *more))


def _aligned(name: str, images: Files, found: FoundIntrinsics) -> tuple[list[str], bool]:
    """Return a note on the size of images, and whether they have the size of depth and so are aligned."""
    if name == "colour" and found.aligned:
        return [f"{name} assumed to be aligned with depth, as Open3D's recorder saves it"], True
    shape = _shape_of(list(images.values()))
    if shape is None:
        return [], False
    size, depth = (f"{width}x{height}" for height, width in (shape, found.depth.shape))
    if size == depth:
        note = f"{name} assumed to be aligned with depth pixel for pixel: of its size, no {CALIBRATION}"
        return [note], True
    remedy = f"register them to depth, or add {CALIBRATION}"
    return [f"{name} images are {size}, depth is {depth}: not used; {remedy}"], False


def _shape_of(files: list[Path]) -> tuple[int, int] | None:
    """Return (h, w) of the first of a few readable images; None where a frame's own error names the cause."""
    for at in spread(len(files)):
        try:
            data, name = read_bounded(files[at]), str(files[at])
            folder, suffix = files[at].parent.name.lower(), files[at].suffix.lower()
            flir = folder in STREAMS["thermal"] and suffix in JPEGS
            height, width = read_flir(data, name).celsius.shape if flir else image_shape(data, name)
        except FormatError:
            continue
        return height, width
    return None
