"""Mounting of a camera (on its side, upside down, mirrored), and the device that turns images upright.

Depth and thermal images are turned. A colour image keeps its orientation, and the pose of the colour camera
includes the turn instead. A mirrored colour image becomes a new JPEG (``sensors.files.jpeg``).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

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
from sensors.rig.rig_calibration import RigCalibration
from sensors.rig.turn import Turn

TURNS = {"0": 0, "90": 1, "180": 2, "270": 3}  # quarter turns by degrees clockwise
NO_YES = {"no": False, "yes": True}


@dataclass(frozen=True)
class Mounting(Turn):
    """Rotation and mirroring that make a device's images upright."""

    def value(self, value: Value) -> Value:
        """Return a device's value with its images upright."""
        match value:
            case DepthImage(depth_mm, infrared):
                return DepthImage(self.image(depth_mm), None if infrared is None else self.image(infrared))
            case ThermalImage(celsius):
                return replace(value, celsius=self.image(celsius))
            case ThermalCounts(counts):
                return replace(value, counts=self.image(counts))
            case ColorImage(encoded) if self.mirror:
                return ColorImage(mirrored_jpeg(encoded))
        return value


class Mounted:
    """Device whose readings and calibration are turned upright. address: address with the mounting's
    options.
    """

    def __init__(self, address: str, device: Device, mounting: Mounting) -> None:
        self.address, self.device, self.mounting = address, device, mounting
        self.serial, self.start, self.close = device.serial, device.start, device.close

    @property
    def rates_hz(self) -> Mapping[str, float]:
        """Return the nominal rates of the device by stream."""
        return self.device.rates_hz

    @property
    def calibration(self) -> RigCalibration | None:
        """Return the factory calibration for upright images."""
        factory = self.device.calibration
        return None if factory is None else self.mounting.calibration(factory)

    def read(self, timeout_s: float) -> DeviceReading | None:
        """Return the device's next reading, upright."""
        reading = self.device.read(timeout_s)
        return None if reading is None else replace(reading, value=self.mounting.value(reading.value))


def mounting_of(address: Address) -> Mounting:
    """Return the mounting from the options ``turn`` and ``mirror``. Raises DeviceError for unknown values."""
    return Mounting(address.choice("turn", TURNS, "0"), address.choice("mirror", NO_YES, "no"))
