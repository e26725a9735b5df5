"""Base class of cameras with 16-bit pixels (words), through OpenCV's V4L2 backend without conversion."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.device.node import check_node
from sensors.device.protocol import ThermalImage
from sensors.device.streaming_camera import StreamingCamera
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError, DeviceLostError

BUFFERS = 10  # frames kept by the kernel; OpenCV's maximum
CaptureKind = Any  # the class ``cv2.VideoCapture``, or a fake kernel


@dataclass(frozen=True)
class V4l2Node:
    """Device node of a camera. serial: "" if unknown.

    kind: class that captures, ``cv2.VideoCapture`` or its software twin.
    """

    path: Path
    serial: str = ""
    kind: CaptureKind = cv2.VideoCapture


class V4l2Camera(StreamingCamera):
    """A thermal camera at a node, with ``rate_hz`` images a second.

    Raises DeviceError if it does not open.
    """

    silence_s = inf  # the node of an unplugged camera vanishes

    def __init__(self, address: str, node: V4l2Node, rate_hz: float) -> None:
        check_node(node.path)
        super().__init__(address, node.serial, {ThermalImage.stream: rate_hz})
        self._node, self._kind, self._size = node.path, node.kind, (0, 0)
        self._capture = node.kind(str(node.path), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise DeviceBusyError(f"{node.path} does not stream; close the program that uses it")

    @abstractmethod
    def _take_frame(self) -> None:
        """Queue the images of the grabbed frame. Raises DeviceError for a faulty frame."""

    def _configure(self, fourcc: str, sizes: Sequence[tuple[int, int]], fps: float, remedy: str) -> None:
        """Set the pixel format and the first size (width, height), in words, that the camera supports.

        Raises DeviceError with the remedy for a camera without any of the sizes.
        """
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*fourcc))
        self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        sides = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT
        for size in sizes:
            for side, value in zip(sides, size, strict=True):
                self._capture.set(side, value)
            self._size = int(self._capture.get(sides[0])), int(self._capture.get(sides[1]))
            if self._size == size:
                break
        else:
            self._capture.release()
            wanted = " or ".join(f"{width}x{height}" for width, height in sizes)
            held = "x".join(map(str, self._size))
            raise DeviceError(f"{self._node} sends images of {held} pixels, not {wanted}; {remedy}")
        self._capture.set(cv2.CAP_PROP_FPS, fps)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, BUFFERS)

    def _begin(self) -> None:
        """Do nothing: OpenCV streams from opening on."""

    def _end(self) -> None:
        self._capture.release()

    def _receive(self, timeout_s: float) -> None:
        try:
            # A timeout of 0 would never end.
            ready, _ = self._kind.waitAny([self._capture], max(1, int(timeout_s * 1e9)))
        except cv2.error as error:
            raise self._lost() from error
        if ready:
            self._take_frame()
        elif not self._node.exists():
            raise self._lost()

    def _stamp_ns(self) -> int:
        """Return the kernel's time of the grabbed frame."""
        return round(1e6 * float(self._capture.get(cv2.CAP_PROP_POS_MSEC)))

    def _words(self) -> NDArray[np.uint16]:
        """Return the grabbed frame, uint16 (height, width). Raises DeviceFaultError for a short one."""
        good, image = self._capture.retrieve()
        count = image.nbytes if good and image is not None else 0
        width, height = self._size
        if count != 2 * height * width:
            if not self._node.exists():
                raise self._lost()
            raise DeviceFaultError(
                f"{self._node} sent {count} of {2 * height * width} bytes; "
                "if this happens again, use a USB port of its own"
            )
        return np.ascontiguousarray(image).view("<u2").reshape(height, width)

    def _lost(self) -> DeviceLostError:
        return DeviceLostError(f"{self._node} is no longer connected; plug the camera in again")
