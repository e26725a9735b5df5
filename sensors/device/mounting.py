"""Mounting of a camera (on its side, upside down, mirrored); its images are turned upright.

Depth and thermal images are turned; a colour image stays as the camera encodes it, and the pose of the colour
camera has the turn instead. A mirrored colour image is a new JPEG (``sensors.files.jpeg``).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sensors.device.address import Address
from sensors.device.protocol import (
    ColorImage,
    DepthImage,
    Device,
    DeviceReading,
    ThermalCounts,
    ThermalImage,
    Value,
)
from sensors.files.jpeg import mirrored_jpeg
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration

Pixel = TypeVar("Pixel", bound=np.generic)
TURNS = {"0": 0, "90": 1, "180": 2, "270": 3}
"""Quarter turns by the value of the option ``turn``, degrees clockwise."""
_MIRROR = np.diag([-1.0, 1.0, 1.0])
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From a camera's frame to that of its image turned clockwise: x' = -y, y' = x."""


@dataclass(frozen=True)
class Mounting:
    """Transformation of images: mirrored left to right, then turned clockwise by ``quarters``."""

    quarters: int = 0
    mirror: bool = False

    def image(self, image: NDArray[Pixel]) -> NDArray[Pixel]:
        """An image (h, w), upright."""
        return np.ascontiguousarray(np.rot90(image[:, ::-1] if self.mirror else image, -self.quarters))

    def camera(self, camera: Intrinsics) -> Intrinsics:
        """The camera of the upright image."""
        if self.mirror:
            camera = replace(camera, cx=camera.width - 1 - camera.cx, p2=-camera.p2)
        for _ in range(self.quarters):
            camera = replace(
                camera,
                width=camera.height,
                height=camera.width,
                fx=camera.fy,
                fy=camera.fx,
                cx=camera.height - 1 - camera.cy,
                cy=camera.cx,
                p1=camera.p2,
                p2=-camera.p1,
            )
        return camera

    def calibration(self, factory: RigCalibration) -> RigCalibration:
        """The calibration of a depth camera, with or without colour, mounted so."""
        depth = self.camera(factory.depth)
        if factory.color is None or factory.color_from_depth is None:
            return replace(factory, depth=depth)
        color, pose = Mounting(0, self.mirror).camera(factory.color), factory.color_from_depth
        if self.mirror:
            pose = Pose(_MIRROR @ pose.rotation @ _MIRROR, _MIRROR @ pose.translation_m)
        back = Pose(np.linalg.matrix_power(_QUARTER, self.quarters).T, np.zeros(3))
        return replace(factory, depth=depth, color=color, color_from_depth=pose @ back)

    def value(self, value: Value) -> Value:
        """A reading, upright."""
        if isinstance(value, DepthImage):
            infrared = None if value.infrared is None else self.image(value.infrared)
            return DepthImage(self.image(value.depth_mm), infrared)
        if isinstance(value, ThermalImage):
            return replace(value, celsius=self.image(value.celsius))
        if isinstance(value, ThermalCounts):
            return replace(value, counts=self.image(value.counts))
        if isinstance(value, ColorImage) and self.mirror:
            return ColorImage(mirrored_jpeg(value.encoded))
        return value


class Mounted:
    """A device that is mounted so; else the very device. address: with the options of its mounting."""

    def __init__(self, address: str, device: Device, mounting: Mounting) -> None:
        self.address, self.device, self.mounting = address, device, mounting
        self.start, self.close = device.start, device.close

    @property
    def serial(self) -> str:
        """The device's."""
        return self.device.serial

    @property
    def rates_hz(self) -> Mapping[str, float]:
        """The device's."""
        return self.device.rates_hz

    @property
    def calibration(self) -> RigCalibration | None:
        """The factory's, for upright images."""
        factory = self.device.calibration
        return None if factory is None else self.mounting.calibration(factory)

    def read(self, timeout_s: float) -> DeviceReading | None:
        """The device's next reading, upright."""
        reading = self.device.read(timeout_s)
        return None if reading is None else replace(reading, value=self.mounting.value(reading.value))


def mounting_of(address: Address) -> Mounting:
    """By the options ``turn`` and ``mirror`` of an address. Raises DeviceError."""
    return Mounting(
        address.choice("turn", TURNS, "0"), address.choice("mirror", {"no": False, "yes": True}, "no")
    )
