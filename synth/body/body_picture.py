"""Pictures of bodies: parts in their colours, shaded, in a nearly orthographic front view."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, UInt8
from annotate.scheme.scheme_file import load_scheme
from sensors.files.atomic import write_bytes
from sensors.rig.camera import Intrinsics
from synth.body.body import Body
from synth.body.skeleton import PARENTS
from synth.surface.rasterize import rasterize

MOST_BODIES = 64  # the picture shows the first of a longer list
TILE = (390, 216)  # height and width of a body's picture, pixels
PAPER, INK, FLOOR = (255, 255, 255), (40, 40, 44), (205, 205, 210)
SPAN_M, AWAY_M = 2.25, 30.0  # shown height, and distance of the camera
FLOOR_SHARE = 0.48  # of the span, floor below the middle
_ROW, _FINER = 8, 3
_COLOURS = load_scheme("paper").palette_rgb().astype(np.float32)


@dataclass(frozen=True)
class Canvas:
    """Picture (h, w, 3) of a person turned by an azimuth, ``_FINER`` times too large for anti-aliasing."""

    image: UInt8
    azimuth_rad: float

    @property
    def camera(self) -> Intrinsics:
        height, width = self.image.shape[:2]
        focal = height / SPAN_M * AWAY_M
        return Intrinsics(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)

    def seen(self, points_m: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the coordinates (n, 3) of world points (n, 3) in the camera frame."""
        x, y, z = points_m.astype(np.float64).T
        s, c = np.sin(self.azimuth_rad), np.cos(self.azimuth_rad)
        return np.stack([c * x + s * y, FLOOR_SHARE * SPAN_M - z, AWAY_M - s * x + c * y], axis=1)

    def pixels(self, points_m: NDArray[np.floating]) -> list[tuple[int, int]]:
        camera = self.camera
        x, y, z = self.seen(points_m).T
        u, v = np.rint(camera.fx * x / z + camera.cx), np.rint(camera.fy * y / z + camera.cy)
        return [(int(a), int(b)) for a, b in zip(u, v, strict=True)]

    def dot(self, at: tuple[int, int], radius: int, rgb: tuple[int, int, int]) -> None:
        cv2.circle(self.image, at, radius, rgb, cv2.FILLED, cv2.LINE_AA)

    def reduced(self) -> UInt8:
        height, width = (n // _FINER for n in self.image.shape[:2])
        return np.asarray(cv2.resize(self.image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def draw_body(body: Body, vertices_m: Float32, azimuth_rad: float, tile: tuple[int, int]) -> Canvas:
    """Draw a posed body (V, 3) at the origin on the floor z = 0, over a strip of floor. tile: size in
    pixels.
    """
    canvas = Canvas(np.empty((_FINER * tile[0], _FINER * tile[1], 3), np.uint8), azimuth_rad)
    points = canvas.seen(vertices_m)
    face = rasterize(canvas.camera, points.astype(np.float32), body.faces).face
    a, b, c = (points[body.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    frontal = np.abs(normals[:, 2]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    lit = np.append(_COLOURS[body.face_parts] * (0.4 + 0.6 * frontal[:, None]), [PAPER], axis=0)
    canvas.image[:] = lit[face]
    ground = round((0.5 + FLOOR_SHARE) * len(canvas.image))
    canvas.image[ground:][face[ground:] < 0] = FLOOR
    return canvas


def picture(bodies: Sequence[Body]) -> UInt8:
    """Return an image of up to ``MOST_BODIES`` bodies at rest, from front and back, with their measures."""
    shown = bodies[:MOST_BODIES]
    rows = []
    for first in range(0, len(shown), _ROW):
        some = shown[first : first + _ROW]
        views = [np.vstack([_view(body, 0.0), _view(body, np.pi), _caption(body)]) for body in some]
        blank = [np.full_like(views[0], PAPER)] * (min(len(shown), _ROW) - len(some))
        rows.append(np.hstack(views + blank))
    return np.vstack(rows)


def save_picture(path: Path, image: UInt8) -> None:
    """Write an RGB image (h, w, 3) as PNG."""
    bgr = np.ascontiguousarray(image[..., ::-1])
    _, data = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    write_bytes(path, data.tobytes())


def _view(body: Body, azimuth_rad: float) -> UInt8:
    canvas = draw_body(body, body.vertices_m, azimuth_rad, TILE)
    at = canvas.pixels(body.joints_m)
    for colour, extra in ((INK, 3), (PAPER, 0)):
        for joint, parent in enumerate(PARENTS):
            if parent >= 0:
                cv2.line(canvas.image, at[joint], at[parent], colour, 2 + extra, cv2.LINE_AA)
            canvas.dot(at[joint], 4 + extra // 2, colour)
    return canvas.reduced()


def _caption(body: Body) -> UInt8:
    strip = np.full((44, TILE[1], 3), PAPER, np.uint8)
    measures = f"{body.height_cm:.1f} cm, {body.weight_kg:.1f} kg, {body.waist_breadth_cm:.1f} cm"
    for text, y in ((body.name[:28], 14), (measures, 32)):
        (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.38, 1)
        left = max(0, (TILE[1] - wide) // 2)
        cv2.putText(strip, text, (left, y), cv2.FONT_HERSHEY_SIMPLEX, 0.38, INK, 1, cv2.LINE_AA)
    return strip
