"""The colours of all points: by part, camera colour, temperature, confidence or disagreement, shaded."""

from collections.abc import Mapping
from typing import Literal

import cv2
import numpy as np

from annotate.array_types import Float32, Int64, UInt8
from annotate.gui.scene import FrameScene
from annotate.parts import BACKGROUND, palette_rgb

Colouring = Literal["part", "colour", "temperature", "confidence", "disagreement"]
Visibility = Literal["shown", "faded", "hidden"]
Rgb = tuple[int, int, int]

ROOM_RGB = {True: (74, 80, 92), False: (168, 174, 184)}
"""Colours of background points on a dark (True) and on a light ground. Chosen by eye."""
DIFFERS_RGB, SAME_RGB = np.array([(255, 176, 32), (110, 126, 150)], np.float32)
"""Colours of points to check, where two sets differ or confidence is low, and of others. Chosen by eye."""
COLD_C, HOT_C = 18.0, 38.0
"""Range of the temperature colours in degrees Celsius: from a cool room to a body's core. Chosen by eye."""
FADE = 0.82
"""Share of the ground's colour in a faded part. Chosen by eye."""


def colourings(scene: FrameScene) -> tuple[Colouring, ...]:
    """The colourings for which the frame has data; "part" always, and first."""
    has: dict[Colouring, bool] = {
        "part": True,
        "colour": bool(scene.cloud.color_valid.any()),
        "temperature": bool(np.isfinite(scene.cloud.temperature_c).any()),
        "confidence": scene.labels.confidence is not None,
        "disagreement": scene.other is not None,
    }
    return tuple(name for name, there in has.items() if there)


def point_colors(
    scene: FrameScene,
    parts: UInt8,
    pixels: Int64,
    colouring: Colouring,
    visibility: Mapping[int, Visibility],
    ground: Rgb,
) -> UInt8:
    """Colours (n, 3) of flat ``pixels`` (n,) under the part ids ``parts`` (h, w) of this moment.

    visibility: of parts that are not fully shown. ground: the colour behind, into which faded parts blend.
    Points without a value for the colouring are grey like the room.
    """
    part = parts.ravel()[pixels]
    dark = sum(ground) < 3 * 128
    rgb = _plain(scene, part, pixels, colouring, np.array(ROOM_RGB[dark], np.float32))
    if colouring != "colour":
        least = np.where(part == BACKGROUND, np.float32(0.78), np.float32(0.42))
        rgb *= (least + (1 - least) * scene.shade[pixels])[:, None]
    for faded in (p for p, how in visibility.items() if how == "faded"):
        rgb[part == faded] += FADE * (np.array(ground, np.float32) - rgb[part == faded])
    return np.clip(rgb, 0, 255).astype(np.uint8)


def _plain(scene: FrameScene, part: UInt8, pixels: Int64, colouring: Colouring, room_rgb: Float32) -> Float32:
    if colouring == "part":
        palette = palette_rgb().astype(np.float32)
        palette[BACKGROUND] = room_rgb
        return np.asarray(palette[part])
    if colouring == "colour":
        rgb = scene.cloud.color_rgb.reshape(-1, 3)[pixels].astype(np.float32)
        return np.where(scene.cloud.color_valid.ravel()[pixels, None], rgb, room_rgb)
    if colouring == "temperature":
        celsius = scene.cloud.temperature_c.ravel()[pixels]
        return _mapped((celsius - COLD_C) / (HOT_C - COLD_C), cv2.COLORMAP_INFERNO, room_rgb)
    if colouring == "confidence" and scene.labels.confidence is not None:
        doubt = np.sqrt(1 - np.clip(scene.labels.confidence.ravel()[pixels], 0, 1))[:, None]
        rgb = (1 - doubt) * SAME_RGB + doubt * DIFFERS_RGB
        return np.where((part == BACKGROUND)[:, None], room_rgb, rgb)
    if colouring == "disagreement" and scene.other is not None:
        other = scene.other.ravel()[pixels]
        rgb = np.where((part != other)[:, None], DIFFERS_RGB, SAME_RGB)
        return np.where(((part == BACKGROUND) & (other == BACKGROUND))[:, None], room_rgb, rgb)
    return np.tile(room_rgb, (len(pixels), 1))


def _mapped(share: Float32, colormap: int, missing_rgb: Float32) -> Float32:
    """Colours of values in [0, 1] on one of OpenCV's maps; NaN gets ``missing_rgb``."""
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8).reshape(-1, 1), colormap)[:, 0, ::-1]
    index = np.clip(np.nan_to_num(share) * 255, 0, 255).astype(np.uint8)
    return np.where(np.isnan(share)[:, None], missing_rgb, table[index].astype(np.float32))
