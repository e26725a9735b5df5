"""The protocol of every device, real or virtual: what it is, what it reads, and when.

A device is opened by its constructor (or by address: ``sensors.recording.open_device``), started
once, read in a loop, and closed. Times: ``stamp_ns`` is the device's own clock, ``arrival_ns`` the host's
monotonic clock.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from sensors.rig.rig_calibration import RigCalibration


class Flag(Enum):
    """State of a thermal camera's shutter, by which it calibrates itself (libirimager's EvoIRFlagState)."""

    OPEN = 0
    CLOSED = 1
    OPENING = 2
    CLOSING = 3
    ERROR = 4
    INITIALIZING = 5


@dataclass(frozen=True)
class DepthImage:
    """depth_mm: uint16 (h, w) millimetres along z, 0 = no reading, lens distortion still in.

    infrared: uint16 (h, w) amplitude of the same exposure, where the device gives it.
    """

    stream: ClassVar[str] = "depth"
    depth_mm: NDArray[np.uint16]
    infrared: NDArray[np.uint16] | None = None


@dataclass(frozen=True)
class ColorImage:
    """encoded: the camera's own JPEG bytes."""

    stream: ClassVar[str] = "color"
    encoded: bytes = field(repr=False)


@dataclass(frozen=True)
class ThermalImage:
    """celsius: float32 (h, w), NaN = no reading. Only with the flag OPEN do the values mean anything."""

    stream: ClassVar[str] = "thermal"
    celsius: NDArray[np.float32]
    flag: Flag


@dataclass(frozen=True)
class ThermalCounts:
    """Raw detector counts, which are no temperature without the vendor's radiometric calibration.

    counts: uint16 (h, w). metadata: uint16 (n,), words that come with the image, an Optris' undocumented.
    flag: as the camera gives it, or as it was recognised in the image (see ``FlagWatch``).
    """

    stream: ClassVar[str] = "thermal"
    counts: NDArray[np.uint16]
    metadata: NDArray[np.uint16]
    flag: Flag


@dataclass(frozen=True)
class Spot:
    """Reading of a pyrometer: target, head and (CT) box temperature in Celsius; NaN = not measured."""

    stream: ClassVar[str] = "pyrometer"
    target_c: float
    head_c: float
    box_c: float


Value = DepthImage | ColorImage | ThermalImage | ThermalCounts | Spot


@dataclass(frozen=True)
class DeviceReading:
    """One value of one stream of a device.

    stamp_ns: the device's clock, wrap-around undone, increasing within a stream; its zero is arbitrary,
    and devices without a clock of their own give the arrival. arrival_ns: host, ``time.monotonic_ns``.
    dropped: values of this stream that the device made, but that were lost since the reading before.
    """

    stamp_ns: int
    arrival_ns: int
    value: Value
    dropped: int = 0

    @property
    def stream(self) -> str:
        """Stream of the device that this belongs to: depth, color, thermal or pyrometer."""
        return self.value.stream


class Device(Protocol):
    """An open device. Every method may raise a DeviceError, whose one line has the remedy.

    ``read`` belongs to one thread; ``close`` may be called from another, and ends a ``read`` under way
    (which then raises DeviceLostError).
    """

    @property
    def address(self) -> str:
        """The address that opens this very device: ``kinect2:SERIAL``, ``optris:/dev/video0``, ..."""
        ...

    @property
    def serial(self) -> str:
        """Serial number as printed on the device; empty where it cannot be read."""
        ...

    @property
    def rates_hz(self) -> Mapping[str, float]:
        """Nominal rate of every stream of a device that has started."""
        ...

    @property
    def calibration(self) -> RigCalibration | None:
        """The factory's, of a depth camera that has started; else None."""
        ...

    def start(self) -> None:
        """Begin to stream; once. Raises DeviceError."""
        ...

    def read(self, timeout_s: float) -> DeviceReading | None:
        """The next value of any stream, or None when there was none for ``timeout_s`` seconds.

        Raises DeviceLostError when the device was unplugged or closed, DeviceFaultError when it sent
        something its protocol does not allow (reading on is allowed).
        """
        ...

    def close(self) -> None:
        """Give the device back; further calls do nothing."""
        ...


@dataclass(frozen=True)
class Found:
    """A device that could be opened. note: what to do first, where it cannot be opened as it is."""

    address: str
    kind: str
    serial: str = ""
    virtual: bool = False
    note: str = ""
