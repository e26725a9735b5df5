"""Faults of a structured-light camera: Kinect v1 and similar cameras."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np

from annotate.array_types import Bool, Float32
from sensors.rig.camera import Intrinsics
from synth.cameras.pixel_random import NORMALS, block_bits, hashed, lattice, ramps, share_of, smooth
from synth.cameras.relief import EDGE_M, FARTHEST_MM, grazed, shadowed
from synth.cameras.sensor import REACH_PX, CleanDepth, Pixels, Reading, drawn_camera, key_of, strength
from synth.surface.rasterize import EXACT

KINECT1 = Intrinsics(320, 240, 285.63, 285.63, 159.5, 119.5)  # half of 640 x 480
NEAREST_MM = 400  # least reading of a Kinect v1 (OpenNI, near mode)
WINDOW_LOG2 = 2  # size of a correlation window; untuned
MELT_M = 0.06  # step between a person and a surface that melts into it: three steps at 2.5 m; untuned


@dataclass(frozen=True)
class StructuredLight:
    """Structured-light depth camera; 0 switches a fault off.

    step_per_m: depth step divided by squared depth, 1/m. speckle: standard deviation of the disparity in
    steps. rim_px, ragged_px: growth of silhouettes, and its standard deviation over blocks. least_px: width
    of the narrowest limb kept. shadow: empty share of the strip hidden from the projector, ``baseline_m`` to
    the right (negative: mirrored). grazing, dark: share of blocks lost at 90 degrees of incidence, and on
    absorbing surfaces. holes: share of blocks lost. melted: share of blocks in which person and background of
    similar depth are confused.
    """

    step_per_m: float = 0.0029
    speckle: float = 0.3
    rim_px: float = 0.0
    ragged_px: float = 0.4
    block_log2: int = 1
    least_px: int = 1
    shadow: float = 1.0
    grazing: float = 0.5
    dark: float = 0.3
    holes: float = 0.002
    melted: float = 0.0
    baseline_m: float = 0.075
    camera: Intrinsics = KINECT1
    model: str = "kinect-v1"
    kind: ClassVar[str] = "structured light"

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "StructuredLight":
        """Draw the parameters of one camera of the model ``entry`` in ``sensors.toml``."""
        camera = drawn_camera(entry, rng)
        fine = max(1, camera.width // 320)
        mirror = -1 if rng.random() < 0.5 else 1
        return StructuredLight(
            step_per_m=0.0 if rng.random() < 0.1 else float(rng.uniform(*entry["step_per_m"])),
            speckle=strength(rng, 0.6),
            rim_px=fine * float(rng.uniform(-0.8, 0.8)),
            ragged_px=fine * strength(rng, 0.6),
            block_log2=int(rng.integers(fine - 1, fine + 2)),
            least_px=int(rng.integers(1, 3 + fine)),
            shadow=strength(rng, 1.0),
            grazing=strength(rng, 0.9),
            dark=strength(rng, 0.5, absent=0.75),
            holes=strength(rng, 0.01, absent=0.5),
            melted=float(rng.uniform(0.3, 1.0)) if rng.random() < 0.15 else 0.0,
            baseline_m=mirror * entry["baseline_m"],
            camera=camera,
            model=entry["model"],
        )

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """Return the reading of a clean image, as ``Sensor.read``; person and background are confused only
        with ``clean.person``.
        """
        reading = clean.blank()
        parallax = clean.window.fx * self.baseline_m * self.shadow
        faults = (self.step_per_m, self.speckle, self.rim_px, self.ragged_px, parallax)
        melted = self.melted if clean.person is not None else 0.0
        losses = (self.grazing, self.dark, self.holes, melted)
        reach_px = max(REACH_PX, 2 << self.block_log2) if melted else REACH_PX
        strengths = np.array((*faults, *losses), np.float32)
        noise = (key_of(rng), self.block_log2, NORMALS, ramps(WINDOW_LOG2))
        _read(clean.pixels(reach_px, self.least_px), strengths, noise, reading)
        return reading


@numba.njit(cache=True, fastmath=EXACT)
def _read(
    pixels: Pixels, strengths: Float32, noise: tuple[np.uint64, int, Float32, Float32], reading: Reading
) -> None:
    """Write depth and sources to ``reading``. noise: key, block size (log2), ``NORMALS``, window weights."""
    depth, dark, wanted, shown, nearness, pinhole = pixels
    (key, block_log2, normals, weights), (depth_mm, source) = noise, reading
    height, width = depth.shape
    step, speckle, rim, ragged, parallax, grazing, darkness, holes, melted = strengths
    loss_key = hashed(key, 0)
    speckles = lattice(hashed(key, 1), height, width, WINDOW_LOG2, normals)
    for v in range(height):
        for u in range(width):
            if not wanted[v, u]:
                continue
            bits = block_bits(key, v, u, block_log2)
            grown = int(np.rint(rim + ragged * normals[bits & np.uint64(4095)]))
            y, x = _rim(depth, v, u, grown)
            i, j = y, x
            if melted > 0 and share_of(bits >> np.uint64(12)) < melted:
                grows = bool(share_of(bits >> np.uint64(28)) < np.float32(0.5))
                i, j = _melted(depth, shown, (y, x), 2 << block_log2, grows)
            if i < 0 or not shown[i, j]:
                continue
            z = depth[y, x]
            if shadowed(depth, nearness, y, x, parallax):
                continue
            lost = block_bits(loss_key, v, u, block_log2)
            if grazing > 0 and share_of(lost) < grazing * grazed(depth, pinhole, y, x):
                continue
            if share_of(lost >> np.uint64(16)) < darkness * dark[y, x]:
                continue
            if share_of(lost >> np.uint64(32)) < holes:
                continue
            if step > 0:
                steps = np.float32(1) / (step * z) + speckle * smooth(speckles, weights, v, u, WINDOW_LOG2)
                z = np.float32(1) / (step * np.rint(steps))
            mm = np.float32(1000) * z
            if NEAREST_MM <= mm <= FARTHEST_MM:
                depth_mm[v, u] = int(np.rint(mm))
                source[v, u] = i * width + j


@numba.njit(cache=True, fastmath=EXACT)
def _rim(depth: Float32, v: int, u: int, grown: int) -> tuple[int, int]:
    """Return the pixel whose surface is measured at (v, u) if silhouettes grow by ``grown`` pixels (negative:
    shrink).
    """
    z, y, x = depth[v, u], v, u
    if grown == 0:
        return y, x
    reach, sign = min(abs(grown), REACH_PX), np.float32(1 if grown > 0 else -1)
    best = sign * z - np.float32(EDGE_M)
    for k in range(1, reach + 1):
        for dv, du in ((-k, 0), (k, 0), (0, -k), (0, k)):
            i, j = v + dv, u + du
            if 0 <= i < depth.shape[0] and 0 <= j < depth.shape[1] and sign * depth[i, j] < best:
                best, y, x = sign * depth[i, j], i, j
    return y, x


@numba.njit(cache=True, fastmath=EXACT)
def _melted(depth: Float32, shown: Bool, pixel: tuple[int, int], reach: int, grows: bool) -> tuple[int, int]:
    """Return the pixel whose label ``pixel`` takes, where person and background of similar depth are
    confused.

    grows: True if the person takes background pixels; False for the reverse, where a row of -1 is background.
    """
    y, x = pixel
    if shown[y, x] == grows:
        return y, x
    for k in range(1, reach + 1):
        for dv, du in ((-k, 0), (k, 0), (0, -k), (0, k)):
            i, j = y + dv, x + du
            if not (0 <= i < depth.shape[0] and 0 <= j < depth.shape[1]) or shown[i, j] != grows:
                continue
            if abs(depth[i, j] - depth[y, x]) < np.float32(MELT_M):
                return (i, j) if grows else (-1, x)
    return y, x
