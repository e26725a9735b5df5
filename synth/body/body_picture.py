"""Bodies side by side, from the front and from behind: parts in their colours, shaded, and the skeleton."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64, UInt8
from annotate.parts import PARTS
from sensors.files.atomic import write_bytes
from sensors.rig.camera import Intrinsics
from synth.body.body import Body
from synth.body.skeleton import PARENTS
from synth.surface.rasterize import rasterize

MOST_BODIES = 64
"""A picture shows the first of a long list: more would be too small to see."""
_ROW = 8
_TILE = (390, 216)
_FINER = 3
_AWAY_M = 30.0
_SPAN_M = 2.25
_COLOURS = np.array([part.rgb for part in PARTS], np.float32)
_PAPER, _INK = 255, (40, 40, 44)


def picture(bodies: Sequence[Body]) -> UInt8:
    """RGB image (h, w, 3) of up to ``MOST_BODIES`` bodies at rest, eight a row, all to one scale.

    Under each its height, weight and waist breadth.
    """
    shown = bodies[:MOST_BODIES]
    rows = []
    for first in range(0, len(shown), _ROW):
        some = shown[first : first + _ROW]
        views = [np.vstack([_view(body, 1), _view(body, -1), _caption(body)]) for body in some]
        blank = [np.full_like(views[0], _PAPER)] * (min(len(shown), _ROW) - len(some))
        rows.append(np.hstack(views + blank))
    return np.vstack(rows)


def save_picture(path: Path, bodies: Sequence[Body]) -> None:
    """Write ``picture`` as PNG."""
    bgr = np.ascontiguousarray(picture(bodies)[..., ::-1])
    _, data = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    write_bytes(path, data.tobytes())


def _view(body: Body, facing: int) -> UInt8:
    """One body from the front (facing 1) or from behind (-1)."""
    height, width = (_FINER * n for n in _TILE)
    scale = height / _SPAN_M
    camera = Intrinsics(
        width=width, height=height, fx=scale * _AWAY_M, fy=scale * _AWAY_M, cx=width / 2, cy=height / 2
    )
    points = _seen(body.vertices_m, facing)
    face = rasterize(camera, points.astype(np.float32), body.faces, closed=True).face
    a, b, c = (points[body.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    facing_us = np.abs(normals[:, 2]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    lit = _COLOURS[body.face_parts] * (0.45 + 0.55 * facing_us[:, None])
    fine = np.append(lit, [[_PAPER] * 3], axis=0)[face].astype(np.uint8)
    _draw_skeleton(fine, camera, _seen(body.joints_m, facing))
    return np.asarray(cv2.resize(fine, _TILE[::-1], interpolation=cv2.INTER_AREA), np.uint8)


def _seen(points_m: NDArray[np.floating], facing: int) -> Float64:
    """World points (n, 3) in the frame of a camera far away before or behind the body, at half its span."""
    x, y, z = points_m.astype(np.float64).T
    return np.stack([facing * x, 0.48 * _SPAN_M - z, _AWAY_M + facing * y], axis=1)


def _draw_skeleton(image: UInt8, camera: Intrinsics, joints_m: Float64) -> None:
    u = camera.fx * joints_m[:, 0] / joints_m[:, 2] + camera.cx
    v = camera.fy * joints_m[:, 1] / joints_m[:, 2] + camera.cy
    at = [(int(a), int(b)) for a, b in zip(np.rint(u), np.rint(v), strict=True)]
    for colour, extra in ((_INK, 3), ((255, 255, 255), 0)):
        for joint, parent in enumerate(PARENTS):
            if parent >= 0:
                cv2.line(image, at[joint], at[parent], colour, 2 + extra, cv2.LINE_AA)
            cv2.circle(image, at[joint], 4 + extra // 2, colour, cv2.FILLED, cv2.LINE_AA)


def _caption(body: Body) -> UInt8:
    strip = np.full((44, _TILE[1], 3), _PAPER, np.uint8)
    measures = f"{body.height_cm:.1f} cm, {body.weight_kg:.1f} kg, {body.waist_breadth_cm:.1f} cm"
    for text, y in ((body.name[:28], 14), (measures, 32)):
        (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.38, 1)
        left = max(0, (_TILE[1] - wide) // 2)
        cv2.putText(strip, text, (left, y), cv2.FONT_HERSHEY_SIMPLEX, 0.38, _INK, 1, cv2.LINE_AA)
    return strip
