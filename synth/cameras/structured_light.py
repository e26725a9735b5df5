"""Faults of a structured-light camera, applied to a clean depth image: Kinect v1 and similar cameras."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np

from annotate.array_types import Bool, Float32, Int32, UInt16
from sensors.rig.camera import Intrinsics
from synth.cameras.pixel_random import NORMALS, block_bits, hashed, lattice, ramps, share_of, smooth
from synth.cameras.relief import EDGE_M, FARTHEST_MM, grazed, nearness_of, shadowed
from synth.cameras.sensor import REACH_PX, CleanDepth, Reading, drawn_camera, key_of, strength
from synth.surface.rasterize import EXACT

KINECT1 = Intrinsics(320, 240, 285.63, 285.63, 159.5, 119.5)
"""A Kinect v1 as recordings of people have it: half of 640 x 480."""


@dataclass(frozen=True)
class StructuredLight:
    """A structured-light depth camera's faults, each with its own strength; 0 switches it off.

    step_per_m: depth's steps over its square, 1/m (0.0029: 23 mm at 2.8 m). speckle: standard deviation of
    the disparity in steps, alike within a correlation window. rim_px, ragged_px: by how much silhouettes
    grow, and its standard deviation over blocks. block_log2: logarithm of a block's side in pixels.
    least_px: width below which a person's fingers are lost, 1 for none. shadow: share of the strip hidden
    from the projector, ``baseline_m`` to the right (negative: in a mirrored image), that stays empty.
    grazing, dark: share of blocks lost at 90 degrees of incidence, and where infrared is swallowed. holes:
    share of all blocks lost. melted: share of blocks in which a person and what touches it are exchanged.
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
        """A unit of a model of ``sensors.toml`` and what a tracker leaves of its image; see the class."""
        camera = drawn_camera(entry, rng)
        fine = camera.width // 320
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
        """What the sensor makes of a clean depth image; see ``Sensor.read``.

        Without person nothing melts. What a person touches has to be in the image, or feet stay whole.
        """
        reading, depth = clean.blank(), clean.filled()
        parallax = clean.window.fx * self.baseline_m * self.shadow
        faults = (self.step_per_m, self.speckle, self.rim_px, self.ragged_px, parallax)
        melted = self.melted if clean.person is not None else 0.0
        losses = (self.grazing, self.dark, self.holes, melted)
        reach_px = max(REACH_PX, 2 << self.block_log2) if melted else REACH_PX
        _read(
            depth,
            clean.swallowed(),
            clean.wanted(reach_px),
            clean.shown(self.least_px),
            np.array((*faults, *losses), np.float32),
            self.block_log2,
            nearness_of(depth),
            clean.pinhole(),
            key_of(rng),
            NORMALS,
            ramps(WINDOW_LOG2),
            *reading,
        )
        return reading


NEAREST_MM = 400
"""A Kinect v1 reads nothing nearer (OpenNI, near mode)."""
WINDOW_LOG2 = 2
"""Size of what a correlation window makes alike: 4 pixels. Chosen by eye; the window is 9 of 640 wide."""
MELT_M = 0.06
"""What is no further from a person in depth melts into it: three steps at 2.5 m. Chosen by eye."""


@numba.njit(cache=True, fastmath=EXACT)
def _read(
    depth: Float32, dark: Float32, wanted: Bool, shown: Bool, strengths: Float32, block_log2: int,
    nearness: Float32, pinhole: Float32, key: np.uint64, normals: Float32, weights: Float32,
    depth_mm: UInt16, source: Int32,
) -> None:  # fmt: skip
    """Writes the readings of the wanted pixels into the last two arguments."""
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
                i, j = _melted(depth, shown, y, x, 2 << block_log2, grows)
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
    """The pixel whose surface is read at (v, u): a neighbour's where the rim has grown or shrunk."""
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
def _melted(depth: Float32, shown: Bool, y: int, x: int, reach: int, grows: bool) -> tuple[int, int]:
    """The pixel as whose surface that of (y, x) counts, where the person and what it touches are as far away.

    grows: the person takes the ground; else the ground takes the person, and the row is -1.
    """
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
