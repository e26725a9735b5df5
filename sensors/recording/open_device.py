"""All devices by address: the list of those present, and opening one, real or virtual.

To add a camera, derive a driver from ``StreamingCamera`` (example: ``azure_kinect``), or from ``V4l2Camera``
(``lepton``, also in ``VIDEO_IDS``). Then add it to ``OPENERS`` and ``find_devices`` here, to
``sensors.device.address.KINDS`` and to the tables of ``docs/devices.md``. A twin is optional; it goes into
``VIRTUAL`` here and ``sensors.virtual.twins.TWINS``. A new extra goes into ``pyproject.toml``, ``Makefile``,
``cli.extras.COSTS`` and ``docs/install.md``.
"""

import errno
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from serial.tools.list_ports import comports

from sensors.device.address import Address
from sensors.device.mounting import NO_YES, Mounted, Mounting, mounting_of
from sensors.device.node import node_error, video_nodes
from sensors.device.protocol import Device, Found
from sensors.device.v4l2_camera import V4l2Node
from sensors.drivers import lepton, optris, y16
from sensors.drivers.azure_kinect import CLOSED, AzureKinect, azure_devices
from sensors.drivers.kinect2 import Kinect2, kinect2_serials, load_shim
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.orbbec import Orbbec, orbbec_serials
from sensors.drivers.pyrometer import Pyrometer, pyrometer_options
from sensors.drivers.realsense import PRESETS, RATES, SIZES, RealSense, Settings, realsense_serials
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
VIDEO_IDS = {"optris": optris.USB_ID, "lepton": lepton.USB_ID, "boson": y16.BOSON_USB_ID}


def open_device(address: str, frames: Iterable[RigFrame] = ()) -> Device:
    """Open the device at ``address`` (see ``docs/devices.md``). Raises DeviceError for a wrong address or a
    device that does not open.

    frames: scene of a virtual camera, repeated after a second at most.
    """
    parsed = Address(address)
    check_kind(parsed)
    mounting = Mounting() if parsed.kind == "pyrometer" else mounting_of(parsed)
    device = open_twin(parsed, frames) if parsed.virtual else OPENERS[parsed.kind](parsed)
    return device if mounting == Mounting() else Mounted(address, device, mounting)


def check_kind(address: Address) -> None:
    """Raise DeviceError for an address of an unknown kind."""
    if address.virtual and address.kind not in TWINS:
        names = ", ".join(f"virtual:{kind}" for kind in TWINS)
        raise DeviceError(f"virtual device {address.text!r} does not exist; use {names}")
    if not address.virtual and address.kind not in OPENERS:
        raise DeviceError(
            f"{address.text!r} is of an unknown kind; use {', '.join(OPENERS)}, or virtual:KIND"
        )


def find_devices() -> list[Found]:
    """Return the connected devices, then the virtual ones.

    The libraries of Kinects, RealSense and Orbbec cameras open each camera briefly to read its number.
    Nothing is sent to thermal cameras and serial ports.
    """
    return [
        *_numbered("kinect2", _kinect2_serials()),
        *_numbered("realsense", realsense_serials()),
        *_numbered("azure", [serial for _, serial in azure_devices()], CLOSED),
        *_numbered("orbbec", orbbec_serials()),
        *(
            Found(f"{kind}:{node}", kind, serial, note=_access(node))
            for kind, usb_id in VIDEO_IDS.items()
            for node, serial in video_nodes(usb_id)
        ),
        *_serial_ports(),
        *(Found(address, Address(address).kind, virtual=True) for address in VIRTUAL),
    ]


def _opener_by_serial(camera: Callable[[str], Device]) -> Callable[[Address], Device]:
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


def _open_optris(address: Address) -> Device:
    layout = address.choice("mode", optris.LAYOUTS, "128hz")
    return optris.Optris(_node(address), layout)


def _open_boson(address: Address) -> Device:
    celsius = address.choice("celsius", NO_YES, "no")
    mode = y16.boson_mode(celsius, address.number("rate", y16.BOSON_HZ, 1.0, 200.0))
    return y16.WordCamera(_node(address), mode)


def _open_y16(address: Address) -> Device:
    width, height = (address.given_integer(side, 1, MAX_IMAGE_SIDE) for side in ("width", "height"))
    rate_hz = address.number("rate", lepton.RATE_HZ, 1.0, 200.0)
    mode = y16.y16_mode((width or 160, height or 120), rate_hz, y16.radiometry_of(address))
    return y16.WordCamera(_node(address), mode)


def _open_pyrometer(address: Address) -> Device:
    options = pyrometer_options(address)
    return Pyrometer(_target(address, "/dev/ttyUSB0"), options)


OPENERS: Mapping[str, Callable[[Address], Device]] = {
    "kinect2": _opener_by_serial(Kinect2),
    "realsense": _open_realsense,
    "azure": _opener_by_serial(AzureKinect),
    "orbbec": _opener_by_serial(Orbbec),
    "optris": _open_optris,
    "optris-direct": _open_direct,
    "lepton": lambda address: lepton.Lepton(_node(address)),
    "boson": _open_boson,
    "y16": _open_y16,
    "pyrometer": _open_pyrometer,
}


def _node(address: Address) -> V4l2Node:
    """Return the V4L2 device node that the address of a thermal camera names.

    Read all options of the address before: a given option that was not read raises DeviceError, as does a
    missing node.
    """
    address.finish()
    path, usb_id = _target(address, "/dev/video0"), VIDEO_IDS.get(address.kind)
    return V4l2Node(path, dict(video_nodes(usb_id)).get(path, "") if usb_id else "")


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
    note = "a serial port; only opening it shows whether a pyrometer answers"
    ports = sorted((str(port.device), port.serial_number or "") for port in comports())
    return [Found(f"pyrometer:{at}", "pyrometer", one, note=_access(at) or note) for at, one in ports]


def _numbered(kind: str, serials: list[str], closed: str = "") -> list[Found]:
    """Return devices by serial number; devices with equal numbers get a note.

    closed: note for a device without a serial number.
    """
    twice = "another one has the same serial number; unplug one of them"
    notes = [closed if not serial else twice if serials.count(serial) > 1 else "" for serial in serials]
    return [Found(f"{kind}:{one}", kind, one, note=note) for one, note in zip(serials, notes, strict=True)]


def _access(node: Path | str) -> str:
    """Return the reason why this user may not open the node, or "". The node is not opened."""
    return "" if os.access(node, os.R_OK | os.W_OK) else str(node_error(Path(node), errno.EACCES))
