"""The fake kernel below linuxpy: the system calls of one virtual Optris' node, and no others.

Only what linuxpy calls is replaced (open, select, ioctl, mmap); its own code runs as on a real kernel.
"""

import errno
import mmap
from collections.abc import Callable
from io import IOBase
from types import SimpleNamespace
from typing import Any

from linuxpy.io import IO
from linuxpy.video import device as linuxpy_device
from linuxpy.video import raw

from sensors.virtual.optris import VirtualOptris
from sensors.virtual.schedule import UnpluggedError

_nodes: dict[int, tuple[IOBase, "FakeNode"]] = {}
"""File descriptors that belong to a fake kernel while their file is open; all others go to the real one."""
Struct = Any
"""One of linuxpy's V4L2 structures."""


class FakeIo:
    """What linuxpy calls its ``io``: opens the twin's node, and waits for the twin's frames."""

    def __init__(self, camera: VirtualOptris) -> None:
        self._camera = camera
        self.select = SimpleNamespace(select=self._select)
        self.os = IO.os
        _install()

    def open(self, path: object, read_write: bool, blocking: bool = False) -> Any:  # noqa: ANN401
        """A real file descriptor of the node's empty file, answered for by the twin."""
        if self._camera.in_use:
            raise OSError(errno.EBUSY, "Device or resource busy")
        self._camera.in_use = True
        file = IO.open(path, read_write, blocking=blocking)
        _nodes[file.fileno()] = file, FakeNode(self._camera)
        return file

    def _select(self, readers: Any, writers: Any, errors: Any, timeout: float) -> Any:  # noqa: ANN401
        node = _node(readers[0])
        if node is None:
            raise OSError(errno.EBADF, "Bad file descriptor")
        return (list(readers) if node.wait(timeout) else []), [], []


class FakeNode:
    """The kernel's side of an open node: formats, buffers, and the frame that is due."""

    def __init__(self, camera: VirtualOptris) -> None:
        self._camera, self._size = camera, 2 * camera.layout.width * camera.layout.height
        self._page = -(-self._size // mmap.PAGESIZE) * mmap.PAGESIZE
        self._maps: dict[int, mmap.mmap] = {}
        self._queued: list[int] = []
        self._due: int | None = None
        self._gone = False

    def wait(self, timeout_s: float) -> bool:
        """Whether a frame is due, or the device has gone, which DQBUF then says."""
        if self._due is None and not self._gone:
            try:
                self._due = self._camera.schedule.wait(timeout_s)
            except UnpluggedError:
                self._gone = True
                self._camera.unplug()
        return self._gone or self._due is not None

    def map(self, offset: int, length: int) -> mmap.mmap:
        """The memory of the buffer at ``offset``."""
        return self._maps.setdefault(offset // self._page, mmap.mmap(-1, length))

    def call(self, name: str, data: Struct) -> None:
        """Carry out one ioctl. Raises OSError as the kernel does."""
        answer: Callable[[Struct], None] | None = getattr(self, f"_{name.lower()}", None)
        if answer is None:
            raise OSError(errno.EINVAL, "Invalid argument")
        answer(data)

    def _querycap(self, data: Struct) -> None:
        data.driver, data.card = b"uvcvideo", b"PI IMAGER"
        capability = linuxpy_device.Capability
        data.capabilities = data.device_caps = capability.VIDEO_CAPTURE | capability.STREAMING

    def _s_fmt(self, data: Struct) -> None:
        pix = data.fmt.pix
        pix.width, pix.height = self._camera.layout.width, self._camera.layout.height
        pix.pixelformat = raw.v4l2_fourcc(*"YUYV")
        pix.bytesperline, pix.sizeimage = 2 * pix.width, self._size

    _g_fmt = _s_fmt

    def _s_parm(self, data: Struct) -> None:
        """Take any rate."""

    def _reqbufs(self, data: Struct) -> None:
        self._queued.clear()
        self._camera.schedule.queue = data.count

    def _querybuf(self, data: Struct) -> None:
        data.length, data.m.offset = self._size, data.index * self._page

    def _qbuf(self, data: Struct) -> None:
        self._queued.append(data.index)

    def _dqbuf(self, data: Struct) -> None:
        if self._gone:
            raise OSError(errno.ENODEV, "No such device")
        if self._due is None or not self._queued:
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")
        number, self._due = self._due, None
        frame = self._camera.uvc_frame(number).tobytes()
        data.index, data.sequence = self._queued.pop(0), number
        data.bytesused = self._size // 3 if self._camera.schedule.is_short() else self._size
        self._maps[data.index][: self._size] = frame
        seconds = self._camera.schedule.device_s(number)
        data.timestamp.secs, data.timestamp.usecs = int(seconds), int(seconds % 1 * 1e6)

    def _streamon(self, data: Struct) -> None:
        self._camera.schedule.start()

    def _streamoff(self, data: Struct) -> None:
        self._camera.in_use = False


def _node(fd: Struct) -> FakeNode | None:
    """The fake kernel's node behind a descriptor; the number may be in use anew once its file is closed."""
    file, node = _nodes.get(linuxpy_device.to_fd(fd), (None, None))
    return node if file is not None and not file.closed else None


def _install() -> None:
    """Let the fake kernel see linuxpy's calls first; once."""
    if getattr(linuxpy_device.ioctl, "for_virtual_nodes", False):
        return
    real_ioctl, real_map = linuxpy_device.ioctl, linuxpy_device.mem_map

    def ioctl(fd: Struct, request: Struct, *data: Struct) -> Struct:
        node = _node(fd)
        if node is None:
            return real_ioctl(fd, request, *data)
        node.call(request.name, data[0])
        return data[0]

    def mem_map(fd: Struct, length: int, offset: int) -> Struct:
        node = _node(fd)
        return real_map(fd, length, offset) if node is None else node.map(offset, length)

    ioctl.for_virtual_nodes = True  # type: ignore[attr-defined]
    linuxpy_device.ioctl, linuxpy_device.mem_map = ioctl, mem_map
