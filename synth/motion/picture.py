"""Pictures of a body in motion: parts in their colours, shaded, markers as dots, and the floor under it."""

from pathlib import Path

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, Int32, Int64, UInt8
from annotate.parts import PARTS
from sensors.errors import CloudError
from sensors.files.atomic import write_bytes
from sensors.rig.camera import Intrinsics
from synth.body.body import pose
from synth.body.skeleton import Posture
from synth.markers.motion_file import Motion
from synth.markers.person_fit import person_body
from synth.motion.placed import heading_rad
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


SHOWN = 6
"""Moments in a picture."""
FILM_PER_SECOND, LONGEST_S = 15.0, 20.0
"""Pictures a second of an animation, and its length at most: an e-mail's attachment."""
ANIMATIONS = (".webp", ".gif", ".png")
"""Suffixes of animations: every browser shows them."""


def save_picture(path: Path, motion: Motion, markers_m: Float64) -> None:
    """Write moments of a motion with its markers (F, M, 3) on the person, front and side, as PNG."""
    moments = np.unique(np.linspace(0, len(motion) - 1, SHOWN).astype(int))
    rows = [_views(motion, markers_m, moments, azimuth) for azimuth in (0.0, np.pi / 2)]
    image = np.vstack([np.hstack(row) for row in rows])
    _, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    write_bytes(path, data.tobytes())


def check_animation(path: Path) -> None:
    """Raise CloudError for a name without an animation's suffix."""
    if path.suffix.lower() not in ANIMATIONS:
        raise CloudError(f"{path} is no animation; give {', '.join(ANIMATIONS)}")


def save_animation(path: Path, motion: Motion, markers_m: Float64) -> None:
    """Write a motion's beginning with its markers (F, M, 3) on the person, front and side, as an animation.

    Raises CloudError for the name of no animation.
    """
    check_animation(path)
    every = max(1, round(motion.frames_per_second / FILM_PER_SECOND))
    moments = np.arange(0, len(motion), every)[: round(LONGEST_S * FILM_PER_SECOND)]
    front, side = (_views(motion, markers_m, moments, azimuth) for azimuth in (0.0, np.pi / 2))
    pairs = [np.hstack(pair)[..., ::-1] for pair in zip(front, side, strict=True)]
    animation = cv2.Animation()
    animation.frames = [np.ascontiguousarray(pair) for pair in pairs]
    animation.durations = [round(1000 * every / motion.frames_per_second)] * len(moments)
    _, data = cv2.imencodeanimation(path.suffix.lower(), animation)
    write_bytes(path, data.tobytes())


def _views(motion: Motion, markers_m: Float64, moments: Int64, azimuth_rad: float) -> list[UInt8]:
    """Pictures of some frames, seen so far round from the front of the first, the pelvis in the middle."""
    body = person_body(motion.bones_m)
    posed = [pose(body, Posture(motion.angles_rad[f], motion.pelvis_m[f]))[0] for f in moments]
    azimuth = azimuth_rad + heading_rad(motion.angles_rad[moments[0], 0])
    floor = min(float(vertices[:, 2].min()) for vertices in posed)
    views = []
    for f, vertices in zip(moments, posed, strict=True):
        middle = np.array([*motion.pelvis_m[f, :2], floor])
        seen = (vertices - middle).astype(np.float32)
        views.append(portrait(seen, body.faces, body.face_parts, azimuth, markers_m[f] - middle))
    return views
