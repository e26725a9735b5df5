"""Depth images after a maker's filters, which leave almost no faults."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np

from annotate.array_types import Bool, Float32, Int32, UInt16
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.rig.camera import Intrinsics
from synth.cameras.pixel_random import NORMALS, lattice, ramps, smooth
from synth.cameras.relief import FARTHEST_MM
from synth.cameras.sensor import CleanDepth, Reading, drawn_camera, key_of, strength
from synth.surface.rasterize import EXACT


@dataclass(frozen=True)
class Filtered:
    """A stream after spatial and temporal filters and filled holes: no dropout, a smooth rim.

    ripple_mm: standard deviation of what is left of the noise, alike over 4 pixels. least_px: width below
    which a person's fingers are lost, 1 for none.
    """

    ripple_mm: float = 1.0
    least_px: int = 1
    camera: Intrinsics = KINECT2_PINHOLE
    model: str = "filtered-512"
    kind: ClassVar[str] = "filtered"

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "Filtered":
        """A stream of a size of ``sensors.toml``, with a ripple of 0 to 2 mm."""
        return Filtered(strength(rng, 2.0), int(rng.integers(1, 4)), drawn_camera(entry, rng), entry["model"])

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """What the stream shows of a clean depth image, dark or not; see ``Sensor.read``."""
        reading, wanted = clean.blank(), clean.wanted(0) & clean.shown(self.least_px)
        ripple = np.float32(self.ripple_mm)
        _read(clean.filled(), wanted, ripple, key_of(rng), NORMALS, ramps(RIPPLE_LOG2), *reading)
        return reading


RIPPLE_LOG2 = 2
"""Size of ripples left by a filter of 5 x 5 pixels: 4. Chosen by eye."""


@numba.njit(cache=True, fastmath=EXACT)
def _read(
    depth: Float32, wanted: Bool, ripple_mm: np.float32, key: np.uint64, normals: Float32,
    weights: Float32, depth_mm: UInt16, source: Int32,
) -> None:  # fmt: skip
    """Writes the readings of the wanted pixels into the last two arguments."""
    height, width = depth.shape
    ripples = lattice(key, height, width, RIPPLE_LOG2, normals)
    for v in range(height):
        for u in range(width):
            if not wanted[v, u] or depth[v, u] > np.float32(FARTHEST_MM / 1000):
                continue
            mm = depth[v, u] * np.float32(1000)
            if ripple_mm > 0:
                mm += ripple_mm * smooth(ripples, weights, v, u, RIPPLE_LOG2)
            depth_mm[v, u] = int(np.rint(mm))
            source[v, u] = v * width + u
