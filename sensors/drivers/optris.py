"""Optris PI200 over V4L2: raw counts, without the vendor's library and so without temperatures.

The camera calls its format YUYV, but each 16-bit little-endian word is one raw count. The words are counts
and no temperatures: (v - 1000) / 10 holds for what the vendor's library puts out only.
"""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.device.node import check_node
from sensors.device.protocol import Flag, ThermalCounts
from sensors.device.streaming_camera import StreamingCamera
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError, DeviceLostError

USB_ID = "0403:de37"
"""Vendor and product of the PI cameras."""
BUFFERS = 10
"""Frames the kernel keeps; OpenCV allows no more. 78 ms at 128 Hz."""
FLAT_SHARE = 0.4
"""A closed flag leaves at most this share of the scene's usual spread of counts. Chosen by eye."""
FORGET = 0.02
"""Weight of the newest image in the usual spread, 0 to 1. Chosen by eye."""
LONGEST_S = 1.5
"""Seconds: a flag cycle takes half a second; what stays flat longer is the scene itself. Chosen by eye."""

HEIGHT, WIDTH = 120, 160
"""Size of every thermal image, in pixels."""
METADATA_ROWS = slice(92, 117, 2)
"""Rows whose last word is metadata: 92, 94 .. 116, thirteen words. Known for the 128 Hz layout; taken to be
the same within the subframes of the bispectral layouts, where only column and number are known.
"""

Subframe = tuple[NDArray[np.uint16], NDArray[np.uint16]]
CaptureKind = Any
"""The class ``cv2.VideoCapture``, or what a fake kernel has in its place."""


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


class Optris(StreamingCamera):
    """One PI200 in one mode, through OpenCV's V4L2 backend with its conversions off.

    OpenCV gives no running number of a frame: dropped counts thermal images by the gaps between stamps, short
    buffers included. The stamp of a UVC frame is that of its last subframe.
    Raises DeviceError for a node that does not open or has another size.
    """

    silence_s = inf  # an unplugged camera has no node

    def __init__(
        self, node: Path, layout: Layout, serial: str = "", kind: CaptureKind = cv2.VideoCapture
    ) -> None:
        check_node(node)
        rates_hz = {ThermalCounts.stream: layout.thermal_hz}
        super().__init__(f"optris:{node}?mode={layout.name}", serial, rates_hz)
        self._node, self._layout, self._kind = node, layout, kind
        self._flag = FlagWatch(layout.thermal_hz)
        self._last_ns: int | None = None
        self._capture = kind(str(node), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise DeviceBusyError(f"{node} does not stream; close the program that uses it")
        self._configure()

    def _begin(self) -> None:
        """Nothing: OpenCV streams from opening on."""

    def _end(self) -> None:
        self._capture.release()

    def _configure(self) -> None:
        wanted = self._layout.width, self._layout.height
        for name, value in (
            (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV")),
            (cv2.CAP_PROP_FRAME_WIDTH, wanted[0]),
            (cv2.CAP_PROP_FRAME_HEIGHT, wanted[1]),
            (cv2.CAP_PROP_FPS, self._layout.uvc_hz),
            (cv2.CAP_PROP_CONVERT_RGB, 0),
            (cv2.CAP_PROP_BUFFERSIZE, BUFFERS),
        ):
            self._capture.set(name, value)
        sides = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT
        got = tuple(int(self._capture.get(side)) for side in sides)
        if got != wanted:
            self._capture.release()
            raise DeviceError(f"{self._node} gives {got}, not {wanted} words; choose its mode")

    def _receive(self, timeout_s: float) -> None:
        try:
            # 0 would mean for ever.
            ready, _ = self._kind.waitAny([self._capture], max(1, int(timeout_s * 1e9)))
        except cv2.error as error:
            raise self._lost() from error
        if ready:
            self._take_frame()
        elif not self._node.exists():
            raise self._lost()

    def _take_frame(self) -> None:
        """Take the thermal images of the frame at hand; none of one that comes late."""
        words, layout, last_ns = self._words(), self._layout, self._last_ns
        frame_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        if last_ns is not None and frame_ns <= last_ns:
            return
        lost = 0 if last_ns is None else max(0, round((frame_ns - last_ns) * 1e-9 * layout.uvc_hz) - 1)
        self._last_ns = frame_ns
        for at, (counts, metadata) in enumerate(unpack(layout, words)):
            stamp_ns = frame_ns - round((layout.subframes - 1 - at) * 1e9 / layout.thermal_hz)
            value = ThermalCounts(counts, metadata, self._flag.see(counts))
            self._take(stamp_ns, value, 0 if at else lost * layout.subframes)

    def _words(self) -> NDArray[np.uint16]:
        """uint16 (height, width): the frame at hand. Raises DeviceFaultError for a short one."""
        good, image = self._capture.retrieve()
        size = image.size if good and image is not None else 0
        height, width = self._layout.height, self._layout.width
        if size != 2 * height * width:
            if not self._node.exists():
                raise self._lost()
            raise DeviceFaultError(
                f"{self._node} sent {size} of {2 * height * width} bytes; "
                "if this happens again, use a USB port of its own"
            )
        return np.ascontiguousarray(image, np.uint8).reshape(height, 2 * width).view("<u2")

    def _lost(self) -> DeviceLostError:
        return DeviceLostError(f"{self._node} is no longer connected; plug the camera in again")


class FlagWatch:
    """Recognises the closed flag in the counts of ``rate_hz`` images a second; no metadata word shows it.

    The flag is taken for closed while an image repeats the one before to the last bit (the camera freezes
    its output; a live detector is never so quiet), or while it is far flatter than the scene usually is.
    """

    def __init__(self, rate_hz: float) -> None:
        self._longest = round(LONGEST_S * rate_hz)
        self._usual: float | None = None
        self._before: NDArray[np.uint16] | None = None
        self._flat = 0

    def see(self, counts: NDArray[np.uint16]) -> Flag:
        """State of the flag in the next image, uint16 (h, w)."""
        frozen = self._before is not None and np.array_equal(counts, self._before)
        self._before = counts
        spread = float(np.std(counts[::2, ::2]))
        if self._usual is None:
            self._usual = spread
        if frozen or spread < FLAT_SHARE * self._usual:
            self._flat += 1
            if frozen or self._flat <= self._longest:
                return Flag.CLOSED
            self._usual = spread
        self._flat = 0
        self._usual += FORGET * (spread - self._usual)
        return Flag.OPEN


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
