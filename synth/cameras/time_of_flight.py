"""Faults of a time-of-flight camera: Kinect v2, Azure Kinect, Femto."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numba
import numpy as np

from annotate.array_types import Float32
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.rig.camera import Intrinsics
from synth.cameras.pixel_random import NORMALS, hashed, lattice, ramps, share_of, smooth
from synth.cameras.relief import Number
from synth.cameras.sensor import CleanDepth, Pixels, Reading, drawn_camera, key_of, strength
from synth.surface.rasterize import EXACT

NEAR_CLEAN = 0.25  # share of units with noise alone; untuned
EDGE_DELTA_MM = 50.0  # step that makes a silhouette (libfreenect2's close edge delta)
CLIP_RAD = np.radians(82.0)  # because the noise model diverges at 90 degrees; it was measured up to 80
MIXED_M = 0.6  # greatest distance of a flying pixel behind its foreground
PATCH_EDGE = (0.8, 1.6)  # smooth noise at a patch's rim and middle; untuned


@dataclass(frozen=True)
class TimeOfFlight:
    """Time-of-flight depth camera; 0 switches a fault off.

    axial: factor on the noise of Fankhauser 2015. flying: share of silhouette pixels that mix foreground and
    background. rejected: share of mixed pixels without a reading. grazing, dark: share lost at 90 degrees of
    incidence, and on absorbing surfaces. lateral_px: jitter of edges. offset_mm, scale: constant depth error
    of the device. patches: share lost in the middle of patches of 2^patch_log2 pixels a side.
    """

    axial: float = 1.0
    flying: float = 0.7
    grazing: float = 0.6
    dark: float = 0.35
    lateral_px: float = 0.5
    offset_mm: float = 0.0
    scale: float = 1.0
    rejected: float = 0.6
    patches: float = 0.0
    patch_log2: int = 3
    range_mm: tuple[int, int] = (500, 4500)
    camera: Intrinsics = KINECT2_PINHOLE
    model: str = "kinect-v2"
    kind: ClassVar[str] = "time of flight"

    @staticmethod
    def kinect2(rng: np.random.Generator) -> "TimeOfFlight":
        """Draw a Kinect v2 of the paper's presets; every fault is above 0."""
        return TimeOfFlight(
            axial=rng.uniform(0.5, 2.0),
            flying=rng.uniform(0.2, 1.0),
            grazing=rng.uniform(0.2, 0.9),
            dark=rng.uniform(0.0, 0.7),
            lateral_px=rng.uniform(0.2, 0.8),
            offset_mm=rng.normal(0, 8),
            scale=rng.normal(1, 0.004),
        )

    @staticmethod
    def sample(rng: np.random.Generator, entry: dict[str, Any]) -> "TimeOfFlight":
        """Draw the parameters of one camera of the model ``entry`` in ``sensors.toml``; every fault can be 0.

        Hair loses readings in few images, and patches of any surface in more images, so that holes do not
        identify hair.
        """
        bad = strength(rng, 1.0, absent=NEAR_CLEAN)
        return TimeOfFlight(
            axial=strength(rng, 2.0),
            flying=bad * strength(rng, 1.0),
            grazing=bad * strength(rng, 0.9),
            dark=bad * strength(rng, 0.7, absent=0.75),
            lateral_px=bad * strength(rng, 0.8),
            offset_mm=float(rng.normal(0, 8)),
            scale=float(rng.normal(1, 0.004)),
            patches=bad * strength(rng, 1.0, absent=0.6),
            patch_log2=int(rng.integers(2, 6)),
            range_mm=tuple(entry["range_mm"]),
            camera=drawn_camera(entry, rng),
            model=entry["model"],
        )

    @staticmethod
    def azure_kinect(rng: np.random.Generator, entry: dict[str, Any]) -> "TimeOfFlight":
        """Draw an Azure Kinect or Orbbec Femto: a third of a Kinect v2's noise, half its jitter at edges, few
        mixed pixels.
        """
        drawn = TimeOfFlight.sample(rng, entry)
        flying = 1.0 if rng.random() < 0.5 else drawn.flying
        axial, lateral_px = drawn.axial / 3, drawn.lateral_px / 2
        return replace(drawn, axial=axial, flying=flying, lateral_px=lateral_px, rejected=0.95)

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """Return the depth reading of a clean image, as ``Sensor.read``."""
        reading = clean.blank()
        losses = (self.flying, self.rejected, self.grazing, self.dark, self.patches)
        errors = (self.axial, self.lateral_px, self.offset_mm, self.scale)
        strengths = np.array((*losses, *errors, *self.range_mm), np.float32)
        noise = (key_of(rng), self.patch_log2, NORMALS, ramps(self.patch_log2))
        _read(clean.pixels(), strengths, noise, reading)
        return reading


@numba.njit(cache=True, fastmath=EXACT)
def axial_sigma_mm(depth_m: Number, incidence_rad: Number) -> Number:
    """Return the standard deviation of depth along the ray, mm (Fankhauser et al. 2015, Kinect v2, eq. 4)."""
    z = depth_m
    theta = min(incidence_rad, np.float32(CLIP_RAD))
    tilt = theta / (np.float32(np.pi / 2) - theta)
    straight = np.float32(1.5) - np.float32(0.5) * z + np.float32(0.3) * z * z
    return np.float32(straight + np.float32(0.1) * z * np.sqrt(z) * tilt * tilt)


@numba.njit(cache=True, nogil=True, fastmath=EXACT)
def _read(
    pixels: Pixels, strengths: Float32, noise: tuple[np.uint64, int, Float32, Float32], reading: Reading
) -> None:
    """Write depth and sources into ``reading``. noise: key, patch size (log2), ``NORMALS``, patch weights."""
    depth, dark, wanted, shown, _, pinhole = pixels
    (key, log2, normals, weights), (depth_mm, source) = noise, reading
    height, width = depth.shape
    flying, rejected, grazing, darkness, patches = strengths[:5]
    axial, lateral, offset_mm, scale, nearest_mm, farthest_mm = strengths[5:]
    patch = lattice(hashed(key, 2 * height * width), height, width, log2, normals)
    for v in range(height):
        for u in range(width):
            if not wanted[v, u]:
                continue
            bits = hashed(key, 2 * (v * width + u))
            more = hashed(key, 2 * (v * width + u) + 1)
            # Lateral noise: some pixels read a neighbour.
            y = v + int(np.rint(normals[bits & np.uint64(4095)] * lateral * np.float32(0.6)))
            aside = normals[(bits >> np.uint64(12)) & np.uint64(4095)]
            x = u + int(np.rint(aside * lateral * np.float32(0.6)))
            y, x = min(max(y, 0), height - 1), min(max(x, 0), width - 1)
            if not shown[y, x]:
                continue
            z = depth[y, x]
            near, far, z_u, z_v = _around(depth, y, x)
            theta = _incidence(pinhole, (y, x), z, z_u, z_v)
            if far - near > np.float32(EDGE_DELTA_MM / 1000):
                chance = share_of(bits >> np.uint64(48))
                if chance < rejected * flying:
                    continue  # rejected by the driver
                if chance < flying:
                    near_share = share_of(more) ** np.float32(0.35)
                    behind = min(far, near + np.float32(MIXED_M))
                    z = near * near_share + behind * (np.float32(1) - near_share)
            if dark[v, u] > 0 and share_of(more >> np.uint64(16)) < darkness * dark[v, u]:
                continue
            slant = theta / np.float32(np.pi / 2)
            slant = slant * slant * slant * slant
            if share_of(more >> np.uint64(32)) < grazing * slant * slant:
                continue
            if patches > 0:
                rim, middle = np.float32(PATCH_EDGE[0]), np.float32(PATCH_EDGE[1])
                inner = (smooth(patch, weights, v, u, log2) - rim) / (middle - rim)
                if share_of(more >> np.uint64(48)) < patches * inner:
                    continue
            sigma = axial * axial_sigma_mm(z, theta)
            normal = normals[(bits >> np.uint64(24)) & np.uint64(4095)]
            mm = z * np.float32(1000) * scale + offset_mm + sigma * normal
            if nearest_mm <= mm <= farthest_mm:
                depth_mm[v, u] = int(np.rint(mm))
                source[v, u] = y * width + x


@numba.njit(cache=True, fastmath=EXACT)
def _around(depth: Float32, y: int, x: int) -> tuple[Number, Number, Number, Number]:
    """Return the least and greatest of 3x3 depths, and Sobel slopes along u and v, metres per pixel."""
    above, below = max(y - 1, 0), min(y + 1, depth.shape[0] - 1)
    left, right = max(x - 1, 0), min(x + 1, depth.shape[1] - 1)
    a, b, c = depth[above, left], depth[above, x], depth[above, right]
    d, e, f = depth[y, left], depth[y, x], depth[y, right]
    g, h, i = depth[below, left], depth[below, x], depth[below, right]
    z_u = (c - a + i - g + f - d + f - d) * np.float32(0.125)
    z_v = (g - a + i - c + h - b + h - b) * np.float32(0.125)
    near = min(min(min(a, b, c), min(d, e, f)), min(g, h, i))
    far = max(max(max(a, b, c), max(d, e, f)), max(g, h, i))
    return near, far, z_u, z_v


@numba.njit(cache=True, fastmath=EXACT)
def _incidence(pinhole: Float32, pixel: tuple[int, int], z: Number, z_u: Number, z_v: Number) -> Number:
    """Return the angle, radians, between viewing ray and surface normal, from depth and its slopes."""
    (v, u), (fx, fy, cx, cy) = pixel, pinhole
    x, y = (np.float32(u) - cx) / fx, (np.float32(v) - cy) / fy
    # Normal of the surface (x z, y z, z), up to a positive factor.
    n_x, n_y = -z_u * fx, -z_v * fy
    n_z = z - x * n_x - y * n_y
    square = (n_x * n_x + n_y * n_y + n_z * n_z) * (np.float32(1) + x * x + y * y)
    cosine = abs(n_x * x + n_y * y + n_z) / np.sqrt(square + np.float32(1e-18))
    return np.float32(np.arccos(min(cosine, np.float32(1))))
