"""Causes that make a frame hard, in words, for the truth's notes: results are grouped by them."""

import numpy as np

from annotate.array_types import Bool
from annotate.parts import N_CLASSES
from annotate.suit.palette import MIN_CHROMA_DISTANCE, chromaticity
from sensors.rig.camera import project
from sensors.rig.kinect2_factory import KINECT2_DEPTH
from synth.appearance.color_camera import CameraState
from synth.appearance.outfit import GAMMA, Outfit
from synth.appearance.warmth import SURFACE_C
from synth.rig.stay import Cast, Tableau
from synth.surface.furniture import Surface
from synth.surface.rasterize import ZBuffer

SOFT = (Surface.SOFA, Surface.BED, Surface.PILLOW)
BODY_WARM_C = (25.0, 36.0)
"""Temperatures that a threshold may take for a person's. Chosen by eye."""
SEEN_PX = 150
"""Pixels of something below which it does no harm. Chosen by eye."""
WARM_ROOM_C, DRIFTED_C = 24.0, 1.0
"""Temperature of a warm room; thermal drift that counts. Chosen by eye."""
HIDDEN, OUTSIDE = 0.12, 0.1
"""Shares hidden of the person, and of joints out of view, above which each is noted. Chosen by eye."""
BLUR_M = 0.01
"""A limb that goes farther during the exposure is blurred by 5 colour pixels at 2 m."""
DIM_GAIN = 3.0
"""Gain of the colour camera from which on light is dim. Chosen by eye."""
COLD = 0.5
"""Share of the way to cold hands and feet from which on they are cold. Chosen by eye."""


def scene_hardships(cast: Cast, tableau: Tableau, seen: ZBuffer, alone: ZBuffer) -> list[str]:
    """Causes in the scene. seen: all of it, alone: the subject without what is before it; depth lens."""
    tags, celsius = np.append(cast.tags, 0)[seen.face], np.append(tableau.celsius, -100.0)[seen.face]
    warm = (celsius > BODY_WARM_C[0]) & (celsius < BODY_WARM_C[1])
    own, whole = (tags > 0) & (tags < N_CLASSES), alone.face >= 0
    pixels = project(KINECT2_DEPTH, cast.camera_from_world.apply(tableau.joints_m))
    inside = ((pixels >= 0) & (pixels < (KINECT2_DEPTH.width, KINECT2_DEPTH.height))).all(axis=1)
    causes = {
        "second person": _many(tags == Surface.OTHER_PERSON),
        "warm seat": _many(np.isin(tags, SOFT) & warm),
        "things as warm as a person": _many(np.isin(tags, tuple(SURFACE_C)) & warm),
        "warm room": cast.room_c > WARM_ROOM_C,
        "cold sleeves": bool(cast.clothing.cold_sleeves),
        "cold feet": cast.clothing.cold_feet > COLD,
        "cold hands": cast.clothing.cold_hands > COLD,
        "hidden by things": whole.sum() - own.sum() > HIDDEN * whole.sum(),
        "out of view": inside.mean() < 1 - OUTSIDE,
        "similar colours": _similar(cast.outfits[0]),
    }
    return [cause for cause, there in causes.items() if there]


def camera_hardships(speed_m_s: float, camera: CameraState, drift_c: float) -> list[str]:
    """Causes in the cameras. speed_m_s: of the subject's fastest limb."""
    causes = {
        "motion blur": speed_m_s * camera.exposure_s > BLUR_M,
        "dim light": camera.gain > DIM_GAIN,
        "thermal drift": abs(drift_c) > DRIFTED_C,
    }
    return [cause for cause, there in causes.items() if there]


def _many(pixels: Bool) -> bool:
    return int(np.count_nonzero(pixels)) > SEEN_PX


def _similar(outfit: Outfit) -> bool:
    cloth = chromaticity(255 * np.power(outfit.zone_rgb[1:N_CLASSES], 1 / GAMMA))
    gaps = np.linalg.norm(cloth[:, None] - cloth[None], axis=2)
    return bool(gaps[np.triu_indices(len(cloth), 1)].min() < MIN_CHROMA_DISTANCE)
