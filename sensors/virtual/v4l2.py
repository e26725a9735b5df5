"""Twins of thermal cameras at a device node, with the interface of OpenCV's V4L2 backend.

The cameras are an Optris PI200, a generic camera of 16-bit words, and a FLIR Lepton with its telemetry.
Constants are untuned.
"""

import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.device.v4l2_camera import V4l2Node
from sensors.drivers import lepton
from sensors.drivers.optris import HEIGHT, WIDTH, Layout, pack
from sensors.drivers.y16 import Radiometry
from sensors.virtual.frame_loop import FrameLoop, Noise
from sensors.virtual.schedule import Faults, Schedule, UnpluggedError

COUNTS_AT_20_C, COUNTS_PER_K, FLAG_COUNTS = 8000.0, 25.0, 8150  # raw counts; the last of a closed flag
COUNTS = Radiometry(1 / COUNTS_PER_K, 20 - COUNTS_AT_20_C / COUNTS_PER_K)
NOISE_COUNTS, NOISE_K = 2.0, 0.05  # stated NETD of a PI200 (0.08 K) and of a Lepton
FLAG_CLOSED_S = 0.5  # s of a PI200's flag cycle
IMMINENT_S, RUNNING_S = 2.0, 23 / 26  # s of a Lepton's flat-field correction (datasheet)
SHUTTER_C = 27.0
FIRST_MS = 2**32 - 2000  # a Lepton's clock wraps two seconds after the start, instead of after 49 days


class FakeCamera(ABC):
    """Camera with a device node (an empty file, deleted with the camera) and a twin of ``cv2.VideoCapture``.

    size: (width, height) of a frame in words. Its time stamps count seconds since the camera's start. Only
    one reader can open it at a time.
    """

    def __init__(self, size: tuple[int, int], scene: FrameLoop, schedule: Schedule) -> None:
        scene.thermal(0)
        self.size, self.scene, self.schedule, self.in_use = size, scene, schedule, False
        handle, node = tempfile.mkstemp(prefix="virtual-video-")
        os.close(handle)
        self.node = V4l2Node(Path(node), "virtual", self)

    @abstractmethod
    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """Return frame ``number`` as words (height, width)."""

    def unplug(self) -> None:
        """Delete the node and end the stream, as if the device was unplugged; idempotent."""
        self.schedule.stop()
        self.node.path.unlink(missing_ok=True)

    def __call__(self, filename: str, apiPreference: int) -> "FakeCapture":  # noqa: N803
        """Open the camera, as the constructor of ``cv2.VideoCapture`` does."""
        return FakeCapture(self)

    def waitAny(self, streams: Sequence[Any], timeoutNs: int) -> tuple[bool, list[int]]:  # noqa: N802, N803
        """Wait for a frame of the single stream, and grab it."""
        ready = streams[0].grab(timeoutNs * 1e-9)
        return ready, [0] if ready else []


class FakeCapture:
    """An open ``cv2.VideoCapture`` of a fake camera."""

    def __init__(self, camera: FakeCamera) -> None:
        self._camera, self._opened = camera, not camera.in_use
        self._number, self._has_bytes = 0, False
        if self._opened:
            camera.in_use = True
            camera.schedule.start()

    def isOpened(self) -> bool:  # noqa: N802
        """Return True unless the camera already had a reader."""
        return self._opened

    def set(self, propId: int, value: float) -> bool:  # noqa: N803
        """Accept any property; only the number of buffers and the format have an effect."""
        if propId == cv2.CAP_PROP_BUFFERSIZE:
            self._camera.schedule.queue = int(value)
        if propId == cv2.CAP_PROP_FOURCC:
            self._has_bytes = int(value) == cv2.VideoWriter.fourcc(*"YUYV")
        return True

    def get(self, propId: int) -> float:  # noqa: N803
        """Return the camera's own size, or the time stamp in milliseconds."""
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
        """Return the frame as uint8 (height, width, 2) or uint16 (height, width); a truncated frame has one
        row.
        """
        words = self._camera.uvc_frame(self._number)
        data = words.view(np.uint8).reshape(*words.shape, 2) if self._has_bytes else words
        if self._camera.schedule.is_short():
            return True, data.reshape(1, -1)[:, : data.size // 3]
        return True, data

    def release(self) -> None:
        """Free the camera."""
        if self._opened:
            self._opened = self._camera.in_use = False


class VirtualOptris(FakeCamera):
    """An Optris PI200 in one mode. flag_every_s: seconds between two closings of the flag (shutter)."""

    def __init__(
        self, layout: Layout, scene: FrameLoop, faults: Faults | None = None, flag_every_s: float = 12.0
    ) -> None:
        super().__init__((layout.width, layout.height), scene, Schedule(layout.uvc_hz, faults))
        self.layout, self._flag_every_s = layout, flag_every_s
        self._noise = Noise(NOISE_COUNTS, (HEIGHT, WIDTH))

    def counts(self, number: int) -> NDArray[np.uint16]:
        """Return thermal image ``number`` as uint16 (120, 160) counts."""
        seconds, noise = number / self.layout.thermal_hz, self._noise(number)
        if seconds % self._flag_every_s >= self._flag_every_s - FLAG_CLOSED_S:
            return np.asarray(np.rint(FLAG_COUNTS + noise), np.uint16)
        counts = np.rint(COUNTS_AT_20_C + COUNTS_PER_K * (self.scene.thermal(seconds) - 20) + noise)
        return np.asarray(np.clip(counts, 0, 65535), np.uint16)

    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """Return UVC frame ``number``; metadata is the image's number, then the word's index."""
        n = self.layout.subframes
        images = range(n * number, n * (number + 1))
        words = [np.array([at & 0xFFFF, *range(1, 13)], np.uint16) for at in images]
        return pack(self.layout, [(self.counts(at), w) for at, w in zip(images, words, strict=True)])


@dataclass(frozen=True)
class VirtualWords:
    """Properties of a camera of 16-bit words. shape: of the image (h, w)."""

    radiometry: Radiometry = COUNTS
    rate_hz: float = lepton.RATE_HZ
    shape: tuple[int, int] = (120, 160)


class VirtualY16(FakeCamera):
    """A camera of 16-bit words. below: rows of words behind the image."""

    def __init__(
        self,
        scene: FrameLoop,
        faults: Faults | None = None,
        words: VirtualWords | None = None,
        below: int = 0,
    ) -> None:
        self.words = words = words or VirtualWords()
        height, width = words.shape
        super().__init__((width, height + below), scene, Schedule(words.rate_hz, faults))
        self._noise = Noise(NOISE_K, words.shape)

    def celsius(self, number: int) -> NDArray[np.float32]:
        """Return image ``number`` in Celsius, float32 (h, w), with noise."""
        (height, width), scene = self.words.shape, self.scene.thermal(number / self.words.rate_hz)
        if height > scene.shape[0]:
            finer = -(-height // scene.shape[0])
            scene = np.repeat(np.repeat(scene, finer, axis=0), finer, axis=1)[:height, :width]
        step = scene.shape[0] // height
        return np.asarray(scene[::step, ::step] + self._noise(number), np.float32)

    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """Return the image as words."""
        radiometry = self.words.radiometry
        words = np.rint((self.celsius(number) - radiometry.offset_c) / radiometry.scale)
        return np.asarray(words.clip(0, 65535), np.uint16)


@dataclass(frozen=True)
class LeptonState:
    """State of a Lepton.

    kelvin: kelvins per step, None = raw counts. shape: image size of a Lepton 3.5 or 2.5. ffc_every_s:
    seconds from one flat-field correction to the next; the first correction is done already.
    """

    kelvin: float | None = 0.01
    shape: tuple[int, int] = (120, 160)
    gain: str = "high"
    agc: bool = False
    ffc_every_s: float = 180.0


class VirtualLepton(VirtualY16):
    """A Lepton and its telemetry."""

    def __init__(
        self, scene: FrameLoop, faults: Faults | None = None, state: LeptonState | None = None
    ) -> None:
        self.state = state = state or LeptonState()
        radiometry = COUNTS if state.kelvin is None else Radiometry(state.kelvin)
        size = next(size for size, image in lepton.SIZES.items() if image == state.shape)
        words = VirtualWords(radiometry, lepton.RATE_HZ, state.shape)
        super().__init__(scene, faults, words, size[1] - state.shape[0])

    def ffc_state(self, number: int) -> int:
        """Return the state of the flat-field correction: 1 imminent, 2 running, 3 done."""
        ahead_s = self.state.ffc_every_s - number / lepton.RATE_HZ % self.state.ffc_every_s
        return 2 if ahead_s <= RUNNING_S else 1 if ahead_s <= RUNNING_S + IMMINENT_S else 3

    def celsius(self, number: int) -> NDArray[np.float32]:
        """Return image ``number`` in Celsius; during a flat-field correction, the temperature of the
        shutter.
        """
        if self.ffc_state(number) == 2:
            return np.full(self.state.shape, SHUTTER_C, np.float32)
        return super().celsius(number)

    def uvc_frame(self, number: int) -> NDArray[np.uint16]:
        """Return the image and its telemetry."""
        image, state = super().uvc_frame(number), self.state
        below = np.zeros((self.size[1] - state.shape[0], self.size[0]), np.uint16)
        rows = below.reshape(-1, lepton.ROW_WORDS)
        uptime_ms = FIRST_MS + round(1000 * self.schedule.device_s(number))
        status = self.ffc_state(number) << lepton.FFC_BIT | state.agc << lepton.AGC_BIT
        for at, value in ((lepton.UPTIME, uptime_ms), (lepton.STATUS, status)):
            rows[at], rows[at[0], at[1] + 1] = value & 0xFFFF, value >> 16 & 0xFFFF
        rows[lepton.GAIN], rows[lepton.EFFECTIVE_GAIN] = lepton.GAINS.index(state.gain), 1
        rows[lepton.TLINEAR], rows[lepton.RESOLUTION] = state.kelvin is not None, state.kelvin == 0.01
        return np.concatenate([image, below])
