"""Device nodes of the system: why one cannot be opened, in one line with the remedy."""

import errno
import grp
import os
from pathlib import Path

from sensors.errors import DeviceAccessError, DeviceBusyError, DeviceError, DeviceNotFoundError


def check_node(path: Path) -> None:
    """Raise what keeps this user from reading and writing the device node ``path``, if anything does."""
    try:
        os.close(os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC))
    except OSError as error:
        raise node_error(path, error.errno) from error


def node_error(path: Path, code: int | None) -> DeviceError:
    """The error of a device node, with the remedy, for the system's ``errno``."""
    if code in (errno.EACCES, errno.EPERM):
        group = _group(path)
        if group == "root":
            return DeviceAccessError(
                f"{path} belongs to root alone; install the device's udev rule, then plug it in again"
            )
        return DeviceAccessError(
            f"{path} belongs to group {group} and you are not a member; "
            f"run: sudo usermod -aG {group} $USER, then log in again"
        )
    if code in (errno.EBUSY, errno.EAGAIN):
        return DeviceBusyError(f"{path} is in use by another program; close that program")
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.ENOTDIR):
        return DeviceNotFoundError(
            f"{path} does not exist; plug the device in, or see: annotate-cloud devices"
        )
    why = os.strerror(code) if code else "unknown error"
    return DeviceError(f"{path} cannot be opened ({why}); give a device node such as those in /dev")


def _group(path: Path) -> str:
    """The group that owns the node; by name if it has one, else the group that Debian gives its kind."""
    try:
        return grp.getgrgid(path.stat().st_gid).gr_name
    except (OSError, KeyError):
        return "video" if "video" in path.name else "dialout"
