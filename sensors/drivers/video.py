"""Raw frames of a V4L2 device, through OpenCV."""

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.device.node import check_node
from sensors.drivers.optris_layout import Layout
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError, DeviceLostError

BUFFERS = 10
"""Frames the kernel keeps; OpenCV allows no more. 78 ms at 128 Hz."""
SLICE_S = 0.05
"""Seconds a wait lasts at most before another thread may close the device. Chosen by eye."""


@dataclass(frozen=True)
class VideoFrame:
    """words: uint16 (height, width), the frame's. stamp_ns: the kernel's time. arrival_ns: the host's."""

    words: NDArray[np.uint16]
    stamp_ns: int
    arrival_ns: int


CaptureKind = Any
"""The class ``cv2.VideoCapture``, or what a fake kernel has in its place."""


class OpenCvVideo:
    """An Optris camera's V4L2 node: OpenCV's backend with its conversions off.

    OpenCV gives no running number of a frame; the gaps between stamps show what was lost.
    layout: the frame's size and rate. Raises DeviceError for a node that does not open or has another size.
    """

    def __init__(self, node: Path, layout: Layout, kind: CaptureKind = cv2.VideoCapture) -> None:
        check_node(node)
        self._node, self._shape, self._kind = node, (layout.height, layout.width), kind
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._capture = kind(str(node), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise DeviceBusyError(f"{node} does not stream; close the program that uses it")
        self._configure(layout)

    def read(self, timeout_s: float) -> VideoFrame | None:
        """Next frame, None after ``timeout_s``. Raises DeviceLostError, DeviceFaultError."""
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = end_s - time.monotonic()
            with self._lock:
                if self._closed.is_set():
                    raise DeviceLostError(f"{self._node} is closed; open it again")
                if self._wait(min(left_s, SLICE_S)):
                    return self._retrieve()
            if left_s <= SLICE_S:
                return None

    def close(self) -> None:
        """Give the device back; idempotent, from any thread."""
        if self._closed.is_set():
            return
        # Before the lock, which the reading thread takes again and again.
        self._closed.set()
        with self._lock:
            self._capture.release()

    def _configure(self, layout: Layout) -> None:
        width, height = layout.width, layout.height
        wanted = (
            (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV")),
            (cv2.CAP_PROP_FRAME_WIDTH, width),
            (cv2.CAP_PROP_FRAME_HEIGHT, height),
            (cv2.CAP_PROP_FPS, layout.uvc_hz),
            (cv2.CAP_PROP_CONVERT_RGB, 0),
            (cv2.CAP_PROP_BUFFERSIZE, BUFFERS),
        )
        for name, value in wanted:
            self._capture.set(name, value)
        got = tuple(
            int(self._capture.get(name)) for name in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        if got != (width, height):
            self._capture.release()
            raise DeviceError(
                f"{self._node} gives {got[0]}x{got[1]} instead of {width}x{height}; choose its mode"
            )

    def _wait(self, timeout_s: float) -> bool:
        try:
            # 0 would mean for ever.
            ready, _ = self._kind.waitAny([self._capture], max(1, int(timeout_s * 1e9)))
        except cv2.error as error:
            raise self._lost() from error
        if not ready and not self._node.exists():
            raise self._lost()
        return bool(ready)

    def _retrieve(self) -> VideoFrame:
        arrival_ns = time.monotonic_ns()
        good, image = self._capture.retrieve()
        size = image.size if good and image is not None else 0
        height, width = self._shape
        if size != 2 * height * width:
            if not self._node.exists():
                raise self._lost()
            raise DeviceFaultError(
                f"{self._node} sent {size} of {2 * height * width} bytes; "
                "if this happens again, use a USB port of its own"
            )
        words = np.ascontiguousarray(image, np.uint8).reshape(height, 2 * width).view("<u2")
        return VideoFrame(words, round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6), arrival_ns)

    def _lost(self) -> DeviceLostError:
        return DeviceLostError(
            f"{self._node} is no longer connected; plug the camera in again and start again"
        )
