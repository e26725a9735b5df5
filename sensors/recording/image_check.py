"""Check of single images: corrupt ones are left out, a camera in a wrong mode ends the recording."""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import ColorImage, DepthImage, Spot, ThermalCounts, ThermalImage, Value
from sensors.errors import CalibrationError, FormatError
from sensors.files.images import size_of_encoded
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration

SETUP_IMAGES = 10  # first images of a stream that are all bad if its camera is in a wrong mode; untuned
NAMES = {"depth": "depth", "color": "colour", "thermal": "thermal", "pyrometer": "pyrometer"}  # in messages


class ImageCheck:
    """Check of a rig's images. A stream whose first ``SETUP_IMAGES`` are all bad is in a wrong mode."""

    def __init__(self, calibration: RigCalibration) -> None:
        self._calibration = calibration
        self._good, self._bad = set[str](), Counter[str]()

    def fault(self, value: Value) -> str:
        """Return the fault of an image, "" for a good one. Raises CalibrationError for a wrong mode."""
        if not (why := _fault(value, self._calibration)):
            self._good.add(value.stream)
            return ""
        self._bad[value.stream] += 1
        name, number = NAMES[value.stream], self._bad[value.stream]
        if value.stream not in self._good and number == SETUP_IMAGES:
            raise CalibrationError(
                f"the first {number} {name} images are unusable, the last one is {why}; set the camera to "
                "the calibrated mode, or give the calibration of this mode"
            )
        return f"{name}: an image that is {why}, left out"


def _fault(value: Value, calibration: RigCalibration) -> str:
    match value:
        case DepthImage(depth_mm, infrared):
            images = [depth_mm] if infrared is None else [depth_mm, infrared]
            faults = [_misshapen(image, np.dtype(np.uint16), calibration.depth) for image in images]
            return next(filter(None, faults), "")
        case ColorImage(encoded):
            return _corrupt(encoded, calibration.color)
        case ThermalImage(celsius):
            return _misshapen(celsius, np.dtype(np.float32), calibration.thermal)
        case ThermalCounts(counts):
            return _misshapen(counts, np.dtype(np.uint16), None)
        case Spot():
            return ""


def _misshapen(image: NDArray[np.generic], dtype: np.dtype[np.generic], camera: Intrinsics | None) -> str:
    if image.ndim != 2 or image.dtype != dtype or not image.size:
        return f"{image.dtype} {image.shape} instead of {dtype} (height, width)"
    return _of_size(image.shape[1], image.shape[0], camera)


def _corrupt(encoded: bytes, camera: Intrinsics | None) -> str:
    """Return the fault of a JPEG or PNG by its header and end, without decoding."""
    try:
        return _of_size(*size_of_encoded(encoded), camera)
    except FormatError as error:
        return str(error)


def _of_size(width: int, height: int, camera: Intrinsics | None) -> str:
    if camera is None or (height, width) == camera.shape:
        return ""
    return f"{width}x{height} instead of {camera.width}x{camera.height}"
