"""Protocol of every device, real or virtual.

A device is opened by its constructor or by address (``sensors.recording.open_device``), started once, read in
a loop, and closed. ``stamp_ns`` is on the device's clock, ``arrival_ns`` on the host's monotonic clock.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from sensors.rig.rig_calibration import RigCalibration


class Flag(Enum):
    """State of a thermal camera's shutter (flag), which it closes to calibrate itself (libirimager's
    EvoIRFlagState).
    """

    OPEN = 0
    CLOSED = 1
    OPENING = 2
    CLOSING = 3
    ERROR = 4
    INITIALIZING = 5


@dataclass(frozen=True)
class DepthImage:
    """Depth uint16 (h, w) in millimetres along z, distorted, 0 = no reading.

    infrared: amplitude uint16 (h, w), or None.
    """

    stream: ClassVar[str] = "depth"
    depth_mm: NDArray[np.uint16]
    infrared: NDArray[np.uint16] | None = None


@dataclass(frozen=True)
class ColorImage:
    """Colour image as the camera's own JPEG bytes."""

    stream: ClassVar[str] = "color"
    encoded: bytes = field(repr=False)


@dataclass(frozen=True)
class ThermalImage:
    """Temperatures float32 (h, w), Celsius, NaN = no reading; valid only while the flag (shutter) is OPEN."""

    stream: ClassVar[str] = "thermal"
    celsius: NDArray[np.float32]
    flag: Flag


@dataclass(frozen=True)
class ThermalCounts:
    """Raw detector counts uint16 (h, w), not temperatures; metadata: uint16 (n,) words sent with the image.

    flag: reported by the camera, or detected in the image (``FlagWatch``).
    """

    stream: ClassVar[str] = "thermal"
    counts: NDArray[np.uint16]
    metadata: NDArray[np.uint16]
    flag: Flag


@dataclass(frozen=True)
class Spot:
    """Temperatures of a pyrometer's target, head and (CT) box in Celsius; NaN = not measured."""

    stream: ClassVar[str] = "pyrometer"
    target_c: float
    head_c: float
    box_c: float


Value = DepthImage | ColorImage | ThermalImage | ThermalCounts | Spot


@dataclass(frozen=True)
class DeviceReading:
    """One value of one stream of a device.

    stamp_ns: device clock, unwrapped, rising within a stream, with an arbitrary zero; the arrival for a
    device without a clock. arrival_ns: ``time.monotonic_ns``. dropped: values lost since the previous
    reading.
    """

    stamp_ns: int
    arrival_ns: int
    value: Value
    dropped: int = 0

    @property
    def stream(self) -> str:
        """Return the name of the stream: depth, color, thermal or pyrometer."""
        return self.value.stream


class Device(Protocol):
    """Open device; a second opening raises DeviceBusyError. Every method may raise DeviceError.

    address: opens this device again. serial: "" if unknown. rates_hz: nominal rate of each stream, final
    after ``start``. calibration: factory calibration of a started depth camera. One thread reads; any thread
    may close, which ends a ``read`` under way with DeviceLostError.
    """

    @property
    def address(self) -> str: ...
    @property
    def serial(self) -> str: ...
    @property
    def rates_hz(self) -> Mapping[str, float]: ...
    @property
    def calibration(self) -> RigCalibration | None: ...

    def start(self) -> None:
        """Begin to stream; call once."""
        ...

    def read(self, timeout_s: float) -> DeviceReading | None:
        """Return the next value of any stream, or None after ``timeout_s`` seconds.

        Raises DeviceLostError after unplugging or closing, DeviceFaultError for a violation of the device's
        protocol; reading may go on after a DeviceFaultError.
        """
        ...

    def close(self) -> None:
        """Release the device; idempotent."""
        ...


@dataclass(frozen=True)
class Found:
    """A device that is present. note: step that is needed before the device can be opened."""

    address: str
    kind: str
    serial: str = ""
    virtual: bool = False
    note: str = ""
