"""Judge of cameras: focal lengths, centres and lenses that no camera has are refused.

Every importer passes its cameras through here. The bounds are wide: they stop numbers of another unit
(millimetres, shares of the image, thousandths), not unusual cameras.
"""

from dataclasses import fields
from typing import Final

import numpy as np

from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, distort, undistort
from sensors.rig.rig_calibration import RigCalibration

WIDEST, NARROWEST = 0.134, 10.0
"""Focal length as a share of the image's longer side: a pinhole of 150 degrees, and one of 6. Thermal lenses
are as narrow as 13 degrees, fisheyes are no pinholes."""
SQUEEZED = 4.0
"""Most times by which fx and fy differ; images that are squeezed in one direction have 2."""
CENTRED = 0.25
"""Share of a side by which the centre is off the middle at most where it determines the size or the axes.
Untuned."""
OFF_CENTRE = 2.0
"""Sides of the image by which a cropped image's centre may lie outside it. Untuned."""
BEND: Final = 2.5
"""Most times by which a lens moves the middle of an image's side towards or away from its centre. Barrels of
120 degrees have 1.7. Untuned."""
RING = 0.9
"""Share of the largest circle within the image where a lens must have an inverse: corners may have none."""
CLOSES = 1e-3
"""Greatest difference after undistorting and distorting again, relative to the point. Untuned."""


def check_camera(camera: Intrinsics, where: str) -> Intrinsics:
    """Return the camera. Raises CalibrationError, beginning with ``where``, for one that no camera is."""
    side = max(camera.width, camera.height)
    for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
        if not WIDEST < focal / side < NARROWEST:
            degrees = 2 * np.degrees(np.arctan(side / 2 / focal))
            raise CalibrationError(
                f"{where}: focal length {name} {focal:g} px in an image of {camera.width}x{camera.height} is "
                f"a view of {degrees:.3g} degrees, which no such camera has; give it in pixels of this image "
                "(--intrinsics FILE)"
            )
    if not 1 / SQUEEZED < camera.fx / camera.fy < SQUEEZED:
        raise CalibrationError(
            f"{where}: focal lengths fx {camera.fx:g} and fy {camera.fy:g} px differ too much; "
            "give both in pixels of this image (--intrinsics FILE)"
        )
    for name, centre, length in (("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height)):
        if not -OFF_CENTRE * length < centre < (1 + OFF_CENTRE) * length:
            raise CalibrationError(
                f"{where}: centre {name} {centre:g} lies far outside the image of {camera.width}x"
                f"{camera.height}; give the intrinsics of this image (--intrinsics FILE)"
            )
    if any(camera.distortion):
        _check_lens(camera, where)
    return camera


def is_centred(centre: tuple[float, float], shape: tuple[int, ...]) -> bool:
    """Return whether a camera's centre (cx, cy) lies near the middle of an image (h, w)."""
    offsets = (length / side - 0.5 for length, side in zip(centre, shape[::-1], strict=True))
    return max(map(abs, offsets)) <= CENTRED


def check_rig(calibration: RigCalibration, where: str) -> RigCalibration:
    """Return the calibration, all of whose cameras pass ``check_camera``. Raises CalibrationError."""
    for field in fields(calibration):
        camera = getattr(calibration, field.name)
        if isinstance(camera, Intrinsics):
            check_camera(camera, f"{where}, {field.name} camera")
    return calibration


def _check_lens(camera: Intrinsics, where: str) -> None:
    """Raise CalibrationError where the lens has no inverse within the image, or bends it beyond measure."""
    around = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    radius = RING * min(camera.width / camera.fx, camera.height / camera.fy) / 2
    centre = (
        ((camera.width - 1) / 2 - camera.cx) / camera.fx,
        ((camera.height - 1) / 2 - camera.cy) / camera.fy,
    )
    points = np.stack([np.cos(around), np.sin(around)], axis=-1) * radius + centre
    ideal = undistort(camera, points)
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(distort(camera, ideal) - points).max(axis=-1)
        bend = np.linalg.norm(ideal, axis=-1) / np.maximum(np.linalg.norm(points, axis=-1), 1e-9)
    if not ((error < CLOSES * max(radius, 1e-9)).all() and (bend < BEND).all() and (bend > 1 / BEND).all()):
        lens = ", ".join(f"{number:g}" for number in camera.distortion)
        raise CalibrationError(
            f"{where}: lens coefficients k1, k2, p1, p2, k3 of {lens} have no inverse within the image; "
            "give those of OpenCV (--intrinsics FILE), without unit, or 0 for images without distortion"
        )
