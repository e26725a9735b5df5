"""What a Kinect v2 makes of a clean depth image."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera import Intrinsics


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


MIN_RANGE_MM, MAX_RANGE_MM = 500, 4500
"""libfreenect2's depth packet processor: valid range, nothing nearer than 500 mm."""
EDGE_DELTA_MM = 50.0
"""Neighbouring readings further apart than this make a silhouette (libfreenect2's close edge delta)."""
CLIP_RAD = np.radians(82.0)
"""The noise model diverges at 90 degrees; its measurements end at about 80."""


def axial_sigma_mm(depth_m: NDArray[np.float32], incidence_rad: NDArray[np.float32]) -> NDArray[np.float32]:
    """Standard deviation along the ray, millimetres. Source: Fankhauser et al. 2015, Kinect v2, eq. 4."""
    theta = np.minimum(incidence_rad, np.float32(CLIP_RAD))
    tilt = theta * theta / np.square(np.float32(np.pi / 2) - theta)
    z = depth_m
    sigma = 1.5 - 0.5 * z + 0.3 * z * z + 0.1 * np.power(z, 1.5) * tilt
    return np.asarray(sigma, np.float32)


def incidence(camera: Intrinsics, depth_m: NDArray[np.float32], top: int = 0, left: int = 0) -> NDArray[np.float32]:
    """Angle (h, w) between the viewing ray and the surface, radians, from the depth's own gradient.

    ``depth_m`` may be a window of the image whose corner is (top, left). NaN becomes grazing.
    """
    height, width = depth_m.shape
    z = depth_m
    x = (np.arange(left, left + width, dtype=np.float32) - camera.cx) / camera.fx
    y = ((np.arange(top, top + height, dtype=np.float32) - camera.cy) / camera.fy)[:, None]
    z_u = cv2.Sobel(z, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    z_v = cv2.Sobel(z, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    # Normal of the surface (x z, y z, z) over the pixel grid, up to a common positive factor.
    n_x, n_y = -z_u * camera.fx, -z_v * camera.fy
    n_z = z - x * n_x - y * n_y
    ray = np.sqrt(1 + x * x + y * y)
    cosine = (n_x * x + n_y * y + n_z) / (np.sqrt(n_x * n_x + n_y * n_y + n_z * n_z) * ray + 1e-9)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1)).astype(np.float32)
    return np.where(np.isfinite(angle), angle, np.float32(np.pi / 2))


def kinect(
    camera: Intrinsics,
    depth_m: NDArray[np.float32],
    dark: NDArray[np.bool_],
    noise: DepthNoise,
    rng: np.random.Generator,
    top: int = 0,
    left: int = 0,
) -> NDArray[np.uint16]:
    """Clean depth (h, w) in metres, NaN = nothing -> noisy uint16 millimetres, 0 = no reading.

    dark: pixels of low infrared return (hair). ``depth_m`` may be a window whose corner is (top, left).
    Order as in a real device: edges jitter and mix, then axial noise, then what the driver rejects.
    """
    shape = depth_m.shape
    depth = _jitter(depth_m, noise.lateral_px, rng)
    theta = incidence(camera, np.nan_to_num(depth, nan=8.0), top, left)
    depth = _mix_edges(np.where(np.isnan(depth), np.float32(np.nan), depth), noise.flying, rng)
    sigma = noise.axial * axial_sigma_mm(np.nan_to_num(depth), theta)
    depth_mm = depth * (1000 * noise.scale) + noise.offset_mm
    depth_mm = depth_mm + sigma * rng.standard_normal(shape, dtype=np.float32)
    chance = rng.random(shape, dtype=np.float32)
    lost = chance < noise.grazing * np.square(np.clip(theta / np.float32(np.pi / 2), 0, 1)) ** 4
    lost |= dark & (rng.random(shape, dtype=np.float32) < noise.dark)
    lost |= ~np.isfinite(depth_mm) | (depth_mm < MIN_RANGE_MM) | (depth_mm > MAX_RANGE_MM)
    return np.where(lost, 0, np.rint(np.nan_to_num(depth_mm))).astype(np.uint16)


def _jitter(depth: NDArray[np.float32], sigma_px: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Lateral noise: every pixel reads a neighbour now and then."""
    if sigma_px <= 0:
        return depth
    height, width = depth.shape
    shift = np.rint(rng.standard_normal((2, height, width), dtype=np.float32) * np.float32(sigma_px * 0.6))
    v = np.clip(np.arange(height)[:, None] + shift[0].astype(np.intp), 0, height - 1)
    u = np.clip(np.arange(width) + shift[1].astype(np.intp), 0, width - 1)
    return depth[v, u]


def _mix_edges(depth: NDArray[np.float32], share: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Flying pixels: at a silhouette z = a z_near + (1 - a) z_far; some are rejected by the driver."""
    filled = np.nan_to_num(depth, nan=8.0)
    kernel = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(filled, kernel), cv2.dilate(filled, kernel)
    edge = (far - near) * 1000 > EDGE_DELTA_MM
    chance = rng.random(depth.shape, dtype=np.float32)
    share_near = rng.random(depth.shape, dtype=np.float32) ** np.float32(0.35)
    mixed = near * share_near + np.minimum(far, near + 0.6) * (1 - share_near)
    result = np.where(edge & (chance < share), np.where(chance < 0.6 * share, np.float32(np.nan), mixed), depth)
    return result.astype(np.float32)
