"""What a Kinect v2 makes of a clean depth image."""

from dataclasses import astuple, dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from annotate.array_types import Bool, Float32
from sensors.rig.camera import Intrinsics
from synth.surface.rasterize import EXACT

Number = np.float32


@dataclass(frozen=True)
class DepthNoise:
    """A time-of-flight depth camera's faults, each with its own strength; 0 switches it off.

    axial: factor on the axial noise of Fankhauser 2015. flying: share of silhouette pixels that mix
    foreground and background. grazing: share lost at an incidence of 90 degrees. dark: share lost on
    hair (low infrared return). lateral_px: jitter of edges. offset_mm and scale: the unit's error.
    """

    axial: float = 1.0
    flying: float = 0.7
    grazing: float = 0.6
    dark: float = 0.35
    lateral_px: float = 0.5
    offset_mm: float = 0.0
    scale: float = 1.0

    @staticmethod
    def sample(rng: np.random.Generator) -> "DepthNoise":
        """A unit and a moment somewhere between good and bad."""
        return DepthNoise(
            axial=rng.uniform(0.5, 2.0),
            flying=rng.uniform(0.2, 1.0),
            grazing=rng.uniform(0.2, 0.9),
            dark=rng.uniform(0.0, 0.7),
            lateral_px=rng.uniform(0.2, 0.8),
            offset_mm=rng.normal(0, 8),
            scale=rng.normal(1, 0.004),
        )


RANGE_MM = (500, 4500)
"""libfreenect2's depth packet processor: valid range, nothing nearer than 500 mm."""
EDGE_DELTA_MM = 50.0
"""Neighbouring readings further apart than this make a silhouette (libfreenect2's close edge delta)."""
CLIP_RAD = np.radians(82.0)
"""The noise model diverges at 90 degrees; its measurements end at about 80."""
FAR_M = 8.0
"""Where nothing is hit, there is a background this far away: out of range, but edges and slopes need it."""
MIXED_M = 0.6
"""A flying pixel floats at most this far behind its foreground."""

_NORMALS = ndtri((np.arange(4096) + 0.5) / 4096)
_NORMALS = (_NORMALS / _NORMALS.std()).astype(np.float32)
"""The normal distribution by its inverse: twelve random bits make a number, 3.7 sigma at most."""


@numba.njit(cache=True, fastmath=EXACT)
def axial_sigma_mm(depth_m: Number, incidence_rad: Number) -> Number:
    """Standard deviation along the ray, millimetres. Source: Fankhauser et al. 2015, Kinect v2, eq. 4."""
    z = depth_m
    theta = min(incidence_rad, np.float32(CLIP_RAD))
    tilt = theta / (np.float32(np.pi / 2) - theta)
    straight = np.float32(1.5) - np.float32(0.5) * z + np.float32(0.3) * z * z
    return np.float32(straight + np.float32(0.1) * z * np.sqrt(z) * tilt * tilt)


def kinect(
    camera: Intrinsics,
    depth_m: Float32,
    dark: Bool | Float32,
    noise: DepthNoise,
    rng: np.random.Generator,
    only: Bool | None = None,
) -> NDArray[np.uint16]:
    """Clean depth (h, w) in metres, NaN = nothing -> noisy uint16 millimetres, 0 = no reading.

    dark: (h, w) how little infrared a pixel returns, 1 or True for hair. only: pixels wanted, the others
    become 0; default all.
    Order as in a real device: edges jitter and mix, then axial noise, then what the driver rejects.
    Randomness is a hash of one number drawn from ``rng`` and the pixel: no pixel depends on another.
    """
    noisy = np.zeros(depth_m.shape, np.uint16)
    wanted = np.ones(depth_m.shape, np.bool_) if only is None else only
    strengths = np.array(astuple(noise), np.float32)
    pinhole = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    key = rng.integers(0, 2**64, dtype=np.uint64)
    filled = np.where(np.isnan(depth_m), np.float32(FAR_M), depth_m)
    _kinect(filled, dark.astype(np.float32), wanted, strengths, pinhole, key, _NORMALS, noisy)
    return noisy


@numba.njit(cache=True, fastmath=EXACT)
def _kinect(
    depth: Float32, dark: Float32, wanted: Bool, strengths: Float32, pinhole: Float32,
    key: np.uint64, normals: Float32, noisy: NDArray[np.uint16],
) -> None:  # fmt: skip
    """Writes the readings of the wanted pixels into ``noisy``."""
    height, width = depth.shape
    axial, flying, grazing, darkness, lateral, offset_mm, scale = strengths
    for v in range(height):
        for u in range(width):
            if not wanted[v, u]:
                continue
            bits = _hash(key, 2 * (v * width + u))
            more = _hash(key, 2 * (v * width + u) + 1)
            # Lateral noise: a pixel reads a neighbour now and then.
            y = v + int(np.rint(normals[bits & np.uint64(4095)] * lateral * np.float32(0.6)))
            x = u + int(
                np.rint(normals[(bits >> np.uint64(12)) & np.uint64(4095)] * lateral * np.float32(0.6))
            )
            y, x = min(max(y, 0), height - 1), min(max(x, 0), width - 1)
            z = depth[y, x]
            near, far, z_u, z_v = _around(depth, y, x)
            theta = _incidence(pinhole, y, x, z, z_u, z_v)
            if far - near > np.float32(EDGE_DELTA_MM / 1000):
                chance = _share(bits >> np.uint64(48))
                if chance < np.float32(0.6) * flying:
                    continue  # rejected by the driver
                if chance < flying:
                    near_share = _share(more) ** np.float32(0.35)
                    z = near * near_share + min(far, near + np.float32(MIXED_M)) * (
                        np.float32(1) - near_share
                    )
            if dark[v, u] > 0 and _share(more >> np.uint64(16)) < darkness * dark[v, u]:
                continue
            slant = theta / np.float32(np.pi / 2)
            slant = slant * slant * slant * slant
            if _share(more >> np.uint64(32)) < grazing * slant * slant:
                continue
            sigma, normal = (
                axial * axial_sigma_mm(z, theta),
                normals[(bits >> np.uint64(24)) & np.uint64(4095)],
            )
            mm = z * np.float32(1000) * scale + offset_mm + sigma * normal
            if RANGE_MM[0] <= mm <= RANGE_MM[1]:
                noisy[v, u] = int(np.rint(mm))


@numba.njit(cache=True, fastmath=EXACT)
def _around(depth: Float32, y: int, x: int) -> tuple[Number, Number, Number, Number]:
    """Nearest and farthest of the 3x3 neighbours; Sobel slopes along u and v, metres a pixel."""
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
def _incidence(pinhole: Float32, v: int, u: int, z: Number, z_u: Number, z_v: Number) -> Number:
    """Angle between the viewing ray and the surface normal, radians, from depth and its slopes at a pixel."""
    fx, fy, cx, cy = pinhole
    x, y = (np.float32(u) - cx) / fx, (np.float32(v) - cy) / fy
    # Normal of the surface (x z, y z, z) over the pixel grid, up to a common positive factor.
    n_x, n_y = -z_u * fx, -z_v * fy
    n_z = z - x * n_x - y * n_y
    square = (n_x * n_x + n_y * n_y + n_z * n_z) * (np.float32(1) + x * x + y * y)
    cosine = abs(n_x * x + n_y * y + n_z) / np.sqrt(square + np.float32(1e-18))
    return np.float32(np.arccos(min(cosine, np.float32(1))))


@numba.njit(cache=True)
def _hash(key: np.uint64, counter: int) -> np.uint64:
    """64 random bits of a key and a counter. Source: splitmix64, Steele et al. 2014."""
    z = np.uint64(key) + np.uint64(counter + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True)
def _share(bits: np.uint64) -> np.float32:
    """The sixteen low bits as a number in [0, 1)."""
    return np.float32(bits & np.uint64(0xFFFF)) * np.float32(1 / 65536)


STRIDE = 12
"""Bounced light is diffuse: it is computed between patches of so many pixels a side."""
MODULATION_HZ = 80e6
"""The middle one of the Kinect v2's three frequencies (libfreenect2's phase unwrapping: 16, 80, 120 MHz)."""
_RAD_PER_M = 4 * np.pi * MODULATION_HZ / 299_792_458


def multipath_m(camera: Intrinsics, depth_m: Float32, reflectance: float) -> Float32:
    """By how much depth (h, w), metres along z, is overestimated; NaN where depth is.

    Every surface is Lambertian with the same reflectance at 860 nm, in [0, 1]; light goes from the camera to
    one surface, on to another and back; the sum's phase at ``MODULATION_HZ`` is what is measured. The lens'
    distortion is left aside. Source: the radiometric model of Jimenez et al. 2014 (Image and Vision
    Computing 32), two bounces.
    """
    height, width = depth_m.shape
    v, u = np.mgrid[STRIDE // 2 : height : STRIDE, STRIDE // 2 : width : STRIDE]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    directions = np.stack([x, y, np.ones(x.shape)], axis=-1).astype(np.float32)
    points = directions * depth_m[v, u, None]
    area = (STRIDE * points[..., 2]) ** 2 / np.float32(camera.fx * camera.fy)
    normals = _normals(points)
    bias = np.zeros(x.shape, np.float32)
    known = np.isfinite(points[..., 2]) & np.isfinite(normals).all(axis=2)
    bias[known] = _bounce(points[known], normals[known], area[known], reflectance)
    bias /= np.linalg.norm(directions, axis=2)
    # Pixel u lies at (u - STRIDE // 2) / STRIDE among the patches.
    shift = -(STRIDE // 2) / STRIDE
    place = np.array([[1 / STRIDE, 0, shift], [0, 1 / STRIDE, shift]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    smooth = cv2.warpAffine(bias, place, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.where(np.isnan(depth_m), np.float32(np.nan), smooth).astype(np.float32)


def _normals(points: Float32) -> Float32:
    """Unit normals (h, w, 3) towards the camera; NaN beside what has no depth."""
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True) + np.float32(1e-12)
    normal *= -np.sign((normal * points).sum(axis=2, keepdims=True))
    return np.asarray(normal, np.float32)


@numba.njit(cache=True, fastmath=EXACT)
def _bounce(points: Float32, normals: Float32, area: Float32, reflectance: float) -> Float32:
    """Mean excess of path length (n,), metres, one way."""
    n = len(points)
    excess = np.zeros(n, np.float32)
    away = np.empty(n)
    lit = np.empty(n)
    for p in range(n):
        x, y, z = points[p]
        away[p] = np.sqrt(x * x + y * y + z * z)
        facing = -(normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z) / away[p]
        # The patch's true area grows as it turns away while the light on it falls: the cosines cancel.
        lit[p] = max(facing, 0.05)
    for p in range(n):
        along, across = 1.0, 0.0
        direct = lit[p] / (away[p] * away[p])
        for q in range(n):
            x, y, z = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1], points[q, 2] - points[p, 2]
            square = x * x + y * y + z * z
            at_p = normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z
            at_q = -(normals[q, 0] * x + normals[q, 1] * y + normals[q, 2] * z)
            if at_p <= 0 or at_q <= 0 or square < 1e-6:
                continue
            # Patches that nearly touch would exceed their own size: solid angle is bounded by their area.
            form = at_p * at_q / square / (np.pi * max(square, area[q]))
            share = reflectance * area[q] / (away[q] * away[q]) * form / direct
            phase = _RAD_PER_M * (away[q] + np.sqrt(square) - away[p]) / 2
            along += share * np.cos(phase)
            across += share * np.sin(phase)
        excess[p] = np.arctan2(across, along) / _RAD_PER_M
    return excess
