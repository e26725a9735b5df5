"""Check of cameras: impossible focal lengths, principal points and lenses are refused.

Every importer checks its cameras here. The bounds are wide: they stop numbers of another unit (millimetres,
shares of the image, thousandths), not unusual cameras. Constants are untuned unless a source is given.
"""

import numpy as np

from sensors.errors import CalibrationError, Setting
from sensors.rig.camera import Intrinsics, distort, undistort
from sensors.rig.rig_calibration import RigCalibration

WIDEST, NARROWEST = 0.134, 10.0  # focal length over the longer side: pinholes of 150 and of 6 degrees
SQUEEZED = 4.0  # fx over fy; images squeezed in one direction have 2
CENTRED = 0.25  # share of a side from the middle, where the centre determines the size or the axes
OFF_CENTRE = 2.0  # sides by which a cropped image's centre may lie outside
BEND = 2.5  # by which a lens moves the middle of a side; barrels of 120 degrees have 1.7
RING = 0.9  # share of the largest circle within the image in which a lens must have an inverse
CLOSES = 1e-3  # greatest relative difference after undistorting and distorting again


def check_camera(camera: Intrinsics, where: str) -> Intrinsics:
    """Return the camera unchanged. Raises CalibrationError, beginning with ``where``, for an impossible
    camera.
    """
    side = max(camera.width, camera.height)
    for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
        if not WIDEST < focal / side < NARROWEST:
            degrees = 2 * np.degrees(np.arctan(side / 2 / focal))
            raise CalibrationError(
                f"{where}: focal length {name} {focal:g} px in an image of {camera.width}x{camera.height} is "
                f"a view of {degrees:.3g} degrees, which no such camera has; give it in pixels of this image",
                Setting.INTRINSICS,
            )
    if not 1 / SQUEEZED < camera.fx / camera.fy < SQUEEZED:
        raise CalibrationError(
            f"{where}: focal lengths fx {camera.fx:g} and fy {camera.fy:g} px differ too much; "
            "give both in pixels of this image",
            Setting.INTRINSICS,
        )
    for name, centre, length in (("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height)):
        if not -OFF_CENTRE * length < centre < (1 + OFF_CENTRE) * length:
            raise CalibrationError(
                f"{where}: centre {name} {centre:g} lies far outside the image of {camera.width}x"
                f"{camera.height}; give the intrinsics of this image",
                Setting.INTRINSICS,
            )
    if any(camera.distortion):
        _check_lens(camera, where)
    return camera


def is_centred(centre: tuple[float, float], shape: tuple[int, ...]) -> bool:
    """Return whether a camera's principal point (cx, cy) lies near the middle of an image (h, w)."""
    offsets = (length / side - 0.5 for length, side in zip(centre, shape[::-1], strict=True))
    return max(map(abs, offsets)) <= CENTRED


def check_rig(calibration: RigCalibration, where: str) -> RigCalibration:
    """Return the calibration unchanged. Raises CalibrationError where ``check_camera`` refuses a camera."""
    for name, camera in vars(calibration).items():
        if isinstance(camera, Intrinsics):
            check_camera(camera, f"{where}, {name} camera")
    return calibration


def _check_lens(camera: Intrinsics, where: str) -> None:
    around = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    focal, size = np.array([camera.fx, camera.fy]), np.array([camera.width, camera.height])
    radius = float(RING * (size / focal).min() / 2)
    centre = ((size - 1) / 2 - (camera.cx, camera.cy)) / focal
    points = np.stack([np.cos(around), np.sin(around)], axis=-1) * radius + centre
    ideal = undistort(camera, points)
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(distort(camera, ideal) - points).max(axis=-1)
        bend = np.linalg.norm(ideal, axis=-1) / np.maximum(np.linalg.norm(points, axis=-1), 1e-9)
    if not ((error < CLOSES * max(radius, 1e-9)).all() and (bend < BEND).all() and (bend > 1 / BEND).all()):
        lens = ", ".join(f"{number:g}" for number in camera.distortion)
        raise CalibrationError(
            f"{where}: lens coefficients k1, k2, p1, p2, k3 of {lens} have no inverse within the image; "
            "give OpenCV's, without unit, or 0 for images without distortion",
            Setting.INTRINSICS,
        )
