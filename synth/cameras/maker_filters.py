"""Depth camera with the maker's filters, which leave little noise and no holes."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np

from annotate.array_types import Float32
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.rig.camera import Intrinsics
from synth.cameras.pixel_random import NORMALS, lattice, ramps, smooth
from synth.cameras.relief import FARTHEST_MM
from synth.cameras.sensor import CleanDepth, Pixels, Reading, drawn_camera, key_of, strength
from synth.surface.rasterize import EXACT

RIPPLE_LOG2 = 2  # size of ripples after a filter of 5 x 5 pixels; untuned


@dataclass(frozen=True)
class Filtered:
    """Depth camera with spatial and temporal filters and filled holes.

    ripple_mm: standard deviation of the remaining noise. least_px: width of the narrowest limb that the
    filters keep.
    """

    ripple_mm: float = 1.0
    least_px: int = 1
    camera: Intrinsics = KINECT2_PINHOLE
    model: str = "filtered-512"
    kind: ClassVar[str] = "filtered"

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "Filtered":
        """Draw the parameters of one camera of the model ``entry`` in ``sensors.toml``."""
        return Filtered(strength(rng, 2.0), int(rng.integers(1, 4)), drawn_camera(entry, rng), entry["model"])

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """Return the depth reading of a clean image, as ``Sensor.read``."""
        reading, noise = clean.blank(), (NORMALS, ramps(RIPPLE_LOG2))
        _read(clean.pixels(0, self.least_px), np.float32(self.ripple_mm), key_of(rng), noise, reading)
        return reading


@numba.njit(cache=True, fastmath=EXACT)
def _read(
    pixels: Pixels, ripple_mm: np.float32, key: np.uint64, noise: tuple[Float32, Float32], reading: Reading
) -> None:
    depth, _, wanted, shown, _, _ = pixels
    (normals, weights), (depth_mm, source) = noise, reading
    height, width = depth.shape
    ripples = lattice(key, height, width, RIPPLE_LOG2, normals)
    for v in range(height):
        for u in range(width):
            if not (wanted[v, u] and shown[v, u]) or depth[v, u] > np.float32(FARTHEST_MM / 1000):
                continue
            mm = depth[v, u] * np.float32(1000)
            if ripple_mm > 0:
                mm += ripple_mm * smooth(ripples, weights, v, u, RIPPLE_LOG2)
            depth_mm[v, u] = int(np.rint(mm))
            source[v, u] = v * width + u
