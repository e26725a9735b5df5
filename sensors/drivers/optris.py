"""Optris PI200 over V4L2: raw counts, without the vendor's library and so without temperatures.

The camera calls its format YUYV, but each 16-bit little-endian word is one raw count. The words are counts
and no temperatures: (v - 1000) / 10 holds for what the vendor's library puts out only.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import ThermalCounts
from sensors.device.v4l2_camera import CaptureKind, V4l2Camera
from sensors.drivers.flag_watch import FlagWatch

USB_ID = "0403:de37"
"""Vendor and product of the PI cameras."""

HEIGHT, WIDTH = 120, 160
"""Size of every thermal image, in pixels."""
METADATA_ROWS = slice(92, 117, 2)
"""Rows whose last word is metadata: 92, 94 .. 116, thirteen words. Known for the 128 Hz layout; taken to be
the same within the subframes of the bispectral layouts, where only column and number are known.
"""

Subframe = tuple[NDArray[np.uint16], NDArray[np.uint16]]


@dataclass(frozen=True)
class Layout:
    """One mode of the camera. width, height: the UVC frame in words; uvc_hz: its rate.

    A UVC frame holds ``subframes`` blocks of rows, each row ``visible`` words of the daylight image, ``data``
    thermal words, and four more, the last of which carries metadata in some rows.
    """

    name: str
    width: int
    height: int
    uvc_hz: float
    subframes: int
    visible: int
    data: int

    @property
    def thermal_hz(self) -> float:
        """Thermal images a second."""
        return self.uvc_hz * self.subframes


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("128hz", 164, 120, 128.0, 1, 0, 160),
        Layout("96hz-bispectral", 764, 480, 32.0, 3, 640, 120),
        Layout("128hz-bispectral", 760, 480, 32.0, 4, 596, 160),
    )
}
"""The PI200's modes by name. The PI160 differs (160x122, metadata in its last rows) and is not supported."""


class Optris(V4l2Camera):
    """One PI200 in one mode.

    dropped counts thermal images by the gaps between stamps, short buffers included. The stamp of a UVC frame
    is that of its last subframe. Raises DeviceError for a node that does not open or has another size.
    """

    def __init__(
        self, node: Path, layout: Layout, serial: str = "", kind: CaptureKind = cv2.VideoCapture
    ) -> None:
        super().__init__(f"optris:{node}?mode={layout.name}", node, serial, layout.thermal_hz, kind)
        self._layout, self._flag = layout, FlagWatch(layout.thermal_hz)
        self._last_ns: int | None = None
        self._configure("YUYV", [(layout.width, layout.height)], layout.uvc_hz, "choose its mode")

    def _take_frame(self) -> None:
        """Take the thermal images of the frame at hand; none of one that comes late."""
        words, layout, last_ns = self._words(), self._layout, self._last_ns
        frame_ns = self._stamp_ns()
        if last_ns is not None and frame_ns <= last_ns:
            return
        lost = 0 if last_ns is None else max(0, round((frame_ns - last_ns) * 1e-9 * layout.uvc_hz) - 1)
        self._last_ns = frame_ns
        for at, (counts, metadata) in enumerate(unpack(layout, words)):
            stamp_ns = frame_ns - round((layout.subframes - 1 - at) * 1e9 / layout.thermal_hz)
            value = ThermalCounts(counts, metadata, self._flag.see(counts))
            self._take(stamp_ns, value, 0 if at else lost * layout.subframes)


def unpack(layout: Layout, words: NDArray[np.uint16]) -> list[Subframe]:
    """UVC frame (height, width) of words -> (counts (120, 160), metadata (13,)) of every subframe."""
    # Where a row holds 120 words, the image's 120 rows of 160 words run on from row to row.
    return [
        (
            block[:, layout.visible : layout.visible + layout.data].reshape(HEIGHT, WIDTH),
            block[METADATA_ROWS, -1].copy(),
        )
        for block in np.split(words, layout.subframes)
    ]


def pack(layout: Layout, subframes: list[Subframe]) -> NDArray[np.uint16]:
    """Inverse of ``unpack``; the daylight image and the unused words are 0."""
    words = np.zeros((layout.height, layout.width), np.uint16)
    for block, (counts, metadata) in zip(np.split(words, layout.subframes), subframes, strict=True):
        block[:, layout.visible : layout.visible + layout.data] = counts.reshape(-1, layout.data)
        block[METADATA_ROWS, -1] = metadata
    return words
