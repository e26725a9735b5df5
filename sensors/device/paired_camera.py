"""A depth camera whose vendor's library hands out depth and colour together: Azure Kinect, Orbbec."""

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Event, Lock
from typing import Protocol

from sensors.device.protocol import ColorImage, DepthImage, Reading
from sensors.errors import DeviceLostError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration

RATE_HZ = 30.0
SILENCE_S = 2.0
"""At 30 Hz so long a silence means an unplugged or crashed device."""
SLICE_S = 0.1


@dataclass(frozen=True)
class Image:
    """An image and the device's time of it."""

    stamp_ns: int
    value: DepthImage | ColorImage


class CaptureLibrary(Protocol):
    """What of a vendor's library is needed once its device is open."""

    def start(self) -> RigCalibration:
        """Begin to stream; the factory's calibration."""
        ...

    def capture(self, timeout_s: float) -> list[Image]:
        """The images of the next capture, empty when none came in time. Raises DeviceError."""
        ...

    def close(self) -> None:
        """Stop and give the device back."""
        ...


class PairedCamera:
    """A ``Device`` over a vendor's library. calibration: the factory's, None before ``start``."""

    def __init__(self, address: str, serial: str, library: CaptureLibrary) -> None:
        self.address, self.serial, self._library = address, serial, library
        self.rates_hz: Mapping[str, float] = {DepthImage.stream: RATE_HZ, ColorImage.stream: RATE_HZ}
        self.calibration: RigCalibration | None = None
        self._ready = deque[Reading]()
        self._before_ns: dict[str, int] = {}
        self._heard_s, self._closed, self._lock = time.monotonic(), Event(), Lock()

    @property
    def cameras(self) -> Mapping[str, Intrinsics]:
        """Factory intrinsics; empty before ``start``."""
        if self.calibration is None:
            return {}
        both = {DepthImage.stream: self.calibration.depth, ColorImage.stream: self.calibration.color}
        return {name: camera for name, camera in both.items() if camera is not None}

    def start(self) -> None:
        """Begin both streams."""
        self.calibration = self._library.start()
        self._heard_s = time.monotonic()

    def read(self, timeout_s: float) -> Reading | None:
        """Next depth or colour image; see ``Device.read``."""
        end_s = time.monotonic() + timeout_s
        while not self._ready:
            left_s = end_s - time.monotonic()
            with self._lock:
                if self._closed.is_set():
                    raise DeviceLostError(f"{self.address} is closed; open it again")
                images = self._library.capture(max(0.0, min(left_s, SLICE_S)))
            arrival_ns = time.monotonic_ns()
            for image in images:
                self._take(image, arrival_ns)
            if images:
                self._heard_s = time.monotonic()
            elif time.monotonic() - self._heard_s > SILENCE_S:
                raise DeviceLostError(
                    f"{self.address} has sent nothing for {SILENCE_S:g} s; check its USB 3 cable and power"
                )
            if left_s <= SLICE_S and not self._ready:
                return None
        return self._ready.popleft()

    def close(self) -> None:
        """Give the device back; idempotent."""
        if not self._closed.is_set():
            self._closed.set()
            with self._lock:
                self._library.close()

    def _take(self, image: Image, arrival_ns: int) -> None:
        stream, stamp_ns = image.value.stream, image.stamp_ns
        before_ns = self._before_ns.get(stream)
        if before_ns is not None and stamp_ns <= before_ns:
            return
        self._before_ns[stream] = stamp_ns
        periods = 1 if before_ns is None else round((stamp_ns - before_ns) * 1e-9 * RATE_HZ)
        self._ready.append(Reading(stamp_ns, arrival_ns, image.value, max(0, periods - 1)))
