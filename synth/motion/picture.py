"""Pictures of a body in motion: parts in their colours, markers as dots, and the floor under it."""

from pathlib import Path

import cv2
import numpy as np

from annotate.array_types import Float64, Int64, UInt8
from sensors.files.atomic import check_suffix, write_bytes
from synth.body.body import pose
from synth.body.body_picture import INK, PAPER, draw_body
from synth.body.body_picture import save_picture as save_png
from synth.body.skeleton import Posture
from synth.markers.motion_file import Motion
from synth.markers.person_fit import person_body
from synth.motion.placed import heading_rad

TILE = (300, 240)  # height and width of a view, pixels
SHOWN = 6  # moments in a picture
FILM_PER_SECOND, LONGEST_S = 15.0, 20.0  # of an animation: an e-mail's attachment
ANIMATIONS = (".webp", ".gif", ".png")
_AZIMUTHS = (0.0, np.pi / 2)  # front and side


def save_picture(path: Path, motion: Motion, markers_m: Float64) -> None:
    """Write a PNG of some frames of a motion with its markers (F, M, 3), in front and side view."""
    moments = np.unique(np.linspace(0, len(motion) - 1, SHOWN).astype(int))
    rows = [_views(motion, markers_m, moments, azimuth) for azimuth in _AZIMUTHS]
    save_png(path, np.vstack([np.hstack(row) for row in rows]))


def save_animation(path: Path, motion: Motion, markers_m: Float64) -> None:
    """Write an animation of a motion's beginning with its markers (F, M, 3), in front and side view.

    Raises CloudError for another suffix than ``ANIMATIONS``.
    """
    check_suffix(path, *ANIMATIONS)
    every = max(1, round(motion.frames_per_second / FILM_PER_SECOND))
    moments = np.arange(0, len(motion), every)[: round(LONGEST_S * FILM_PER_SECOND)]
    front, side = (_views(motion, markers_m, moments, azimuth) for azimuth in _AZIMUTHS)
    pairs = [np.hstack(pair)[..., ::-1] for pair in zip(front, side, strict=True)]
    animation = cv2.Animation()
    animation.frames = [np.ascontiguousarray(pair) for pair in pairs]
    animation.durations = [round(1000 * every / motion.frames_per_second)] * len(moments)
    _, data = cv2.imencodeanimation(path.suffix.lower(), animation)
    write_bytes(path, data.tobytes())


def _views(motion: Motion, markers_m: Float64, moments: Int64, azimuth_rad: float) -> list[UInt8]:
    body = person_body(motion.bones_m)
    posed = [pose(body, Posture(motion.angles_rad[f], motion.pelvis_m[f]))[0] for f in moments]
    azimuth = azimuth_rad + heading_rad(motion.angles_rad[moments[0], 0])
    floor = min(float(vertices[:, 2].min()) for vertices in posed)
    views = []
    for f, vertices in zip(moments, posed, strict=True):
        middle = np.array([*motion.pelvis_m[f, :2], floor])
        canvas = draw_body(body, (vertices - middle).astype(np.float32), azimuth, TILE)
        markers = markers_m[f][np.isfinite(markers_m[f]).all(axis=1)] - middle
        for at in canvas.pixels(markers):
            canvas.dot(at, 9, PAPER)
            canvas.dot(at, 6, INK)
        views.append(canvas.reduced())
    return views
