"""Faults of a stereo camera, applied to a clean depth image: RealSense, Gemini, OAK."""

from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numba
import numpy as np

from annotate.array_types import Bool, Float32, Int32, UInt16
from sensors.rig.camera import Intrinsics
from synth.cameras.pixel_random import NORMALS, chance_of, hashed, lattice, ramps, smooth
from synth.cameras.relief import EDGE_M, FARTHEST_MM, Number, grazed, nearness_of, shadowed
from synth.cameras.sensor import NOTHING, REACH_PX, CleanDepth, Reading, drawn_camera, key_of, strength
from synth.surface.rasterize import EXACT

D435 = Intrinsics(848, 480, 427.0, 427.0, 423.5, 239.5)
"""A RealSense D435 in the mode that its maker recommends."""


@dataclass(frozen=True)
class Stereo:
    """A stereo depth camera's faults, each with its own strength; 0 switches it off.

    In its whole image, the band at the left that the other eye does not see is empty.

    noise_px, wave_px: standard deviations of the disparity over a matching window and over a wide region.
    fattened_px: by how much silhouettes grow. steps: of disparity a pixel, 0 for any. shadow: share of the
    strip hidden from the other eye, ``baseline_m`` to the right, that stays empty. grazing, dark: share lost
    at 90 degrees of incidence, and where infrared is swallowed. patches: share lost in patches without
    texture. All losses are blobs as large as the matching window, patches larger.
    """

    noise_px: float = 0.06
    wave_px: float = 0.05
    fattened_px: float = 1.5
    steps: int = 32
    shadow: float = 1.0
    grazing: float = 0.5
    dark: float = 0.3
    patches: float = 0.0
    baseline_m: float = 0.050
    camera: Intrinsics = D435
    model: str = "realsense-d435"
    kind: ClassVar[str] = "stereo"

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "Stereo":
        """A unit of a model of ``sensors.toml`` with more or fewer filters; every strength reaches zero."""
        return Stereo(
            noise_px=strength(rng, 0.12),
            wave_px=strength(rng, 0.12),
            fattened_px=strength(rng, 3.0),
            steps=entry["steps"],
            shadow=strength(rng, 1.0),
            grazing=strength(rng, 0.9),
            dark=strength(rng, 0.5, absent=0.75),
            patches=strength(rng, 0.1, absent=0.5),
            baseline_m=entry["baseline_m"],
            camera=drawn_camera(entry, rng),
            model=entry["model"],
        )

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """What the sensor makes of a clean depth image; see ``Sensor.read``."""
        reading, depth = clean.blank(), clean.filled()
        parallax = clean.window.fx * self.baseline_m
        side = 2 * REACH_PX + 1
        faults = (self.noise_px, self.wave_px, self.fattened_px, self.steps, parallax, parallax * self.shadow)
        _read(
            depth,
            np.asarray(cv2.erode(depth, np.ones((side, side), np.uint8)), np.float32),
            clean.swallowed(),
            clean.wanted(REACH_PX),
            clean.shown(),
            np.array((*faults, self.grazing, self.dark, self.patches), np.float32),
            nearness_of(depth),
            clean.pinhole(),
            key_of(rng),
            NORMALS,
            ramps(MATCH_LOG2),
            ramps(WAVE_LOG2),
            *reading,
        )
        if depth.shape == self.camera.shape:
            alone = parallax / depth > np.arange(depth.shape[1])
            reading.depth_mm[alone], reading.source[alone] = 0, NOTHING
        return reading


MATCH_LOG2, WAVE_LOG2 = 2, 4
"""Sizes of what a matching window makes alike, 4 pixels, of waves on flat walls and of patches without
texture, 16. Chosen by eye."""


@numba.njit(cache=True, fastmath=EXACT)
def _read(
    depth: Float32, nearest: Float32, dark: Float32, wanted: Bool, shown: Bool, strengths: Float32,
    nearness: Float32, pinhole: Float32, key: np.uint64, normals: Float32, matched: Float32,
    waved: Float32, depth_mm: UInt16, source: Int32,
) -> None:  # fmt: skip
    """Writes the readings of the wanted pixels into the last two arguments."""
    height, width = depth.shape
    noise, wave, fattened, steps, parallax, hidden, grazing, darkness, patches = strengths
    fine = lattice(hashed(key, 0), height, width, MATCH_LOG2, normals)
    rims = lattice(hashed(key, 1), height, width, MATCH_LOG2, normals)
    blobs = lattice(hashed(key, 4), height, width, MATCH_LOG2, normals)
    waves = lattice(hashed(key, 2), height, width, WAVE_LOG2, normals)
    spots = lattice(hashed(key, 3), height, width, WAVE_LOG2, normals)
    for v in range(height):
        for u in range(width):
            if not wanted[v, u]:
                continue
            y, x = v, u
            if fattened > 0 and depth[v, u] - nearest[v, u] > np.float32(EDGE_M):
                uneven = np.float32(1) + np.float32(0.4) * smooth(rims, matched, v, u, MATCH_LOG2)
                y, x = _fattened(depth, v, u, fattened * uneven)
            if not shown[y, x] or shadowed(depth, nearness, y, x, hidden):
                continue
            z = depth[y, x]
            blob = smooth(blobs, matched, v, u, MATCH_LOG2)
            steep = grazing * grazed(depth, pinhole, y, x) if grazing > 0 else np.float32(0)
            if chance_of(blob) < max(steep, darkness * dark[y, x]):
                continue
            ragged = np.float32(0.9) * smooth(spots, waved, v, u, WAVE_LOG2) + np.float32(0.44) * blob
            if chance_of(ragged) < patches:
                continue
            disparity = parallax / z + noise * smooth(fine, matched, v, u, MATCH_LOG2)
            disparity += wave * smooth(waves, waved, v, u, WAVE_LOG2)
            if steps > 0:
                disparity = np.rint(disparity * steps) / steps
            mm = np.float32(1000) * parallax / max(disparity, np.float32(0.1))
            if mm <= FARTHEST_MM:
                depth_mm[v, u] = int(np.rint(mm))
                source[v, u] = y * width + x


@numba.njit(cache=True, fastmath=EXACT)
def _fattened(depth: Float32, v: int, u: int, radius: Number) -> tuple[int, int]:
    """The nearest surface's pixel within a radius of (v, u), if it is another surface."""
    y, x, best = v, u, depth[v, u] - np.float32(EDGE_M)
    reach = min(int(radius), REACH_PX)
    for i in range(max(v - reach, 0), min(v + reach + 1, depth.shape[0])):
        for j in range(max(u - reach, 0), min(u + reach + 1, depth.shape[1])):
            if (i - v) ** 2 + (j - u) ** 2 <= radius * radius and depth[i, j] < best:
                y, x, best = i, j, depth[i, j]
    return y, x
