"""Depth sensors: simulated readings of a clean depth image, and the surfaces that they measure."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int32, UInt8, UInt16
from sensors.rig.camera import Intrinsics
from synth.cameras.relief import FAR_M

NOTHING = -1  # source of a pixel without a reading
REACH_PX = 4  # pixels by which rims grow at most
BEHIND_M = (0.05, 3.0)  # from a cut-out person to a drawn wall; untuned
CENTRE_SD = 0.012  # of the principal point, share of the width; Kinect v2: 254 to 264 of 512


class Reading(NamedTuple):
    """Depth (h, w) of a window of the image, millimetres, 0 without a reading.

    source: (h, w) flat index of the clean pixel whose surface was measured, or ``NOTHING``.
    """

    depth_mm: UInt16
    source: Int32

    def carry(self, image: UInt8) -> UInt8:
        """Return the values of a clean image (h, w) at the surfaces that each pixel measured, 0 without a
        reading.
        """
        return np.where(self.source >= 0, image.ravel()[self.source], np.uint8(0))


@dataclass(frozen=True)
class CleanDepth:
    """Depth image (h, w) without faults, and the pixels to measure.

    window: pinhole camera of the image. depth_m: metres along z, NaN without a hit. dark: absorbed share of
    infrared. only: mask of pixels to measure, None for all. person: mask of the only person to measure, whose
    silhouette may grow, None for every surface.
    """

    window: Intrinsics
    depth_m: Float32
    dark: Bool | Float32
    only: Bool | None = None
    person: Bool | None = None

    def filled(self) -> Float32:
        """Return the depth (h, w) with ``FAR_M`` in place of NaN."""
        return np.where(np.isnan(self.depth_m), np.float32(FAR_M), self.depth_m)

    def behind(self, rng: np.random.Generator) -> Float32:
        """Return the depth (h, w) without NaN: a drawn wall behind a cut-out person, ``FAR_M`` behind a
        scene.
        """
        if self.person is None:
            return self.filled()
        wall_m = float(self.depth_m[self.person].max()) + rng.uniform(*BEHIND_M)
        return np.where(np.isnan(self.depth_m), np.float32(min(wall_m, FAR_M)), self.depth_m)

    def wanted(self, reach_px: int) -> Bool:
        """Return the mask (h, w) of pixels to measure, at most ``reach_px`` from the person."""
        if self.person is None:
            return np.ones(self.depth_m.shape, np.bool_) if self.only is None else self.only
        side = 2 * reach_px + 1
        near = cv2.dilate(self.person.view(np.uint8), np.ones((side, side), np.uint8)).view(np.bool_)
        return near if self.only is None else near & self.only

    def shown(self, least_px: int = 1) -> Bool:
        """Return the mask (h, w) of measurable surfaces: the person, without limbs narrower than
        ``least_px``.
        """
        if self.person is None:
            return np.ones(self.depth_m.shape, np.bool_)
        if least_px == 1:
            return self.person
        square, first, last = np.ones((least_px, least_px), np.uint8), (0, 0), (least_px - 1, least_px - 1)
        fits = cv2.erode(self.person.view(np.uint8), square, anchor=first)
        return cv2.dilate(fits, square, anchor=last).view(np.bool_)

    def blank(self) -> Reading:
        """Return a reading (h, w) without a measurement at any pixel."""
        shape = self.depth_m.shape
        return Reading(np.zeros(shape, np.uint16), np.full(shape, NOTHING, np.int32))

    def pixels(self, reach_px: int = 0, least_px: int = 1) -> "Pixels":
        """Return the image's arrays for compiled kernels."""
        window, depth = self.window, self.filled()
        return Pixels(
            depth,
            self.dark.astype(np.float32),
            self.wanted(reach_px),
            self.shown(least_px),
            np.asarray(1 / depth.min(axis=1), np.float32),
            np.array([window.fx, window.fy, window.cx, window.cy], np.float32),
        )


class Pixels(NamedTuple):
    """Arrays (h, w) of a clean image for compiled kernels. nearness (h,): 1 / least depth of each row.
    pinhole (4,): fx, fy, cx, cy.
    """

    depth: Float32
    dark: Float32
    wanted: Bool
    shown: Bool
    nearness: Float32
    pinhole: Float32


class Sensor(Protocol):
    """Depth camera with the random faults of one device; camera: pinhole of the whole image, undistorted."""

    @property
    def model(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def camera(self) -> Intrinsics: ...

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """Return the reading of a clean depth image.

        A pixel's random numbers are hashes of its position and one number from ``rng``, so the numbers do not
        depend on other pixels.
        """
        ...


def key_of(rng: np.random.Generator) -> np.uint64:
    """Draw the key of an image's random numbers."""
    return np.uint64(rng.integers(0, 2**64, dtype=np.uint64))


def drawn_camera(entry: dict[str, Any], rng: np.random.Generator) -> Intrinsics:
    """Draw the intrinsics of the model ``entry`` in ``sensors.toml``, or return its ``camera``."""
    if "camera" in entry:
        own: Intrinsics = entry["camera"]
        return own
    width, height = entry["size"]
    focal = float(rng.uniform(*entry["focal_px"]))
    cx, cy = ((side - 1) / 2 + width * rng.normal(0, CENTRE_SD) for side in (width, height))
    return Intrinsics(width, height, focal, focal, float(cx), float(cy))


def strength(rng: np.random.Generator, most: float, absent: float = 0.3) -> float:
    """Draw the strength of a fault: 0 with probability ``absent``, else uniform up to ``most``."""
    return 0.0 if rng.random() < absent else float(rng.uniform(0, most))
