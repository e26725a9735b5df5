"""Mounting of a camera (on its side, upside down, mirrored); its images are turned upright.

Depth and thermal images are turned; a colour image stays as the camera encodes it, and the pose of the colour
camera has the turn instead. A mirrored colour image is a new JPEG (``sensors.files.jpeg``).
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

TURNS = {"0": 0, "90": 1, "180": 2, "270": 3}
"""Quarter turns by the value of the option ``turn``, degrees clockwise."""


@dataclass(frozen=True)
class Mounting(Turn):
    """Turn of a device's images."""

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
