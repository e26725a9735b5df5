"""Raw frames of a V4L2 device: what every transport gives, and the built-in one, OpenCV's."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.device.node import check_node
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError, DeviceLostError

TRANSPORTS = {"opencv": "opencv", "linuxpy": "linuxpy"}
"""How a node can be read; the first is built in."""
BUFFERS = 10
"""OpenCV's most; 78 ms at 128 Hz."""
SLICE_S = 0.05
"""Waiting is cut into pieces this long, so that another thread can close the device in between."""


@dataclass(frozen=True)
class VideoFrame:
    """words: uint16 (height, width). stamp_ns and number: the kernel's time stamp and count, if it tells."""

    words: NDArray[np.uint16]
    stamp_ns: int
    arrival_ns: int
    number: int | None


class Video(Protocol):
    """A streaming V4L2 device of one frame size."""

    def start(self) -> None:
        """Begin to stream."""
        ...

    def read(self, timeout_s: float) -> VideoFrame | None:
        """Next frame, None after ``timeout_s``.

        Raises DeviceLostError, or DeviceFaultError for a short buffer.
        """
        ...

    def close(self) -> None:
        """Give the device back; idempotent, from any thread."""
        ...


class Capture(Protocol):
    """What is used of a ``cv2.VideoCapture``."""

    def isOpened(self) -> bool: ...  # noqa: N802
    def set(self, propId: int, value: float) -> bool: ...  # noqa: N803
    def get(self, propId: int) -> float: ...  # noqa: N803
    def retrieve(self) -> tuple[bool, Any]: ...
    def release(self) -> None: ...


class CaptureKind(Protocol):
    """What is used of the class ``cv2.VideoCapture`` itself: the seam where a fake kernel goes in."""

    def __call__(self, filename: str, apiPreference: int) -> Capture: ...  # noqa: N803
    def waitAny(self, streams: Sequence[Any], timeoutNs: int) -> tuple[bool, Any]: ...  # noqa: N802, N803


OPENCV = cast(CaptureKind, cv2.VideoCapture)


class OpenCvVideo:
    """OpenCV's V4L2 backend with its conversions off. It tells no running number; stamps show the gaps.

    Raises DeviceError where the node cannot be opened, or does not offer the size.
    """

    def __init__(self, node: Path, width: int, height: int, hz: float, kind: CaptureKind = OPENCV) -> None:
        check_node(node)
        self._node, self._shape, self._kind = node, (height, width), kind
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._capture = kind(str(node), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise DeviceBusyError(f"{node} does not stream; close the program that uses it")
        self._configure(width, height, hz)

    def start(self) -> None:
        """OpenCV streams from opening on."""

    def read(self, timeout_s: float) -> VideoFrame | None:
        """Next frame; see ``Video.read``."""
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
        """See ``Video.close``."""
        if self._closed.is_set():
            return
        # Before the lock, which whoever reads would take again and again.
        self._closed.set()
        with self._lock:
            self._capture.release()

    def _configure(self, width: int, height: int, hz: float) -> None:
        wanted = (
            (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV")),
            (cv2.CAP_PROP_FRAME_WIDTH, width),
            (cv2.CAP_PROP_FRAME_HEIGHT, height),
            (cv2.CAP_PROP_FPS, hz),
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
                f"{self._node} gives {got[0]}x{got[1]} where {width}x{height} was asked for; choose its mode"
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
                "use a USB port of its own, should it recur"
            )
        words = np.ascontiguousarray(image, np.uint8).reshape(height, 2 * width).view("<u2")
        return VideoFrame(words, round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6), arrival_ns, None)

    def _lost(self) -> DeviceLostError:
        return DeviceLostError(f"{self._node} is gone; plug the camera in again and start anew")
