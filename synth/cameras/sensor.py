"""Depth sensors: what one reads of a clean depth image, and from which surface."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int32, UInt8, UInt16
from sensors.rig.camera import Intrinsics
from synth.cameras.relief import FAR_M

NOTHING = -1
"""The source of a pixel without a reading."""


class Reading(NamedTuple):
    """A sensor's image (h, w) of a window.

    depth_mm: uint16, 0 where nothing is read. source: int32, flat index of the pixel of the clean image whose
    surface the reading shows, so that labels follow; ``NOTHING`` without a reading.
    """

    depth_mm: UInt16
    source: Int32

    def carry(self, image: UInt8) -> UInt8:
        """Values (h, w) of a clean image (h, w) at the surfaces that the readings show; 0 without one."""
        return np.where(self.source >= 0, image.ravel()[self.source], np.uint8(0))


@dataclass(frozen=True)
class CleanDepth:
    """A depth image (h, w) before a sensor's faults, and the pixels whose readings are wanted.

    window: pinhole of the image, as a rule cut out of the sensor's. depth_m: float32, metres along z, NaN
    where nothing is hit. dark: share of the infrared that a surface swallows, 1 or True for hair. only: bool,
    pixels that are wanted; the others have no reading. person: bool, pixels of one person; then there are
    readings of this person alone, and some pixels outside where the sensor's rims grow. Default of both: all.
    """

    window: Intrinsics
    depth_m: Float32
    dark: Bool | Float32
    only: Bool | None = None
    person: Bool | None = None

    def filled(self) -> Float32:
        """Depth (h, w) with a background at ``FAR_M`` in place of NaN."""
        return np.where(np.isnan(self.depth_m), np.float32(FAR_M), self.depth_m)

    def swallowed(self) -> Float32:
        """Share (h, w) of the infrared that surfaces swallow, float32."""
        return self.dark.astype(np.float32)

    def wanted(self, reach_px: int) -> Bool:
        """Pixels (h, w) to compute: wanted, and at most ``reach_px`` from the person."""
        if self.person is None:
            return np.ones(self.depth_m.shape, np.bool_) if self.only is None else self.only
        side = 2 * reach_px + 1
        near = cv2.dilate(self.person.view(np.uint8), np.ones((side, side), np.uint8)).view(np.bool_)
        return near if self.only is None else near & self.only

    def shown(self, least_px: int = 1) -> Bool:
        """Pixels (h, w) whose surfaces are read: of a person, the squares of ``least_px`` that fit inside."""
        if self.person is None:
            return np.ones(self.depth_m.shape, np.bool_)
        if least_px == 1:
            return self.person
        square, first, last = np.ones((least_px, least_px), np.uint8), (0, 0), (least_px - 1, least_px - 1)
        fits = cv2.erode(self.person.view(np.uint8), square, anchor=first)
        return cv2.dilate(fits, square, anchor=last).view(np.bool_)

    def pinhole(self) -> Float32:
        """(fx, fy, cx, cy) for kernels, float32."""
        window = self.window
        return np.array([window.fx, window.fy, window.cx, window.cy], np.float32)

    def blank(self) -> Reading:
        """An image (h, w) without readings, for kernels to fill."""
        shape = self.depth_m.shape
        return Reading(np.zeros(shape, np.uint16), np.full(shape, NOTHING, np.int32))


class Sensor(Protocol):
    """A depth camera with the faults of one unit and moment.

    model: its name. kind: how it measures. camera: pinhole of its whole image, undistorted.
    """

    @property
    def model(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def camera(self) -> Intrinsics: ...

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """What the sensor makes of a clean depth image (h, w).

        Randomness is a hash of one number drawn from ``rng`` and the pixel: no pixel depends on another.
        """
        ...


REACH_PX = 4
"""Pixels by which rims grow at most; what melts into the ground reaches further."""


def key_of(rng: np.random.Generator) -> np.uint64:
    """The image's random number, from which all others are hashed."""
    return np.uint64(rng.integers(0, 2**64, dtype=np.uint64))


CENTRE_SD = 0.012
"""Standard deviation of the principal point from the image's middle, as a share of its width: that of the
units whose calibration is known (Kinect v2: 254 to 264 of 512)."""


def drawn_camera(entry: dict[str, Any], rng: np.random.Generator) -> Intrinsics:
    """A unit of a model of ``sensors.toml``: focal length in its span, principal point about the middle."""
    width, height = entry["size"]
    focal = float(rng.uniform(*entry["focal_px"]))
    cx, cy = ((side - 1) / 2 + width * rng.normal(0, CENTRE_SD) for side in (width, height))
    return Intrinsics(width, height, focal, focal, float(cx), float(cy))


def strength(rng: np.random.Generator, most: float, absent: float = 0.3) -> float:
    """A fault's strength: none in a share ``absent`` of the images, else anything up to ``most``."""
    return 0.0 if rng.random() < absent else float(rng.uniform(0, most))
