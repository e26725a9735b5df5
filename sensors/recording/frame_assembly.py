"""Synchronised frames of a running rig: a depth image with its colour and temperatures."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import ColorImage, DepthImage, Spot, ThermalImage
from sensors.recording.arrival_times import Arrived
from sensors.rig.frame import RigFrame
from sensors.rig.pairing import COLOR_WINDOW_NS, SPOT_WINDOW_NS, THERMAL_WINDOW_NS

WAIT_NS = 25_000_000  # ns a depth image waits: half a period of 30 Hz and 8 ms of transport; untuned
KEPT = 64  # images of each stream: 0.5 s of 128 Hz; untuned


@dataclass(frozen=True)
class SyncedFrame:
    """A frame of a running rig. host_ns: of its depth, on the host's clock since 1970.

    arrival_ns: of its depth, ``time.monotonic_ns``. spot_c: the pyrometer's target in Celsius, NaN = none.
    """

    frame: RigFrame
    host_ns: int
    arrival_ns: int
    spot_c: float = float("nan")


class FrameAssembly:
    """Pairing of readings to frames as in ``sensors.rig.pairing``, for readings that arrive live.

    rates_hz: nominal rates of the streams.
    """

    def __init__(self, rates_hz: Mapping[str, float]) -> None:
        self._others = [stream for stream in ("color", "thermal") if stream in rates_hz]
        half_ns = 0.5e9 / rates_hz.get("thermal", 128.0)
        self._thermal_window_ns = int(np.clip(half_ns, THERMAL_WINDOW_NS, COLOR_WINDOW_NS))
        self._depth = deque[tuple[int, Arrived]](maxlen=KEPT)
        self._color = deque[tuple[int, bytes]](maxlen=KEPT)
        self._thermal = deque[tuple[int, NDArray[np.float32]]](maxlen=KEPT)
        self._reached_ns = dict.fromkeys(self._others, 0)
        self._spot = (0, float("nan"))
        self._index = 0

    def add(self, item: Arrived, host_ns: int) -> None:
        """Add a reading made at ``host_ns``."""
        value = item.reading.value
        if item.reading.stream in self._reached_ns:
            self._reached_ns[item.reading.stream] = host_ns
        match value:
            case DepthImage():
                self._depth.append((host_ns, item))
            case ColorImage(encoded):
                self._color.append((host_ns, encoded))
            case ThermalImage(celsius) if item.usable:
                self._thermal.append((host_ns, celsius))
            case Spot(target_c):
                self._spot = (host_ns, target_c)

    def latest(self, now_ns: int) -> SyncedFrame | None:
        """Return the latest frame that is complete or has waited long enough; earlier frames are skipped.

        now_ns: on the clock of the arrivals.
        """
        due = None
        while self._depth and self._is_due(*self._depth[0], now_ns):
            due = self._depth.popleft()
            self._index += 1
        return self._paired(*due) if due else None

    def _is_due(self, host_ns: int, item: Arrived, now_ns: int) -> bool:
        passed = all(self._reached_ns[stream] >= host_ns for stream in self._others)
        return passed or now_ns - item.arrival_ns >= WAIT_NS

    def _paired(self, host_ns: int, item: Arrived) -> SyncedFrame:
        depth = item.reading.value
        assert isinstance(depth, DepthImage)
        frame = RigFrame(
            self._index - 1,
            item.stamp_ns,
            depth.depth_mm,
            _nearest(self._color, host_ns, COLOR_WINDOW_NS),
            _nearest(self._thermal, host_ns, self._thermal_window_ns),
            depth.infrared,
        )
        spot_ns, spot_c = self._spot
        near = abs(spot_ns - host_ns) < SPOT_WINDOW_NS
        return SyncedFrame(frame, host_ns, item.reading.arrival_ns, spot_c if near else float("nan"))


Image = TypeVar("Image")


def _nearest(images: Sequence[tuple[int, Image]], host_ns: int, window_ns: int) -> Image | None:
    """Return the image nearest in time to ``host_ns``, None if it is outside the window."""
    at_ns, image = min(images, key=lambda one: abs(one[0] - host_ns), default=(0, None))
    return image if abs(at_ns - host_ns) <= window_ns else None
