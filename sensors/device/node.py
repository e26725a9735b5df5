"""Device nodes of the system, and the errors on opening one."""

import errno
import grp
import os
from pathlib import Path

from sensors.errors import DeviceAccessError, DeviceBusyError, DeviceError, DeviceNotFoundError

SYSFS, VIDEO = Path("/sys/bus/usb/devices"), Path("/sys/class/video4linux")


def check_usb(ids: tuple[str, ...], sysfs: Path = SYSFS) -> None:
    """Raise DeviceAccessError if a USB device is plugged in but the user may not open it.

    ids: ``vendor:product`` in lower-case hexadecimal. libusb opens a node under /dev/bus/usb.
    """
    for entry in sorted(sysfs.glob("*")):
        if _usb_id(entry) in ids:
            bus, device = (_text(entry / name) for name in ("busnum", "devnum"))
            check_node(Path(f"/dev/bus/usb/{bus:0>3}/{device:0>3}"))


def video_nodes(usb_id: str, sysfs: Path = VIDEO) -> list[tuple[Path, str]]:
    """Return the image nodes and serial numbers of the USB cameras with this id."""
    found = []
    for entry in sorted(sysfs.glob("video*")):
        # "device" is the USB interface below the camera; index 0 has images, 1 metadata.
        camera = (entry / "device").resolve().parent
        if _usb_id(camera) == usb_id and _text(entry / "index") in ("", "0"):
            found.append((Path("/dev") / entry.name, _text(camera / "serial")))
    return found


def check_node(path: Path) -> None:
    """Raise DeviceError if this user cannot read and write the device node."""
    try:
        os.close(os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC))
    except OSError as error:
        raise node_error(path, error.errno) from error


def node_error(path: Path, code: int | None) -> DeviceError:
    """Return the error, with its remedy, for the system's ``errno`` on a device node."""
    if code in (errno.EACCES, errno.EPERM):
        group = _group(path)
        if group == "root":
            return DeviceAccessError(f"{path} belongs to root; install the device's udev rule")
        return DeviceAccessError(
            f"{path} belongs to group {group} and you are not a member; "
            f"run: sudo usermod -aG {group} $USER, then log in again"
        )
    if code in (errno.EBUSY, errno.EAGAIN):
        return DeviceBusyError(f"{path} is in use by another program; close that program")
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.ENOTDIR):
        return DeviceNotFoundError(f"{path} does not exist; plug the device in; see: annotate-cloud devices")
    why = os.strerror(code) if code else "unknown error"
    return DeviceError(f"{path} cannot be opened ({why}); give a device node such as those in /dev")


def _group(path: Path) -> str:
    """Return the owner group of a node, or the group that Debian gives this kind of node."""
    try:
        return grp.getgrgid(path.stat().st_gid).gr_name
    except (OSError, KeyError):
        return "video" if "video" in path.name else "dialout"


def _usb_id(device: Path) -> str:
    return f"{_text(device / 'idVendor')}:{_text(device / 'idProduct')}"


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""
