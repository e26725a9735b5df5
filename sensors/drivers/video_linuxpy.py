"""V4L2 through linuxpy (extra ``v4l2``, GPL): as OpenCV's, but with the kernel's frame numbers."""

import threading
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from sensors.device.node import check_node, node_error
from sensors.drivers.video import SLICE_S, VideoFrame
from sensors.errors import DeviceError, DeviceFaultError, DeviceLostError, DeviceNotFoundError

BUFFERS = 32
"""A quarter of a second at 128 Hz: what a stalled host may take."""
Io = Any
"""Where linuxpy takes ``open`` and ``select`` from; its own unless a fake kernel's is given."""


def need_linuxpy() -> None:
    """Raise DeviceNotFoundError where the extra is not installed."""
    if find_spec("linuxpy") is None:
        raise DeviceNotFoundError(
            "linuxpy is not installed; install annotate-cloud[v4l2], or leave transport=linuxpy out"
        )


class LinuxpyVideo:
    """A V4L2 node as a ``Video`` of ``width`` x ``height`` words. Raises DeviceError."""

    def __init__(self, node: Path, width: int, height: int, hz: float, io: Io = None) -> None:
        need_linuxpy()
        from linuxpy.io import IO
        from linuxpy.video.device import Device, V4L2Error, VideoCapture

        check_node(node)
        self._node, self._shape = node, (height, width)
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._device = Device(node, io=io or IO)
        self._capture = VideoCapture(self._device, size=BUFFERS)
        try:
            self._device.open()
            self._capture.set_format(width, height, "YUYV")
            self._capture.set_fps(hz)
            got = self._capture.get_format()
        except (OSError, V4L2Error) as error:
            self.close()
            raise node_error(node, getattr(error, "errno", None)) from error
        if (got.width, got.height) != (width, height):
            self.close()
            raise DeviceError(
                f"{node} gives {got.width}x{got.height} where {width}x{height} was asked for; choose its mode"
            )

    def start(self) -> None:
        """Queue the buffers and begin to stream."""
        try:
            self._capture.open()
        except OSError as error:
            raise node_error(self._node, error.errno) from error

    def read(self, timeout_s: float) -> VideoFrame | None:
        """Next frame; see ``Video.read``."""
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = end_s - time.monotonic()
            with self._lock:
                if self._closed.is_set():
                    raise DeviceLostError(f"{self._node} is closed; open it again")
                frame = self._wait(max(0.0, min(left_s, SLICE_S)))
            if frame is not None:
                return frame
            if left_s <= SLICE_S:
                return None

    def close(self) -> None:
        """See ``Video.close``."""
        if self._closed.is_set():
            return
        self._closed.set()
        # Of a camera that was unplugged nothing can be switched off.
        with self._lock:
            with suppress(OSError):
                self._capture.close()
            with suppress(OSError):
                self._device.close()

    def _wait(self, timeout_s: float) -> VideoFrame | None:
        try:
            frame = self._capture.buffer.frame_reader.read(timeout_s)
        except OSError as error:
            raise DeviceLostError(f"{self._node} is gone; plug the camera in again and start anew") from error
        if frame is None:
            return None
        arrival_ns = time.monotonic_ns()
        height, width = self._shape
        if frame.nbytes != 2 * height * width:
            raise DeviceFaultError(
                f"{self._node} sent {frame.nbytes} of {2 * height * width} bytes; "
                "use a USB port of its own, should it recur"
            )
        words = np.frombuffer(frame.data, "<u2").reshape(height, width)
        stamp = frame.buff.timestamp
        return VideoFrame(words, stamp.secs * 10**9 + stamp.usecs * 1000, arrival_ns, frame.frame_nb)
