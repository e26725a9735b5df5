"""Virtual devices: each is the real driver with a twin in place of its hardware."""

import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from sensors.device.address import Address
from sensors.device.mounting import NO_YES
from sensors.device.protocol import Device
from sensors.drivers import lepton, y16
from sensors.drivers.kinect2 import Kinect2
from sensors.drivers.optris import LAYOUTS, Optris
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.pyrometer import Pyrometer, pyrometer_options
from sensors.drivers.realsense import RealSense, Settings
from sensors.errors import DeviceError
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.kinect2 import VirtualKinect2
from sensors.virtual.optris_direct import VirtualDirect
from sensors.virtual.pyrometer import LineFaults, VirtualPyrometer
from sensors.virtual.realsense import VirtualRealSense
from sensors.virtual.schedule import Faults
from sensors.virtual.v4l2 import COUNTS, FakeCamera, VirtualLepton, VirtualOptris, VirtualWords, VirtualY16

Twin = VirtualKinect2 | VirtualRealSense | FakeCamera | VirtualDirect | VirtualPyrometer


class VirtualDevice:
    """Device made of a real driver and its twin."""

    def __init__(self, address: str, device: Device, twin: Twin) -> None:
        self.address, self.device, self.twin = address, device, twin
        self.serial, self.rates_hz = device.serial, device.rates_hz
        self.start, self.read = device.start, device.read

    @property
    def calibration(self) -> RigCalibration | None:
        """Return the calibration of the driver."""
        return self.device.calibration

    def close(self) -> None:
        """Close the driver, then end the twin; idempotent."""
        self.device.close()
        self.twin.unplug()


def open_twin(address: Address, frames: Iterable[RigFrame]) -> Device:
    """Return the virtual device of an address of one of ``TWINS``. Raises DeviceError for wrong options."""
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
    return Optris(twin.node, layout), twin


def _lepton(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    faults = _faults(address)
    twin = VirtualLepton(FrameLoop(frames), faults)
    return lepton.Lepton(twin.node), twin


def _words(
    address: Address, frames: Iterable[RigFrame], mode: y16.WordMode, shape: tuple[int, int]
) -> tuple[Device, Twin]:
    faults = _faults(address)
    words = VirtualWords(mode.radiometry or COUNTS, mode.rate_hz, shape)
    twin = VirtualY16(FrameLoop(frames), faults, words)
    return y16.WordCamera(twin.node, mode), twin


def _boson(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    celsius = address.choice("celsius", NO_YES, "no")
    mode = y16.boson_mode(celsius, address.number("rate", y16.BOSON_HZ, 1.0, 200.0))
    return _words(address, frames, mode, y16.BOSON_SIZES[0][::-1])


def _y16(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    radiometry = y16.radiometry_of(address)
    rate_hz = address.number("rate", lepton.RATE_HZ, 1.0, 200.0)
    return _words(address, frames, y16.y16_mode((160, 120), rate_hz, radiometry), (120, 160))


def _optris_direct(address: Address, frames: Iterable[RigFrame]) -> tuple[Device, Twin]:
    faults = _faults(address)
    twin = VirtualDirect(FrameLoop(frames), faults)
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "generic.xml"
        config.write_text("<imager><serial>0</serial></imager>\n", encoding="ascii")
        return OptrisDirect(config, twin.library), twin


def _pyrometer(address: Address, _: Iterable[RigFrame]) -> tuple[Device, Twin]:
    shares = {name: address.number(name, 0.0, 0.0, 1.0) for name in ("noise", "loss", "refuse")}
    faults = LineFaults(address.number("delay", 0.0, 0.0, 10.0), **shares)
    options = pyrometer_options(address)
    twin = VirtualPyrometer(options)
    try:
        device = Pyrometer(twin.port, options)
    except DeviceError:
        twin.unplug()
        raise
    twin.faults = faults
    return device, twin


def _faults(address: Address) -> Faults:
    """Return the faults that the remaining options of an address set; refuse unknown options."""
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
    "pyrometer": _pyrometer,
}
