"""A fake kernel with one Optris PI200 behind a real node: what OpenCV's V4L2 backend would show of it."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.drivers.optris import HEIGHT, WIDTH, Layout, pack
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.schedule import Faults, Schedule, UnpluggedError

COUNTS_AT_20_C, COUNTS_PER_K, FLAG_COUNTS = 8000.0, 25.0, 8150
"""Counts at 20 C, per kelvin above it, and of the closed flag. Chosen by eye."""
NOISE_COUNTS = 2.0
"""0.08 K, the camera's stated NETD."""
FLAG_CLOSED_S = 0.5
"""Seconds of a flag cycle with the flag closed. Chosen by eye."""


class VirtualOptris:
    """The camera: its node (an empty file that vanishes with it) and its frames.

    flag_every_s: seconds from one flag cycle to the next, 12 chosen by eye. The kernel's clock counts seconds
    since the start here. One reader at a time.
    """

    def __init__(
        self, layout: Layout, scene: FrameLoop, faults: Faults | None = None, flag_every_s: float = 12.0
    ) -> None:
        scene.thermal(0)
        self.layout, self.in_use = layout, False
        self.schedule = Schedule(layout.uvc_hz, faults)
        self._scene, self._flag_every_s = scene, flag_every_s
        handle, node = tempfile.mkstemp(prefix="virtual-optris-")
        os.close(handle)
        self.node = Path(node)
        rng = np.random.default_rng(0)
        self._noise = rng.normal(0, NOISE_COUNTS, (2 * HEIGHT, WIDTH)).astype(np.float32)

    def unplug(self) -> None:
        """Vanish; idempotent."""
        self.schedule.stop()
        self.node.unlink(missing_ok=True)

    def counts(self, number: int) -> NDArray[np.uint16]:
        """Thermal image ``number`` as uint16 (120, 160) counts."""
        seconds = number / self.layout.thermal_hz
        noise = self._noise[number * 7 % HEIGHT :][:HEIGHT]
        if seconds % self._flag_every_s >= self._flag_every_s - FLAG_CLOSED_S:
            return np.asarray(np.rint(FLAG_COUNTS + noise), np.uint16)
        kelvin = self._scene.thermal(seconds) - 20
        counts = np.rint(COUNTS_AT_20_C + COUNTS_PER_K * kelvin + noise)
        return np.asarray(np.clip(counts, 0, 65535), np.uint16)

    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """UVC frame ``number`` as words (height, width); metadata is the running number, then its index."""
        n = self.layout.subframes
        images = range(n * number, n * (number + 1))
        words = [np.array([at & 0xFFFF, *range(1, 13)], np.uint16) for at in images]
        return pack(self.layout, [(self.counts(at), w) for at, w in zip(images, words, strict=True)])


class FakeKernel:
    """Stands where the class ``cv2.VideoCapture`` stands, for the one camera it has."""

    def __init__(self, camera: VirtualOptris) -> None:
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

    def __init__(self, camera: VirtualOptris) -> None:
        self._camera, self._opened = camera, not camera.in_use
        self._number = 0
        if self._opened:
            camera.in_use = True
            camera.schedule.start()

    def isOpened(self) -> bool:  # noqa: N802
        """Whether it was free."""
        return self._opened

    def set(self, propId: int, value: float) -> bool:  # noqa: N803
        """Take any property; only the number of buffers means something."""
        if propId == cv2.CAP_PROP_BUFFERSIZE:
            self._camera.schedule.queue = int(value)
        return True

    def get(self, propId: int) -> float:  # noqa: N803
        """The camera's own size whatever was set; the time stamp in milliseconds."""
        layout = self._camera.layout
        own = {
            cv2.CAP_PROP_FRAME_WIDTH: layout.width,
            cv2.CAP_PROP_FRAME_HEIGHT: layout.height,
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

    def retrieve(self) -> tuple[bool, NDArray[np.uint8]]:
        """The grabbed frame as uint8 (height, width, 2), or fewer bytes in one row."""
        data = self._camera.uvc_frame(self._number).view(np.uint8)
        if self._camera.schedule.is_short():
            return True, data.reshape(1, -1)[:, : data.size // 3]
        return True, data.reshape(self._camera.layout.height, self._camera.layout.width, 2)

    def release(self) -> None:
        """Let others have it."""
        if self._opened:
            self._opened = self._camera.in_use = False
