"""USB devices as Linux lists them: a device that is absent differs from one that may not be opened."""

from dataclasses import dataclass
from pathlib import Path

from sensors.device.node import check_node

SYSFS, VIDEO = Path("/sys/bus/usb/devices"), Path("/sys/class/video4linux")


@dataclass(frozen=True)
class UsbDevice:
    """node: the file under /dev/bus/usb through which libusb opens it. serial: empty where it has none."""

    node: Path
    serial: str


def usb_devices(ids: tuple[str, ...], sysfs: Path = SYSFS) -> list[UsbDevice]:
    """Plugged-in devices with one of the ``vendor:product`` ids, hexadecimal in lower case."""
    found = []
    for entry in sorted(sysfs.glob("*")) if sysfs.is_dir() else []:
        if f"{_read(entry / 'idVendor')}:{_read(entry / 'idProduct')}" in ids:
            bus, device = (_read(entry / name) for name in ("busnum", "devnum"))
            node = Path(f"/dev/bus/usb/{bus:0>3}/{device:0>3}")
            found.append(UsbDevice(node, _read(entry / "serial")))
    return found


def check_usb(ids: tuple[str, ...], sysfs: Path = SYSFS) -> None:
    """Raise DeviceAccessError where such a device is plugged in but may not be opened."""
    for device in usb_devices(ids, sysfs):
        check_node(device.node)


def video_nodes(usb_id: str, sysfs: Path = VIDEO) -> list[tuple[Path, str]]:
    """Nodes that stream images of USB cameras with this id, and the cameras' serial numbers."""
    found = []
    for entry in sorted(sysfs.glob("video*")) if sysfs.is_dir() else []:
        # "device" is the USB interface, the camera itself is above it; index 0 are images, 1 is metadata.
        camera = (entry / "device").resolve().parent
        its_id = f"{_read(camera / 'idVendor')}:{_read(camera / 'idProduct')}"
        if its_id == usb_id and _read(entry / "index") in ("", "0"):
            found.append((Path("/dev") / entry.name, _read(camera / "serial")))
    return found


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""
