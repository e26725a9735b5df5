"""Lidar of a telephone, whose few points a network completes by the colour image and averages over time."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np

from annotate.array_types import Float32
from sensors.rig.camera import Intrinsics
from synth.cameras.depth_filters import smooth_between_edges
from synth.cameras.pixel_random import NORMALS, lattice, ramps, smooth
from synth.cameras.relief import FARTHEST_MM
from synth.cameras.sensor import NOTHING, CleanDepth, Reading, drawn_camera, key_of, strength
from synth.surface.rasterize import EXACT

WAVE_LOG2 = 3  # size of waves: 576 points lie 9 pixels apart in 256 x 192
IPHONE = Intrinsics(256, 192, 200.0, 200.0, 127.5, 95.5)


@dataclass(frozen=True)
class SmoothedLidar:
    """Depth of ARKit's ``smoothedSceneDepth``: soft edges, no holes, waves between the lidar's points.

    wave: standard deviation of depth's error, share of the depth. alpha: weight of a pixel in a recursive
    smoothing in both directions; 1 keeps edges sharp. The model is untuned; ARKit publishes no error.
    """

    wave: float = 0.005
    alpha: float = 0.6
    camera: Intrinsics = IPHONE
    model: str = "iphone-lidar"
    kind: ClassVar[str] = "lidar"

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "SmoothedLidar":
        """Draw the parameters of one camera of the model ``entry`` in ``sensors.toml``."""
        alpha = float(rng.uniform(0.45, 1.0))
        return SmoothedLidar(strength(rng, 0.01), alpha, drawn_camera(entry, rng), entry["model"])

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """Return the reading of a clean image, as ``Sensor.read``.

        A pixel's source is the surface on its ray.
        """
        depth, shape = clean.behind(rng), clean.window.shape
        inverse = (1 / depth).astype(np.float32)
        smooth_between_edges(inverse, np.float32(self.alpha), np.float32(np.inf), 1)
        waves, corners = np.empty(shape, np.float32), lattice(key_of(rng), *shape, WAVE_LOG2, NORMALS)
        _draw(waves, corners, ramps(WAVE_LOG2))
        mm = np.rint(1000 / inverse * (1 + np.float32(self.wave) * waves))
        measured = clean.wanted(0) & (mm <= FARTHEST_MM)
        source = np.where(measured, np.arange(mm.size).reshape(shape), NOTHING)
        return Reading(np.where(measured, mm, 0).astype(np.uint16), source.astype(np.int32))


@numba.njit(cache=True, fastmath=EXACT)
def _draw(image: Float32, corners: Float32, weights: Float32) -> None:
    """Write smooth noise into an image (h, w). corners: of ``lattice``. weights: of ``ramps``."""
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            image[v, u] = smooth(corners, weights, v, u, WAVE_LOG2)
