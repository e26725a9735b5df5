"""Optris PI200 over V4L2: raw counts, because only the vendor's library computes temperatures.

The camera declares YUYV, but each little-endian word is one raw count. (v - 1000) / 10 holds only for the
output of the vendor's library.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import ThermalCounts
from sensors.device.v4l2_camera import V4l2Camera, V4l2Node
from sensors.drivers.flag_watch import FlagWatch

USB_ID = "0403:de37"  # PI cameras
HEIGHT, WIDTH = 120, 160  # px of every thermal image
METADATA_ROWS = slice(92, 117, 2)  # last word is metadata; documented for 128 Hz, assumed for each subframe
Subframe = tuple[NDArray[np.uint16], NDArray[np.uint16]]  # counts (120, 160), metadata (13,)


@dataclass(frozen=True)
class Layout:
    """Frame layout of one mode of the camera.

    width, height: of the UVC frame in words; uvc_hz: its rate. A UVC frame has ``subframes`` blocks of rows.
    Each row has ``visible`` words of the daylight image, ``data`` thermal words, and four more; the last of
    them is metadata in some rows.
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
        """Return the number of thermal images a second."""
        return self.uvc_hz * self.subframes


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("128hz", 164, 120, 128.0, 1, 0, 160),
        Layout("96hz-bispectral", 764, 480, 32.0, 3, 640, 120),
        Layout("128hz-bispectral", 760, 480, 32.0, 4, 596, 160),
    )
}  # of the PI200; the PI160 (160x122, metadata in its last rows) is not supported


class Optris(V4l2Camera):
    """A PI200 in one mode. The stamp of a UVC frame is the stamp of its last subframe.

    Gaps between stamps and short buffers count as lost images. Raises DeviceError for a node that does not
    open or has another size.
    """

    def __init__(self, node: V4l2Node, layout: Layout) -> None:
        super().__init__(f"optris:{node.path}?mode={layout.name}", node, layout.thermal_hz)
        self._layout, self._flag = layout, FlagWatch(layout.thermal_hz)
        self._last_ns: int | None = None
        self._configure("YUYV", [(layout.width, layout.height)], layout.uvc_hz, "choose its mode")

    def _take_frame(self) -> None:
        """Queue the thermal images of the grabbed frame, unless it is late."""
        words, layout, last_ns = self._words(), self._layout, self._last_ns
        frame_ns = self._stamp_ns()
        if last_ns is not None and frame_ns <= last_ns:
            return
        lost = 0 if last_ns is None else max(0, round((frame_ns - last_ns) * 1e-9 * layout.uvc_hz) - 1)
        self._last_ns = frame_ns
        for at, (counts, metadata) in enumerate(unpack(layout, words)):
            stamp_ns = frame_ns - round((layout.subframes - 1 - at) * 1e9 / layout.thermal_hz)
            value = ThermalCounts(counts, metadata, self._flag.flag(counts))
            self._take(stamp_ns, value, 0 if at else lost * layout.subframes)


def unpack(layout: Layout, words: NDArray[np.uint16]) -> list[Subframe]:
    """Return the subframes of a UVC frame (height, width) of words."""
    # In rows of 120 words, the image's 160-word rows continue from row to row.
    thermal = slice(layout.visible, layout.visible + layout.data)
    blocks = np.split(words, layout.subframes)
    return [(b[:, thermal].reshape(HEIGHT, WIDTH), b[METADATA_ROWS, -1].copy()) for b in blocks]


def pack(layout: Layout, subframes: list[Subframe]) -> NDArray[np.uint16]:
    """Return the words of a UVC frame, inverse of ``unpack``; the daylight image and the unused words
    are 0.
    """
    words = np.zeros((layout.height, layout.width), np.uint16)
    for block, (counts, metadata) in zip(np.split(words, layout.subframes), subframes, strict=True):
        block[:, layout.visible : layout.visible + layout.data] = counts.reshape(-1, layout.data)
        block[METADATA_ROWS, -1] = metadata
    return words
