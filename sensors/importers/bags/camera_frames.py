"""Frames of a depth camera, as its maker recorded them: depth, infrared, the colour nearest in time."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.importers.bags.ros_images import color_encoded_from, depth_mm_from, grey_from
from sensors.importers.bags.ros_messages import Picture
from sensors.rig.frame import RigFrame, mm_from_units
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps


class Images(NamedTuple):
    """A stream's images: their times int64 (n,), increasing, and the picture at an index."""

    stamps_ns: NDArray[np.int64]
    picture: Callable[[int], Picture]


class CameraFrames:
    """The frames of three streams, read one at a time. unit_mm: one step of depth."""

    def __init__(self, depth: Images, color: Images, infrared: Images, unit_mm: float) -> None:
        self._depth, self._color, self._infrared = depth, color, infrared
        self._unit_mm = unit_mm
        self._color_at = pair_stamps(depth.stamps_ns, color.stamps_ns, COLOR_WINDOW_NS)
        self._infrared_at = pair_stamps(depth.stamps_ns, infrared.stamps_ns, 0)

    def frame(self, index: int) -> RigFrame:
        """The frame of depth image ``index``. Raises FormatError."""
        depth_mm = mm_from_units(depth_mm_from(self._depth.picture(index)), self._unit_mm)
        color, infrared = int(self._color_at[index]), int(self._infrared_at[index])
        encoded = color_encoded_from(self._color.picture(color)) if color >= 0 else None
        amplitude = grey_from(self._infrared.picture(infrared)) if infrared >= 0 else None
        if amplitude is not None and amplitude.shape != depth_mm.shape:
            amplitude = None
        stamp_ns = int(self._depth.stamps_ns[index])
        return RigFrame(index, stamp_ns, depth_mm, encoded, None, amplitude)
