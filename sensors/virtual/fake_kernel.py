"""A fake kernel with one camera behind a real node: what OpenCV's V4L2 backend would show of it."""

import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.virtual.schedule import Schedule, UnpluggedError


class FakeCamera(ABC):
    """A camera and its node, an empty file that vanishes with it, named by ``kind``.

    size: (width, height) of a frame in words.
    The kernel's clock counts seconds since the start here. One reader at a time.
    """

    kind: ClassVar[str]

    def __init__(self, size: tuple[int, int], schedule: Schedule) -> None:
        self.size, self.schedule, self.in_use = size, schedule, False
        handle, node = tempfile.mkstemp(prefix=f"virtual-{self.kind}-")
        os.close(handle)
        self.node = Path(node)

    @abstractmethod
    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """Frame ``number`` as words (height, width)."""

    def unplug(self) -> None:
        """Vanish; idempotent."""
        self.schedule.stop()
        self.node.unlink(missing_ok=True)


class FakeKernel:
    """Stands where the class ``cv2.VideoCapture`` stands, for the one camera it has."""

    def __init__(self, camera: FakeCamera) -> None:
        self._camera = camera

    def __call__(self, filename: str, apiPreference: int) -> "FakeCapture":  # noqa: N803
        """Open the camera."""
        return FakeCapture(self._camera)

    def waitAny(self, streams: Sequence[Any], timeoutNs: int) -> tuple[bool, list[int]]:  # noqa: N802, N803
        """Wait for a frame of the one stream, and grab it."""
        ready = streams[0].grab(timeoutNs * 1e-9)
        return ready, [0] if ready else []


class FakeCapture:
    """An open ``cv2.VideoCapture`` of the fake kernel."""

    def __init__(self, camera: FakeCamera) -> None:
        self._camera, self._opened = camera, not camera.in_use
        self._number, self._has_bytes = 0, False
        if self._opened:
            camera.in_use = True
            camera.schedule.start()

    def isOpened(self) -> bool:  # noqa: N802
        """Whether it was free."""
        return self._opened

    def set(self, propId: int, value: float) -> bool:  # noqa: N803
        """Take any property; the number of buffers and the format mean something."""
        if propId == cv2.CAP_PROP_BUFFERSIZE:
            self._camera.schedule.queue = int(value)
        if propId == cv2.CAP_PROP_FOURCC:
            self._has_bytes = int(value) == cv2.VideoWriter.fourcc(*"YUYV")
        return True

    def get(self, propId: int) -> float:  # noqa: N803
        """The camera's own size whatever was set; the time stamp in milliseconds."""
        own = {
            cv2.CAP_PROP_FRAME_WIDTH: self._camera.size[0],
            cv2.CAP_PROP_FRAME_HEIGHT: self._camera.size[1],
            cv2.CAP_PROP_POS_MSEC: 1e3 * self._camera.schedule.device_s(self._number),
        }
        return float(own.get(propId, 0.0))

    def grab(self, timeout_s: float) -> bool:
        """Wait for the next frame. Raises cv2.error, as on POLLERR, when the camera has gone."""
        try:
            number = self._camera.schedule.wait(timeout_s)
        except UnpluggedError as error:
            self._camera.unplug()
            raise cv2.error("VideoIO(V4L2): POLLERR") from error
        if number is not None:
            self._number = number
        return number is not None

    def retrieve(self) -> tuple[bool, NDArray[Any]]:
        """The grabbed frame as uint8 (height, width, 2) or uint16 (height, width); or fewer in one row."""
        words = self._camera.uvc_frame(self._number)
        data = words.view(np.uint8).reshape(*words.shape, 2) if self._has_bytes else words
        if self._camera.schedule.is_short():
            return True, data.reshape(1, -1)[:, : data.size // 3]
        return True, data

    def release(self) -> None:
        """Let others have it."""
        if self._opened:
            self._opened = self._camera.in_use = False
