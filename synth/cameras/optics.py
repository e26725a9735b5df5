"""Lenses of the virtual rig's cameras, and how they render."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from annotate.array_types import Bool, Float64, Int32
from sensors.rig.camera import Intrinsics, distort
from synth.surface.rasterize import ZBuffer, rasterize


class Lens:
    """Renders through a distorting lens: a wider pinhole image, and where each real pixel looks in it.

    supersample: rendered pixels per real pixel side. camera: the real one. maps: x and y of ``cv2.remap``,
    float32, the size of the supersampled real image.
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
        """The wide pinhole image; points (V, 3) in the camera frame, metres."""
        return rasterize(self.pinhole, points.astype(np.float32), faces)

    def render(self, points: Float64, faces: Int32) -> ZBuffer:
        """The image through the lens, every pixel taking the nearest pinhole pixel; blind ones nothing."""
        wide = self.render_pinhole(points, faces)
        u, v = (np.rint(m).astype(np.intp) for m in self.maps)
        depth_m, face = wide.depth_m[v, u], wide.face[v, u]
        depth_m[self._blind], face[self._blind] = np.nan, -1
        return ZBuffer(depth_m, face)


lens_of = lru_cache(maxsize=6)(Lens)
"""Rigs of one kind have the same cameras, and the colour camera's map takes a second."""
LEAST_STEPS, MOST_STEPS, STILL = 12, 100, 1e-5
"""Steps of the inverse lens model, and the move per step, normalised, at which it ends. Chosen by eye."""
ROWS = 16
"""Rows of an image that are worked on at once: half a megabyte of a colour image, which stays in the cache.
Measured: 1.1 s of CPU where the whole image takes 1.7 s."""
WIDEST = 3.0
"""Tangent of the widest view, 143 degrees: all lenses of the rigs are narrower."""


def _undistort_fast(camera: Intrinsics, distorted: Float64) -> tuple[Float64, Bool]:
    """Fixed-point inverse (..., 2) of the lens model, to under 0.01 px; a wide lens takes more steps.

    Also (...): where there is none, in corners beyond a round view.
    """
    radius = np.linspace(0, WIDEST, 1000)
    radial = replace(camera, p1=0.0, p2=0.0)
    beyond = np.diff(distort(radial, np.stack([radius, 0 * radius], axis=-1))[:, 0]) <= 0
    widest = radius[np.argmax(beyond)] if beyond.any() else WIDEST
    ideal, far = distorted.copy(), np.zeros(distorted.shape[:-1], np.bool_)
    blocks = [slice(top, top + ROWS) for top in range(0, len(ideal), ROWS)]
    for step in range(MOST_STEPS):
        moved = [_stepped(camera, distorted[rows], widest, ideal[rows], far[rows]) for rows in blocks]
        if step >= LEAST_STEPS - 1 and max(moved) < STILL:
            break
    return ideal, far


def _stepped(camera: Intrinsics, distorted: Float64, widest: float, ideal: Float64, far: Bool) -> float:
    """Take a step of ``_undistort_fast`` in place; the longest move of what is within the view."""
    move = distorted - distort(camera, ideal)
    ideal += move
    away = np.linalg.norm(ideal, axis=-1)
    np.greater(away, widest, out=far)
    if not far.any():
        return float(np.abs(move).max())
    ideal[far] *= widest / away[far][:, None]
    return float(np.abs(move[~far]).max(initial=0.0))
