"""All devices by address: which there are, and opening one, real or virtual."""

import errno
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from serial.tools.list_ports import comports

from sensors.device.address import Address
from sensors.device.mounting import Mounted, Mounting, mounting_of
from sensors.device.node import node_error, video_nodes
from sensors.device.protocol import Device, Found
from sensors.drivers.azure_kinect import CLOSED, AzureKinect, azure_devices
from sensors.drivers.kinect2 import Kinect2, kinect2_serials, load_shim
from sensors.drivers.lepton import RATE_HZ, Lepton
from sensors.drivers.lepton import USB_ID as LEPTON_ID
from sensors.drivers.optris import LAYOUTS, USB_ID, Optris
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.orbbec import Orbbec, orbbec_serials
from sensors.drivers.pyrometer import open_pyrometer
from sensors.drivers.realsense import PRESETS, RATES, SIZES, RealSense, Settings, realsense_serials
from sensors.drivers.y16 import BOSON_HZ, BOSON_USB_ID, Boson, Y16Camera, radiometry_of
from sensors.errors import DeviceError, DeviceNotFoundError
from sensors.files.bounded import MAX_IMAGE_SIDE
from sensors.rig.frame import RigFrame
from sensors.virtual.twins import TWINS, open_twin

VIRTUAL = (
    "virtual:kinect2",
    "virtual:realsense",
    "virtual:optris?mode=128hz",
    "virtual:optris-direct",
    "virtual:lepton",
    "virtual:boson?celsius=yes",
    "virtual:y16?scale=0.01&offset=-273.15",
    "virtual:pyrometer?family=ct",
    "virtual:pyrometer?family=cs",
)


def open_device(address: str, frames: Iterable[RigFrame] = ()) -> Device:
    """Open the device at ``address`` (see ``docs/devices.md``).

    frames: what a virtual camera sees, in a loop of at most a second.
    Raises DeviceError.
    """
    parsed = Address(address)
    check_kind(parsed)
    mounting = Mounting() if parsed.kind == "pyrometer" else mounting_of(parsed)
    device = open_twin(parsed, frames) if parsed.virtual else OPENERS[parsed.kind](parsed)
    return device if mounting == Mounting() else Mounted(address, device, mounting)


def check_kind(address: Address) -> None:
    """Raise DeviceError for an address of no known kind."""
    if address.virtual and address.kind not in TWINS:
        raise DeviceError(f"{address.text!r} has no virtual twin; use virtual: with {', '.join(TWINS)}")
    if not address.virtual and address.kind not in OPENERS:
        raise DeviceError(f"{address.text!r} is of no known kind; use {', '.join(OPENERS)}, or virtual:KIND")


def find_devices() -> list[Found]:
    """Devices that are plugged in, then the virtual ones.

    The libraries of Kinects, RealSense and Orbbec cameras open each camera for a moment to read its number.
    Nothing is sent to thermal cameras and serial ports.
    """
    return [
        *_numbered("kinect2", _kinect2_serials()),
        *_numbered("realsense", realsense_serials()),
        *_numbered("azure", [serial for _, serial in azure_devices()], CLOSED),
        *_numbered("orbbec", orbbec_serials()),
        *(
            Found(f"{kind}:{node}", kind, serial, note=_access(node))
            for kind, usb_id in (("optris", USB_ID), ("lepton", LEPTON_ID), ("boson", BOSON_USB_ID))
            for node, serial in video_nodes(usb_id)
        ),
        *_serial_ports(),
        *(Found(address, address.split(":")[1].split("?")[0], virtual=True) for address in VIRTUAL),
    ]


def _numbered_opener(camera: Callable[[str], Device]) -> Callable[[Address], Device]:
    """Opens a camera that its serial number names."""

    def opened(address: Address) -> Device:
        address.finish()
        return camera(address.target)

    return opened


def _open_realsense(address: Address) -> Device:
    settings = Settings(
        address.choice("size", SIZES, "848x480"),
        address.choice("color", SIZES, "1280x720"),
        address.choice("rate", RATES, "30"),
        address.choice("preset", PRESETS | {"": None}, ""),
        address.given_number("exposure", 1, 200_000),
        address.given_number("laser", 0, 360),
    )
    address.finish()
    return RealSense(address.target, settings)


def _open_optris(address: Address) -> Device:
    layout = address.choice("mode", LAYOUTS, "128hz")
    address.finish()
    node = _target(address, "/dev/video0")
    return Optris(node, layout, dict(video_nodes(USB_ID)).get(node, ""))


def _open_direct(address: Address) -> Device:
    emissivity = address.given_number("emissivity", 0.1, 1.1)
    address.finish()
    device = OptrisDirect(_target(address, "/path/to/generic.xml"))
    if emissivity is not None:
        try:
            device.set_emissivity(emissivity)
        except DeviceError:
            device.close()
            raise
    return device


def _open_lepton(address: Address) -> Device:
    address.finish()
    node = _target(address, "/dev/video0")
    return Lepton(node, dict(video_nodes(LEPTON_ID)).get(node, ""))


def _open_boson(address: Address) -> Device:
    celsius = address.choice("celsius", {"no": False, "yes": True}, "no")
    rate_hz = address.number("rate", BOSON_HZ, 1.0, 200.0)
    address.finish()
    node = _target(address, "/dev/video0")
    return Boson(node, celsius, rate_hz, dict(video_nodes(BOSON_USB_ID)).get(node, ""))


def _open_y16(address: Address) -> Device:
    width, height = (address.given_integer(side, 1, MAX_IMAGE_SIDE) for side in ("width", "height"))
    rate_hz, radiometry = address.number("rate", RATE_HZ, 1.0, 200.0), radiometry_of(address)
    address.finish()
    return Y16Camera(_target(address, "/dev/video0"), (width or 160, height or 120), rate_hz, radiometry)


OPENERS: Mapping[str, Callable[[Address], Device]] = {
    "kinect2": _numbered_opener(Kinect2),
    "realsense": _open_realsense,
    "azure": _numbered_opener(AzureKinect),
    "orbbec": _numbered_opener(Orbbec),
    "optris": _open_optris,
    "optris-direct": _open_direct,
    "lepton": _open_lepton,
    "boson": _open_boson,
    "y16": _open_y16,
    "pyrometer": lambda address: open_pyrometer(address, _target(address, "/dev/ttyUSB0")),
}
"""Every kind of real device, and what opens it."""


def _target(address: Address, example: str) -> Path:
    if not address.target:
        raise DeviceError(f"{address.text!r} names no node; give for instance {address.kind}:{example}")
    return Path(address.target)


def _kinect2_serials() -> list[str]:
    try:
        return kinect2_serials(load_shim())
    except DeviceNotFoundError:
        return []


def _serial_ports() -> list[Found]:
    remark = "a serial port; only opening it shows whether a pyrometer answers"
    found = []
    for port in sorted(comports(), key=lambda port: str(port.device)):
        note = _access(Path(port.device)) or remark
        found.append(Found(f"pyrometer:{port.device}", "pyrometer", port.serial_number or "", note=note))
    return found


def _numbered(kind: str, serials: list[str], closed: str = "") -> list[Found]:
    """Devices by serial number, with a note on two of one number. closed: note on those without a number."""
    twice = "another one has the same serial number; unplug one of them"
    notes = [closed if not serial else twice if serials.count(serial) > 1 else "" for serial in serials]
    return [
        Found(f"{kind}:{serial}", kind, serial, note=note)
        for serial, note in zip(serials, notes, strict=True)
    ]


def _access(node: Path) -> str:
    """What keeps this user from the node, without opening it."""
    return "" if os.access(node, os.R_OK | os.W_OK) else str(node_error(node, errno.EACCES))
