"""Faults of a stereo camera: RealSense, Gemini, OAK."""

from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numba
import numpy as np

from annotate.array_types import Float32
from sensors.rig.camera import Intrinsics
from synth.cameras.pixel_random import NORMALS, chance_of, hashed, lattice, ramps, smooth
from synth.cameras.relief import EDGE_M, FARTHEST_MM, Number, grazed, shadowed
from synth.cameras.sensor import (
    NOTHING,
    REACH_PX,
    CleanDepth,
    Pixels,
    Reading,
    drawn_camera,
    key_of,
    strength,
)
from synth.surface.rasterize import EXACT

D435 = Intrinsics(848, 480, 427.0, 427.0, 423.5, 239.5)  # in the mode recommended by its maker
MATCH_LOG2, WAVE_LOG2 = 2, 4  # sizes of matching windows, and of waves and patches; untuned


@dataclass(frozen=True)
class Stereo:
    """Stereo depth camera; 0 switches a fault off.

    noise_px, wave_px: standard deviations of disparity noise over a matching window and over a wide region.
    fattened_px: growth of silhouettes. steps: disparity steps per pixel, 0 = continuous. shadow: empty share
    of the strip hidden from the second camera, ``baseline_m`` to the right. grazing, dark: share lost at 90
    degrees of incidence, and on absorbing surfaces. patches: share lost in patches without texture. banded:
    True if the whole image shows the left band outside the second camera's view.
    """

    noise_px: float = 0.06
    wave_px: float = 0.05
    fattened_px: float = 1.5
    steps: float = 32
    shadow: float = 1.0
    grazing: float = 0.5
    dark: float = 0.3
    patches: float = 0.0
    baseline_m: float = 0.050
    banded: bool = True
    camera: Intrinsics = D435
    model: str = "realsense-d435"
    kind: ClassVar[str] = "stereo"

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "Stereo":
        """Draw the parameters of a camera of the model ``entry`` in ``sensors.toml``; any fault can be 0."""
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
        """Return the reading of a clean image, as ``Sensor.read``."""
        reading, pixels = clean.blank(), clean.pixels(REACH_PX)
        depth, parallax = pixels.depth, clean.window.fx * self.baseline_m
        side = 2 * REACH_PX + 1
        nearest = np.asarray(cv2.erode(depth, np.ones((side, side), np.uint8)), np.float32)
        faults = (self.noise_px, self.wave_px, self.fattened_px, self.steps, parallax, parallax * self.shadow)
        strengths = np.array((*faults, self.grazing, self.dark, self.patches), np.float32)
        noise = (nearest, NORMALS, ramps(MATCH_LOG2), ramps(WAVE_LOG2))
        _read(pixels, strengths, key_of(rng), noise, reading)
        if self.banded and depth.shape == self.camera.shape:
            alone = parallax / depth > np.arange(depth.shape[1])
            reading.depth_mm[alone], reading.source[alone] = 0, NOTHING
        return reading


@numba.njit(cache=True, fastmath=EXACT)
def _read(
    pixels: Pixels,
    strengths: Float32,
    key: np.uint64,
    noise_tables: tuple[Float32, Float32, Float32, Float32],
    reading: Reading,
) -> None:
    """Write depth and sources to ``reading``.

    noise_tables: nearest depth in reach, ``NORMALS``, weights of windows and waves.
    """
    depth, dark, wanted, shown, nearness, pinhole = pixels
    (nearest, normals, matched, waved), (depth_mm, source) = noise_tables, reading
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
    """Return the pixel of the nearest foreground surface within a radius of (v, u); (v, u) without one."""
    y, x, best = v, u, depth[v, u] - np.float32(EDGE_M)
    reach = min(int(radius), REACH_PX)
    for i in range(max(v - reach, 0), min(v + reach + 1, depth.shape[0])):
        for j in range(max(u - reach, 0), min(u + reach + 1, depth.shape[1])):
            if (i - v) ** 2 + (j - u) ** 2 <= radius * radius and depth[i, j] < best:
                y, x, best = i, j, depth[i, j]
    return y, x
