"""Optris PI200 over V4L2: raw counts, without the vendor's library and so without temperatures."""

from collections import deque
from collections.abc import Mapping
from pathlib import Path

from sensors.device.protocol import DeviceReading, ThermalCounts
from sensors.drivers.optris_layout import Layout, unpack
from sensors.drivers.shutter import FlagWatch
from sensors.drivers.video import OpenCvVideo, VideoFrame

USB_ID = "0403:de37"
"""Vendor and product of the PI cameras."""


class Optris:
    """One PI200 in one mode, read through ``video`` (which it owns).

    The stamp of a UVC frame is that of its last subframe. dropped counts thermal images by the gaps between
    stamps, short buffers included.
    """

    def __init__(self, node: Path, layout: Layout, video: OpenCvVideo, serial: str = "") -> None:
        self.address = f"optris:{node}?mode={layout.name}"
        self.serial = serial
        self.rates_hz: Mapping[str, float] = {ThermalCounts.stream: layout.thermal_hz}
        self.calibration = None
        self._layout, self._video = layout, video
        self._flag = FlagWatch(layout.thermal_hz)
        self._ready = deque[DeviceReading]()
        self._last_ns: int | None = None

    def start(self) -> None:
        """Nothing: OpenCV streams from opening on."""

    def read(self, timeout_s: float) -> DeviceReading | None:
        """Next thermal image; see ``Device.read``."""
        if not self._ready:
            frame = self._video.read(timeout_s)
            if frame is not None:
                self._take(frame)
        return self._ready.popleft() if self._ready else None

    def close(self) -> None:
        """Give the camera back; idempotent."""
        self._video.close()

    def _take(self, frame: VideoFrame) -> None:
        lost = self._lost_before(frame)
        if lost is None:
            return
        layout = self._layout
        period_ns = 1e9 / layout.thermal_hz
        for at, (counts, metadata) in enumerate(unpack(layout, frame.words)):
            stamp_ns = frame.stamp_ns - round((layout.subframes - 1 - at) * period_ns)
            value = ThermalCounts(counts, metadata, self._flag.see(counts))
            dropped = 0 if at else lost * layout.subframes
            self._ready.append(DeviceReading(stamp_ns, frame.arrival_ns, value, dropped))

    def _lost_before(self, frame: VideoFrame) -> int | None:
        """UVC frames missing before this one; None for one that comes late."""
        last_ns = self._last_ns
        if last_ns is not None and frame.stamp_ns <= last_ns:
            return None
        self._last_ns = frame.stamp_ns
        if last_ns is None:
            return 0
        return max(0, round((frame.stamp_ns - last_ns) * 1e-9 * self._layout.uvc_hz) - 1)
