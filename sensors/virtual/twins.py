"""Opens virtual devices: each is the real driver, with a twin where its hardware would be."""

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol

from sensors.device.address import Address
from sensors.device.protocol import Device
from sensors.drivers.kinect2 import Kinect2
from sensors.drivers.optris import Optris
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.optris_layout import LAYOUTS
from sensors.drivers.pyrometer import SCALES, open_pyrometer
from sensors.drivers.pyrometer_protocol import FAMILIES
from sensors.drivers.video import OpenCvVideo
from sensors.errors import DeviceError
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.virtual.kinect2 import VirtualKinect2
from sensors.virtual.optris import FakeKernel, VirtualOptris
from sensors.virtual.optris_direct import VirtualDirect
from sensors.virtual.pyrometer import LineFaults, VirtualPyrometer
from sensors.virtual.scene import Scene
from sensors.virtual.schedule import Faults


class Twin(Protocol):
    """The hardware's side of a virtual device."""

    def unplug(self) -> None:
        """Vanish; idempotent."""
        ...


class VirtualDevice:
    """A real driver and its twin as one ``Device``: the driver's methods; closing ends both."""

    def __init__(self, address: str, device: Device, twin: Twin) -> None:
        self.address, self.device, self.twin = address, device, twin
        self.serial, self.rates_hz = device.serial, device.rates_hz
        self.start, self.read = device.start, device.read

    @property
    def calibration(self) -> RigCalibration | None:
        """The driver's."""
        return self.device.calibration

    def close(self) -> None:
        """End the driver, then the twin; idempotent."""
        self.device.close()
        self.twin.unplug()


def open_twin(address: Address, frames: Iterable[RigFrame]) -> Device:
    """The virtual device of an address; see ``sensors.recording.open_device``. Raises DeviceError."""
    openers: dict[str, Callable[[Address, Iterable[RigFrame]], Device]] = {
        "kinect2": _kinect2,
        "optris": _optris,
        "optris-direct": _optris_direct,
        "pyrometer": lambda address, _: _pyrometer(address),
    }
    if address.kind not in openers:
        raise DeviceError(
            f"device {address.text!r} has no virtual twin; use virtual: with {', '.join(openers)}"
        )
    return openers[address.kind](address, frames)


def _kinect2(address: Address, frames: Iterable[RigFrame]) -> Device:
    faults = _faults(address)
    address.finish()
    twin = VirtualKinect2(Scene(frames), faults)
    return VirtualDevice(address.text, Kinect2(shim=twin.shim), twin)


def _optris(address: Address, frames: Iterable[RigFrame]) -> Device:
    layout, faults = address.choice("mode", LAYOUTS, "128hz"), _faults(address)
    address.finish()
    twin = VirtualOptris(layout, Scene(frames), faults)
    video = OpenCvVideo(twin.node, layout, FakeKernel(twin))
    return VirtualDevice(address.text, Optris(twin.node, layout, video, "virtual"), twin)


def _optris_direct(address: Address, frames: Iterable[RigFrame]) -> Device:
    faults = _faults(address)
    address.finish()
    twin = VirtualDirect(Scene(frames), faults)
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "generic.xml"
        config.write_text("<imager><serial>0</serial></imager>\n", encoding="ascii")
        return VirtualDevice(address.text, OptrisDirect(config, twin.library), twin)


def _pyrometer(address: Address) -> Device:
    family, scale = address.choice("family", FAMILIES, "ct"), address.choice("step", SCALES, "0.1")
    faults = LineFaults(
        address.number("delay", 0.0, 0.0, 10.0),
        *(address.number(name, 0.0, 0.0, 1.0) for name in ("noise", "loss", "refuse")),
    )
    twin = VirtualPyrometer(family, rs485=address.given_integer("rs485", 1, 32), scale=scale)
    try:
        device = open_pyrometer(address, twin.port)
    except DeviceError:
        twin.unplug()
        raise
    twin.faults = faults
    return VirtualDevice(address.text, device, twin)


def _faults(address: Address) -> Faults:
    return Faults(
        drop=address.number("drop", 0.0, 0.0, 1.0),
        short=address.number("short", 0.0, 0.0, 1.0),
        unplug_after=address.number("unplug_after", float("inf"), 0.0, 1e6),
        skew_ppm=address.number("skew_ppm", 0.0, -1e5, 1e5),
        jitter_s=address.number("jitter_ms", 0.0, 0.0, 1e4) / 1000,
    )
