"""Opens virtual devices: each is the real driver, with a twin where its hardware would be."""

import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from sensors.device.address import Address
from sensors.device.protocol import Device
from sensors.drivers.kinect2 import Kinect2
from sensors.drivers.lepton import RATE_HZ, Lepton
from sensors.drivers.optris import LAYOUTS, Optris
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.pyrometer import SCALES, open_pyrometer
from sensors.drivers.pyrometer_protocol import FAMILIES
from sensors.drivers.realsense import RealSense, Settings
from sensors.drivers.y16 import (
    BOSON_HZ,
    BOSON_KELVIN,
    BOSON_SIZES,
    Boson,
    Radiometry,
    Y16Camera,
    radiometry_of,
)
from sensors.errors import DeviceError
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.virtual.fake_kernel import FakeCamera, FakeKernel
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.kinect2 import VirtualKinect2
from sensors.virtual.optris import VirtualOptris
from sensors.virtual.optris_direct import VirtualDirect
from sensors.virtual.pyrometer import LineFaults, VirtualPyrometer
from sensors.virtual.realsense import VirtualRealSense
from sensors.virtual.schedule import Faults
from sensors.virtual.y16 import COUNTS, VirtualLepton, VirtualY16

Twin = VirtualKinect2 | VirtualRealSense | FakeCamera | VirtualDirect | VirtualPyrometer
"""The hardware's side of a virtual device."""


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
    """The virtual device of an address of one of ``TWINS``. Raises DeviceError."""
    return VirtualDevice(address.text, *TWINS[address.kind](address, frames))


def _kinect2(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    faults = _faults(address)
    twin = VirtualKinect2(FrameLoop(frames), faults)
    return Kinect2(shim=twin.shim), twin


def _realsense(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    faults = _faults(address)
    twin = VirtualRealSense(FrameLoop(frames), faults)
    return RealSense(settings=Settings(twin.size, twin.color_size), context=twin), twin


def _optris(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    layout = address.choice("mode", LAYOUTS, "128hz")
    faults = _faults(address)
    twin = VirtualOptris(layout, FrameLoop(frames), faults)
    return Optris(twin.node, layout, "virtual", FakeKernel(twin)), twin


def _lepton(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    faults = _faults(address)
    lepton = VirtualLepton(FrameLoop(frames), faults)
    return Lepton(lepton.node, "virtual", FakeKernel(lepton)), lepton


def _boson(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    celsius = address.choice("celsius", {"no": False, "yes": True}, "no")
    rate_hz = address.number("rate", BOSON_HZ, 1.0, 200.0)
    faults = _faults(address)
    radiometry = Radiometry(BOSON_KELVIN) if celsius else COUNTS
    twin = VirtualY16(FrameLoop(frames), faults, radiometry, rate_hz, BOSON_SIZES[0][::-1])
    return Boson(twin.node, celsius, rate_hz, "virtual", FakeKernel(twin)), twin


def _y16(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    radiometry, rate_hz = radiometry_of(address), address.number("rate", RATE_HZ, 1.0, 200.0)
    faults = _faults(address)
    twin = VirtualY16(FrameLoop(frames), faults, radiometry or COUNTS, rate_hz)
    return Y16Camera(twin.node, twin.size, rate_hz, radiometry, "virtual", FakeKernel(twin)), twin


def _optris_direct(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    faults = _faults(address)
    twin = VirtualDirect(FrameLoop(frames), faults)
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "generic.xml"
        config.write_text("<imager><serial>0</serial></imager>\n", encoding="ascii")
        return OptrisDirect(config, twin.library), twin


def _pyrometer(address: Address) -> tuple[Device, Twin]:
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
    return device, twin


def _faults(address: Address) -> Faults:
    """The faults that the last options of an address state."""
    faults = Faults(
        drop=address.number("drop", 0.0, 0.0, 1.0),
        short=address.number("short", 0.0, 0.0, 1.0),
        unplug_after=address.number("unplug_after", float("inf"), 0.0, 1e6),
        skew_ppm=address.number("skew_ppm", 0.0, -1e5, 1e5),
        jitter_s=address.number("jitter_ms", 0.0, 0.0, 1e4) / 1000,
    )
    address.finish()
    return faults


TWINS: Mapping[str, Callable[[Address, Iterable[RigFrame]], tuple[Device, Twin]]] = {
    "kinect2": _kinect2,
    "realsense": _realsense,
    "optris": _optris,
    "optris-direct": _optris_direct,
    "lepton": _lepton,
    "boson": _boson,
    "y16": _y16,
    "pyrometer": lambda address, _: _pyrometer(address),
}
"""Every kind of device that has a virtual twin, and what opens it."""
