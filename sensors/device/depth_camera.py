"""A depth camera over a vendor's library that gives depth and colour: Kinect v2, Azure Kinect, Orbbec."""

import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Mapping
from threading import Event, Lock

from sensors.device.protocol import ColorImage, DepthImage, DeviceReading
from sensors.errors import DeviceError, DeviceLostError, DeviceNotFoundError
from sensors.rig.rig_calibration import RigCalibration

RATE_HZ = 30.0
"""Images a second of either stream, in the mode that the drivers set."""
SILENCE_S = 2.0
"""Seconds without any image after which the device counts as unplugged or crashed. Chosen by eye."""
SLICE_S = 0.1
"""Seconds a wait lasts at most before another thread may close the device. Chosen by eye."""


TimedImage = tuple[int, DepthImage | ColorImage, int | None]
"""The device's time of an image in nanoseconds, the image, and how many of its stream were lost since the one
before: None where the library does not count, so that gaps between stamps count."""


class DepthCamera(ABC):
    """A ``Device``; each driver has the calls of one vendor's library, whose device it has opened."""

    def __init__(self, address: str, serial: str) -> None:
        self.address, self.serial = address, serial
        self.rates_hz: Mapping[str, float] = {DepthImage.stream: RATE_HZ, ColorImage.stream: RATE_HZ}
        self.calibration: RigCalibration | None = None
        self._ready = deque[DeviceReading]()
        self._before_ns: dict[str, int] = {}
        self._last_image_s, self._closed, self._lock = time.monotonic(), Event(), Lock()

    @abstractmethod
    def _begin(self) -> RigCalibration:
        """Begin to stream; the factory's calibration."""

    @abstractmethod
    def _capture(self, timeout_s: float) -> list[TimedImage]:
        """The images of the next capture, empty when none came in time. Raises DeviceError."""

    @abstractmethod
    def _end(self) -> None:
        """Stop and give the device back."""

    def start(self) -> None:
        """Begin both streams."""
        self.calibration = self._begin()
        self._last_image_s = time.monotonic()

    def read(self, timeout_s: float) -> DeviceReading | None:
        """Next depth or colour image; see ``Device.read``."""
        end_s = time.monotonic() + timeout_s
        while not self._ready:
            left_s = end_s - time.monotonic()
            with self._lock:
                if self._closed.is_set():
                    raise DeviceLostError(f"{self.address} is closed; open it again")
                images = self._capture(max(0.0, min(left_s, SLICE_S)))
            arrival_ns = time.monotonic_ns()
            for image in images:
                self._take(*image, arrival_ns)
            if images:
                self._last_image_s = time.monotonic()
            elif time.monotonic() - self._last_image_s > SILENCE_S:
                raise DeviceLostError(f"{self.address} sent nothing for {SILENCE_S:g} s; check its cable")
            if left_s <= 0 and not self._ready:
                return None
        return self._ready.popleft()

    def close(self) -> None:
        """Give the device back; idempotent."""
        if not self._closed.is_set():
            self._closed.set()
            with self._lock:
                self._end()

    def _take(self, stamp_ns: int, value: DepthImage | ColorImage, lost: int | None, arrival_ns: int) -> None:
        before_ns = self._before_ns.get(value.stream)
        if before_ns is not None and stamp_ns <= before_ns:
            return
        self._before_ns[value.stream] = stamp_ns
        if lost is None:
            lost = 0 if before_ns is None else max(0, round((stamp_ns - before_ns) * 1e-9 * RATE_HZ) - 1)
        self._ready.append(DeviceReading(stamp_ns, arrival_ns, value, lost))


def choose(kind: str, serials: list[str], wanted: str) -> str:
    """The serial number to open: ``wanted``, or where that is empty the only one there is.

    Raises DeviceNotFoundError where it is not there, DeviceError where several would do.
    """
    listed = ", ".join(sorted(set(serials)))
    if not serials:
        raise DeviceNotFoundError(f"no {kind} is plugged in; see: annotate-cloud devices")
    if not wanted and len(set(serials)) > 1:
        raise DeviceError(f"there are {len(serials)} {kind} devices ({listed}); name one by serial")
    serial = wanted or serials[0]
    if serial not in serials:
        raise DeviceNotFoundError(f"no {kind} has serial {serial!r}; plugged in: {listed}")
    if Counter(serials)[serial] > 1:
        raise DeviceError(f"two {kind} devices have serial {serial!r}; unplug one of them")
    return serial
