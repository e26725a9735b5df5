"""Base class of cameras that stream images. Constants are untuned unless a source is given."""

import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Mapping
from threading import Event, Lock

from sensors.device.protocol import ColorImage, DepthImage, DeviceReading, ThermalCounts, ThermalImage
from sensors.errors import DeviceError, DeviceLostError, DeviceNotFoundError
from sensors.rig.rig_calibration import RigCalibration

SLICE_S = 0.1  # s; longest wait before another thread may close the device
RESET_NS = 1_000_000_000  # ns by which a stamp must fall to mean that the clock was reset
DEPTH_RATE_HZ = 30.0  # of either stream of a depth camera, in the mode that the drivers set
DEPTH_CAMERA_RATES_HZ = {DepthImage.stream: DEPTH_RATE_HZ, ColorImage.stream: DEPTH_RATE_HZ}


class StreamingCamera(ABC):
    """Base class of a ``Device`` that is driven by its maker's library.

    silence_s: seconds without any image after which the device counts as lost.
    """

    silence_s = 2.0

    def __init__(self, address: str, serial: str, rates_hz: Mapping[str, float]) -> None:
        self.address, self.serial, self.rates_hz = address, serial, rates_hz
        self.calibration: RigCalibration | None = None
        self._ready = deque[DeviceReading]()
        self._before_ns: dict[str, int] = {}
        self._last_image_s, self._closed, self._lock = time.monotonic(), Event(), Lock()

    @abstractmethod
    def _begin(self) -> RigCalibration | None:
        """Begin to stream, and return a depth camera's factory calibration."""

    @abstractmethod
    def _receive(self, timeout_s: float) -> None:
        """Wait for images and ``_take`` them. Raises DeviceError where the camera fails."""

    @abstractmethod
    def _end(self) -> None:
        """Stop and release the device."""

    def start(self) -> None:
        """Begin all streams."""
        self.calibration = self._begin()
        self._last_image_s = time.monotonic()

    def read(self, timeout_s: float) -> DeviceReading | None:
        """Return the next image; see ``Device.read``."""
        end_s = time.monotonic() + timeout_s
        while not self._ready:
            left_s = end_s - time.monotonic()
            with self._lock:
                if self._closed.is_set():
                    raise DeviceLostError(f"{self.address} is closed; open it again")
                self._receive(max(0.0, min(left_s, SLICE_S)))
            if time.monotonic() - self._last_image_s > self.silence_s:
                raise DeviceLostError(
                    f"{self.address} sent nothing for {self.silence_s:g} s; check its cable"
                )
            if left_s <= 0 and not self._ready:
                return None
        return self._ready.popleft()

    def close(self) -> None:
        """Release the device; idempotent, from any thread."""
        if not self._closed.is_set():
            # Set before the lock, which the reading thread takes again and again.
            self._closed.set()
            with self._lock:
                self._end()

    def _take(
        self,
        stamp_ns: int,
        value: DepthImage | ColorImage | ThermalImage | ThermalCounts,
        lost: int | None = None,
        arrival_ns: int | None = None,
    ) -> None:
        """Queue an image for ``read``; drop an image that is older than the last one.

        lost: images of the stream lost before this one; None counts gaps between stamps. arrival_ns: None =
        now. Raises DeviceLostError if the clock was reset.
        """
        self._last_image_s = time.monotonic()
        before_ns = self._before_ns.get(value.stream)
        if before_ns is not None and stamp_ns <= before_ns:
            if before_ns - stamp_ns > RESET_NS:
                back_s = (before_ns - stamp_ns) * 1e-9
                raise DeviceLostError(
                    f"{self.address} set its clock back by {back_s:.0f} s; start the command again"
                )
            return
        self._before_ns[value.stream] = stamp_ns
        if lost is None:
            gap_ns = 0 if before_ns is None else stamp_ns - before_ns
            lost = max(0, round(gap_ns * 1e-9 * self.rates_hz[value.stream]) - 1)
        arrival_ns = time.monotonic_ns() if arrival_ns is None else arrival_ns
        self._ready.append(DeviceReading(stamp_ns, arrival_ns, value, lost))


def choose(kind: str, serials: list[str], wanted: str) -> str:
    """Return the serial number to open: ``wanted``, or the only one if that is empty.

    Raises DeviceNotFoundError if it is absent, DeviceError if several devices match.
    """
    listed = ", ".join(sorted(set(serials)))
    if not serials:
        raise DeviceNotFoundError(f"no {kind} is plugged in; plug one in and run: annotate-cloud devices")
    if not wanted and len(set(serials)) > 1:
        raise DeviceError(f"there are {len(serials)} {kind} devices ({listed}); name one by serial")
    serial = wanted or serials[0]
    if serial not in serials:
        raise DeviceNotFoundError(f"no {kind} has serial {serial!r}; give one that is plugged in: {listed}")
    if Counter(serials)[serial] > 1:
        raise DeviceError(f"two {kind} devices have serial {serial!r}; unplug one of them")
    return serial
