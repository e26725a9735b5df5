"""Rendering through the lenses of the virtual rig's cameras."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numba
import numpy as np

from annotate.array_types import Bool, Float64, Int32
from sensors.rig.camera import Distortion, Intrinsics, brown, distort
from synth.surface.rasterize import ZBuffer, rasterize

LEAST_STEPS, MOST_STEPS, STILL = 12, 100, 1e-5  # of the inverse lens model, and the move that ends it
WIDEST = 3.0  # tangent of the widest view, 143 degrees; the rigs' lenses are narrower


class Lens:
    """Distorting lens, simulated by resampling a wider pinhole image ``pinhole``.

    supersample: rendered pixels per pixel side. maps: x and y of ``cv2.remap`` for the supersampled image.
    """

    def __init__(self, camera: Intrinsics, supersample: int) -> None:
        scaled = replace(
            camera,
            width=camera.width * supersample,
            height=camera.height * supersample,
            fx=camera.fx * supersample,
            fy=camera.fy * supersample,
            cx=(camera.cx + 0.5) * supersample - 0.5,
            cy=(camera.cy + 0.5) * supersample - 0.5,
        )
        u, v = np.meshgrid(np.arange(scaled.width), np.arange(scaled.height))
        distorted = np.stack([(u - scaled.cx) / scaled.fx, (v - scaled.cy) / scaled.fy], axis=-1)
        ideal, self._blind = _undistort_fast(scaled, distorted)
        x, y = ideal[..., 0] * scaled.fx + scaled.cx, ideal[..., 1] * scaled.fy + scaled.cy
        left, top = max(0, int(np.ceil(-x.min()))), max(0, int(np.ceil(-y.min())))
        wide = replace(
            scaled.undistorted(),
            width=int(np.ceil(x.max())) + left + 1,
            height=int(np.ceil(y.max())) + top + 1,
            cx=scaled.cx + left,
            cy=scaled.cy + top,
        )
        self.camera, self.pinhole = camera, wide
        self.maps = ((x + left).astype(np.float32), (y + top).astype(np.float32))

    def render_pinhole(self, points: Float64, faces: Int32) -> ZBuffer:
        """Render a mesh with the pinhole camera whose view covers the distorted image. points: (V, 3), camera
        frame, metres.
        """
        return rasterize(self.pinhole, points.astype(np.float32), faces)

    def render(self, points: Float64, faces: Int32) -> ZBuffer:
        """Return the depth and faces of a mesh seen through the lens, from the nearest pinhole pixels."""
        wide = self.render_pinhole(points, faces)
        u, v = (np.rint(m).astype(np.intp) for m in self.maps)
        depth_m, face = wide.depth_m[v, u], wide.face[v, u]
        depth_m[self._blind], face[self._blind] = np.nan, -1
        return ZBuffer(depth_m, face)


lens_of = lru_cache(maxsize=6)(Lens)  # because a colour camera's map takes a quarter of a second


def _undistort_fast(camera: Intrinsics, distorted: Float64) -> tuple[Float64, Bool]:
    """Return undistorted points (..., 2) to 0.01 px, by fixed-point iteration, and flags of points beyond the
    lens model's range.
    """
    radius = np.linspace(0, WIDEST, 1000)
    radial = replace(camera, p1=0.0, p2=0.0)
    beyond = np.diff(distort(radial, np.stack([radius, 0 * radius], axis=-1))[:, 0]) <= 0
    widest = radius[np.argmax(beyond)] if beyond.any() else WIDEST
    ideal, far = distorted.copy(), np.empty(distorted.shape[:-1], np.bool_)
    for step in range(MOST_STEPS):
        move = _step(camera.distortion, distorted, ideal, far, widest)
        if step >= LEAST_STEPS - 1 and move < STILL:
            break
    return ideal, far


_at_point: Callable[[float, float, Distortion], tuple[float, float]] = brown
_distorted = numba.njit(cache=True)(_at_point)


@numba.njit(cache=True)
def _step(lens: Distortion, distorted: Float64, ideal: Float64, far: Bool, widest: float) -> float:
    """Update undistorted points ``ideal`` (h, w, 2) by one iteration and return the largest change.

    far: (h, w), points beyond the model's range, which stay at radius ``widest``.
    """
    most = 0.0
    for v in range(len(ideal)):
        for u in range(ideal.shape[1]):
            x, y = _distorted(ideal[v, u, 0], ideal[v, u, 1], lens)
            right, down = distorted[v, u, 0] - x, distorted[v, u, 1] - y
            x, y = ideal[v, u, 0] + right, ideal[v, u, 1] + down
            radius = np.sqrt(x * x + y * y)
            far[v, u] = radius > widest
            if far[v, u]:
                x, y = x * (widest / radius), y * (widest / radius)
            else:
                most = max(most, abs(right), abs(down))
            ideal[v, u] = x, y
    return most
