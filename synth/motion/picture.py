"""Pictures of a body in motion: parts in their colours, shaded, markers as dots, and the floor under it."""

from collections.abc import Sequence

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, Int32, UInt8
from annotate.parts import PARTS
from sensors.rig.camera import Intrinsics
from synth.surface.rasterize import rasterize

TILE = (300, 240)
"""Height and width of a picture, pixels."""
SPAN_M, AWAY_M = 2.2, 30.0
"""What a picture's height shows, and distance of a camera so far that all is to one scale."""
_FINER = 2
_COLOURS = np.array([part.rgb for part in PARTS], np.float32)
_PAPER, _FLOOR, _INK = (255, 255, 255), (205, 205, 210), (20, 20, 20)


def portrait(
    vertices_m: Float32,
    faces: Int32,
    face_parts: UInt8,
    azimuth_rad: float = 0.0,
    markers_m: Float64 | None = None,
) -> UInt8:
    """RGB picture (h, w, 3) of a posed body (V, 3) over the origin, seen level from ``azimuth_rad``.

    markers_m: (M, 3), NaN where there is none, drawn before the body even where they are inside.
    """
    height, width = (_FINER * n for n in TILE)
    scale = height / SPAN_M
    focal = scale * AWAY_M
    camera = Intrinsics(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
    points = _seen(vertices_m, azimuth_rad)
    face = rasterize(camera, points.astype(np.float32), faces, closed=False).face
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    facing_us = np.abs(normals[:, 2]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    lit = np.append(_COLOURS[face_parts] * (0.4 + 0.6 * facing_us[:, None]), [_PAPER], axis=0)
    image = lit[face].astype(np.uint8)
    ground = round(height / 2 + scale * 0.46 * SPAN_M)
    image[ground:][face[ground:] < 0] = _FLOOR
    for x, y, z in (
        [] if markers_m is None else _seen(markers_m[np.isfinite(markers_m).all(axis=1)], azimuth_rad)
    ):
        at = (round(focal * x / z + camera.cx), round(focal * y / z + camera.cy))
        cv2.circle(image, at, 3 * _FINER, (255, 255, 255), cv2.FILLED, cv2.LINE_AA)
        cv2.circle(image, at, 2 * _FINER, _INK, cv2.FILLED, cv2.LINE_AA)
    return np.asarray(cv2.resize(image, TILE[::-1], interpolation=cv2.INTER_AREA), np.uint8)


def _seen(points_m: Float32 | Float64, azimuth_rad: float) -> Float64:
    """World points (n, 3) in the frame of a level camera far away; the floor is near the lower edge."""
    x, y, z = points_m.astype(np.float64).T
    s, c = np.sin(azimuth_rad), np.cos(azimuth_rad)
    return np.stack([c * x + s * y, 0.46 * SPAN_M - z, AWAY_M - s * x + c * y], axis=1)


def sheet(pictures: Sequence[UInt8], columns: int) -> UInt8:
    """Pictures of one size in rows of so many."""
    blank = [np.full_like(pictures[0], 255)] * (-len(pictures) % columns)
    tiles = [*pictures, *blank]
    return np.vstack([np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)])
