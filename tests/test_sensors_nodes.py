"""Device nodes that do not open give the remedy; nodes of cameras are found."""

import errno
import os
from pathlib import Path

import pytest

from sensors.device import node
from sensors.drivers import kinect2
from sensors.errors import (
    DeviceAccessError,
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
)


@pytest.mark.parametrize(
    ("code", "kind", "match"),
    [
        (errno.EACCES, DeviceAccessError, r"belongs to group \w+ and you are not a member|udev rule"),
        (errno.EBUSY, DeviceBusyError, "in use by another program; close"),
        (errno.ENODEV, DeviceNotFoundError, "does not exist; plug"),
        (errno.EIO, DeviceError, r"cannot be opened \(Input/output error\); give a device node"),
    ],
)
def test_errors_of_the_system_give_the_remedy(monkeypatch, tmp_path, code, kind, match):
    def refuse(*arguments, **options):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(node.os, "open", refuse)
    with pytest.raises(kind, match=match):
        node.check_node(tmp_path / "video0")


def test_without_permission_the_group_is_named(monkeypatch):
    """The node's own group; a node unknown to the system has the group that Debian gives its kind."""
    for name, group in (("video3", "video"), ("ttyUSB0", "dialout")):
        text = str(node.node_error(Path("/nowhere") / name, errno.EACCES))
        assert f"belongs to group {group}" in text and f"usermod -aG {group} $USER" in text
    monkeypatch.setattr(node, "_group", lambda path: "root")
    assert "udev rule" in str(node.node_error(Path("/nowhere"), errno.EACCES))


def test_a_kinect_that_may_not_be_opened_differs_from_none(monkeypatch, tmp_path):
    """libfreenect2 lists only devices that it can open; the system lists all USB devices."""
    entry = tmp_path / "2-1"
    entry.mkdir()
    for name, text in (("idVendor", "045e"), ("idProduct", "02c4"), ("busnum", "2"), ("devnum", "5")):
        (entry / name).write_text(text + "\n")
    monkeypatch.setattr(node.os, "open", lambda path, flags: (_ for _ in ()).throw(OSError(errno.EACCES, "")))
    node.check_usb(("0403:de37",), tmp_path)
    with pytest.raises(DeviceAccessError, match="/dev/bus/usb/002/005"):
        node.check_usb(kinect2.USB_IDS, tmp_path)


def test_video_nodes_of_a_camera_are_found_without_its_metadata_node(tmp_path):
    camera = tmp_path / "usb" / "1-2"
    (camera / "1-2:1.0").mkdir(parents=True)
    for name, text in (("idVendor", "0403"), ("idProduct", "de37"), ("serial", "77")):
        (camera / name).write_text(text)
    for index, name in enumerate(("video0", "video1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "device").symlink_to(camera / "1-2:1.0")
        (tmp_path / name / "index").write_text(str(index))
    assert node.video_nodes("0403:de37", tmp_path) == [(Path("/dev/video0"), "77")]
