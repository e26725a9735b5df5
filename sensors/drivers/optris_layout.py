"""How an Optris PI200 packs its thermal images into UVC frames: three layouts, unpacked and packed.

The camera calls its format YUYV, but each 16-bit little-endian word is one raw count. The words are counts
and no temperatures: (v - 1000) / 10 holds for what the vendor's library puts out only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

HEIGHT, WIDTH = 120, 160
"""Size of every thermal image, in pixels."""
METADATA_ROWS = slice(92, 117, 2)
"""Rows whose last word is metadata: 92, 94 .. 116, thirteen words. Known for the 128 Hz layout; taken to be
the same within the subframes of the bispectral layouts, where only column and number are known.
"""


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

Subframe = tuple[NDArray[np.uint16], NDArray[np.uint16]]


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
