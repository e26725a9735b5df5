"""All devices by address: which there are, and opening one, real or virtual."""

import errno
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from serial.tools.list_ports import comports

from sensors.device.address import Address
from sensors.device.node import node_error
from sensors.device.protocol import Device, Found
from sensors.device.usb import video_nodes
from sensors.drivers.kinect2 import Kinect2, kinect2_serials
from sensors.drivers.kinect2_shim import load_shim
from sensors.drivers.optris import USB_ID, Optris
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.optris_layout import LAYOUTS
from sensors.drivers.pyrometer import open_pyrometer
from sensors.drivers.video import OpenCvVideo
from sensors.errors import DeviceError, DeviceNotFoundError
from sensors.rig.frame import RigFrame
from sensors.virtual.twins import open_twin

VIRTUAL = (
    "virtual:kinect2",
    "virtual:optris?mode=128hz",
    "virtual:optris-direct",
    "virtual:pyrometer?family=ct",
    "virtual:pyrometer?family=cs",
)


def open_device(address: str, frames: Iterable[RigFrame] = ()) -> Device:
    """Open the device at ``address`` (see ``docs/devices.md``).

    frames: what a virtual camera sees, in a loop of at most a second.
    Raises DeviceError.
    """
    parsed = Address(address)
    if parsed.virtual:
        return open_twin(parsed, frames)
    if parsed.kind not in OPENERS:
        raise DeviceError(
            f"device {address!r} is of no known kind; use {', '.join(OPENERS)}, or virtual: before one"
        )
    return OPENERS[parsed.kind](parsed)


def find_devices() -> list[Found]:
    """Devices that are plugged in, then the virtual ones. Nothing is sent to any of them."""
    finders = (_find_kinect2, _find_azure, _find_orbbec, _find_optris, _find_serial_ports)
    real = [found for find in finders for found in find()]
    return real + [Found(address, address.split(":")[1].split("?")[0], virtual=True) for address in VIRTUAL]


def _open_kinect2(address: Address) -> Device:
    address.finish()
    return Kinect2(address.target)


def _open_azure(address: Address) -> Device:
    from sensors.drivers.azure_kinect import AzureKinect

    address.finish()
    return AzureKinect(address.target)


def _open_orbbec(address: Address) -> Device:
    from sensors.drivers.orbbec import Orbbec

    address.finish()
    return Orbbec(address.target)


def _open_optris(address: Address) -> Device:
    layout = address.choice("mode", LAYOUTS, "128hz")
    address.finish()
    node = _target(address, "/dev/video0")
    return Optris(node, layout, OpenCvVideo(node, layout), _usb_serial(node))


def _open_direct(address: Address) -> Device:
    emissivity = address.given_number("emissivity", 0.1, 1.1)
    address.finish()
    device = OptrisDirect(_target(address, "/path/to/generic.xml"))
    if emissivity is not None:
        device.set_emissivity(emissivity)
    return device


def _open_serial(address: Address) -> Device:
    return open_pyrometer(address, _target(address, "/dev/ttyUSB0"))


OPENERS: Mapping[str, Callable[[Address], Device]] = {
    "kinect2": _open_kinect2,
    "azure": _open_azure,
    "orbbec": _open_orbbec,
    "optris": _open_optris,
    "optris-direct": _open_direct,
    "pyrometer": _open_serial,
}
"""Every kind of real device, and what opens it."""


def _target(address: Address, example: str) -> Path:
    if not address.target:
        raise DeviceError(
            f"device {address.text!r} names no node; give for instance {address.kind}:{example}"
        )
    return Path(address.target)


def _usb_serial(node: Path) -> str:
    return next((serial for found, serial in video_nodes(USB_ID) if found == node), "")


def _find_kinect2() -> list[Found]:
    try:
        return _numbered("kinect2", kinect2_serials(load_shim()))
    except DeviceNotFoundError:
        return []


def _find_azure() -> list[Found]:
    from sensors.drivers.azure_kinect import azure_devices

    return _numbered("azure", [serial for _, serial in azure_devices()])


def _find_orbbec() -> list[Found]:
    from sensors.drivers.orbbec import orbbec_serials

    return _numbered("orbbec", orbbec_serials())


def _find_optris() -> list[Found]:
    return [
        Found(f"optris:{node}", "optris", serial, note=_access(node)) for node, serial in video_nodes(USB_ID)
    ]


def _find_serial_ports() -> list[Found]:
    remark = "a serial port; only opening it shows whether a pyrometer answers"
    ports = sorted(comports(), key=lambda port: str(port.device))
    return [
        Found(
            f"pyrometer:{port.device}",
            "pyrometer",
            port.serial_number or "",
            note=_access(Path(port.device)) or remark,
        )
        for port in ports
    ]


def _numbered(kind: str, serials: list[str]) -> list[Found]:
    """Devices by serial number, with a note on two of one number."""
    twice = "another one has the same serial number; unplug one of them"
    return [
        Found(f"{kind}:{serial}", kind, serial, note=twice if serials.count(serial) > 1 else "")
        for serial in serials
    ]


def _access(node: Path) -> str:
    """What keeps this user from the node, without opening it."""
    return "" if os.access(node, os.R_OK | os.W_OK) else str(node_error(node, errno.EACCES))
