"""Colours of all points: by part, camera colour, temperature, depth, confidence or disagreement.

Parts are shown over other colourings as outlines and as a tint. Constants are untuned.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int64, UInt8
from annotate.cloud.color_map import COLD_C, HEAT, HOT_C, heat_rgb, mapped_rgb
from annotate.gui.state.scene import FrameScene
from annotate.scheme.scheme import BACKGROUND

Colouring = Literal["part", "colour", "temperature", "depth", "confidence", "disagreement"]
Visibility = Literal["shown", "faded", "hidden"]
Rgb = tuple[int, int, int]
Colors = Callable[[Int64], UInt8]
"""Colours (n, 3) of flat pixels (n,)."""

ROOM_RGB = {True: (74, 80, 92), False: (168, 174, 184)}  # background on a dark (True) and on a light ground
DIFFERS_RGB, SAME_RGB = np.array([(255, 176, 32), (110, 126, 150)], np.float32)  # points to check, and others
FADE = 0.82  # share of the ground's colour in a faded part
TINTS = (0.0, 0.25, 0.5, 0.8)  # shares of the parts' colours over other colourings
MAPS = {"temperature": HEAT, "depth": cv2.COLORMAP_CIVIDIS}


@dataclass(frozen=True)
class Look:
    """Colouring of a view. outlines: draw the parts' outlines. tint: opacity of the parts' colours over other
    colourings, one of TINTS.
    """

    colouring: Colouring = "part"
    outlines: bool = True
    tint: float = 0.0


def colourings(scene: FrameScene) -> tuple[Colouring, ...]:
    """Return the colourings for which the frame has data; "part" always, and first."""
    has: dict[Colouring, bool] = {
        "part": True,
        "colour": bool(scene.cloud.color_valid.any()),
        "temperature": bool(np.isfinite(scene.cloud.temperature_c).any()),
        "depth": True,
        "confidence": scene.labels.confidence is not None,
        "disagreement": scene.other is not None,
    }
    return tuple(name for name, there in has.items() if there)


def edges(parts: UInt8, valid: Bool) -> Bool:
    """Return flags (h, w) of body pixels beside another label. valid: bool (h, w), pixels with depth."""
    differs = np.zeros(parts.shape, np.bool_)
    down = (parts[1:] != parts[:-1]) & valid[1:] & valid[:-1]
    across = (parts[:, 1:] != parts[:, :-1]) & valid[:, 1:] & valid[:, :-1]
    differs[1:] |= down
    differs[:-1] |= down
    differs[:, 1:] |= across
    differs[:, :-1] |= across
    return np.asarray(differs & (parts != BACKGROUND))


@dataclass
class Painting:
    """Function from pixels to colours, for the current state of a frame.

    parts: uint8 (h, w). before: uint8 (h, w), labels whose outlines are drawn too, or None. visibility: of
    parts that are not fully shown. ground: background colour, with which faded parts are blended.
    """

    scene: FrameScene
    parts: UInt8
    look: Look
    visibility: Mapping[int, Visibility]
    ground: Rgb
    before: UInt8 | None = None

    @cached_property
    def _edges(self) -> Bool:
        return edges(self.parts, self.scene.labels.depth_mm > 0).ravel()

    @cached_property
    def _edges_before(self) -> Bool:
        assert self.before is not None
        # Without gaps, because the depth of the frame before is not at hand.
        whole = np.asarray(cv2.medianBlur(self.before, 5), np.uint8)
        return edges(whole, np.ones(whole.shape, np.bool_)).ravel()

    @cached_property
    def _palette(self) -> Float32:
        palette = self.scene.labels.scheme.palette_rgb().astype(np.float32)
        palette[BACKGROUND] = self._room_rgb
        return palette

    @property
    def _room_rgb(self) -> Float32:
        return np.array(ROOM_RGB[sum(self.ground) < 3 * 128], np.float32)

    def __call__(self, pixels: Int64) -> UInt8:
        """Return the colours (n, 3) of flat pixels (n,); pixels without a value are grey like the room."""
        scene, look = self.scene, self.look
        colouring = look.colouring if look.colouring in colourings(scene) else "part"
        part = self.parts.ravel()[pixels]
        rgb = self._plain(part, pixels, colouring)
        if colouring != "colour":
            least = np.where(part == BACKGROUND, np.float32(0.78), np.float32(0.42))
            rgb *= (least + (1 - least) * scene.shade[pixels])[:, None]
        if colouring != "part":
            body = part != BACKGROUND
            rgb[body] += np.float32(look.tint) * (self._palette[part[body]] - rgb[body])
            if look.outlines:
                edge = self._edges[pixels]
                rgb[edge] = self._palette[part[edge]]
        if self.before is not None:
            edge = self._edges_before[pixels]
            rgb[edge] = 0.4 * rgb[edge] + 0.6 * (255 - np.array(self.ground, np.float32))
        for faded in (p for p, how in self.visibility.items() if how == "faded"):
            rgb[part == faded] += FADE * (np.array(self.ground, np.float32) - rgb[part == faded])
        return np.clip(rgb, 0, 255, out=rgb).astype(np.uint8)

    def _plain(self, part: UInt8, pixels: Int64, colouring: Colouring) -> Float32:
        scene, room_rgb = self.scene, self._room_rgb
        if colouring == "colour":
            rgb = scene.cloud.color_rgb.reshape(-1, 3)[pixels].astype(np.float32)
            return np.where(scene.cloud.color_valid.ravel()[pixels, None], rgb, room_rgb)
        if colouring == "temperature":
            celsius = scene.cloud.temperature_c.ravel()[pixels]
            return heat_rgb(celsius, room_rgb)
        if colouring == "depth":
            near_m, far_m = scene.depth_range_m
            depth_m = scene.labels.depth_mm.ravel()[pixels].astype(np.float32) / np.float32(1000)
            return mapped_rgb((far_m - depth_m) / (far_m - near_m), MAPS["depth"], room_rgb)
        if colouring == "confidence" and scene.labels.confidence is not None:
            doubt = np.sqrt(1 - np.clip(scene.labels.confidence.ravel()[pixels], 0, 1))[:, None]
            rgb = (1 - doubt) * SAME_RGB + doubt * DIFFERS_RGB
            return np.where((part == BACKGROUND)[:, None], room_rgb, rgb)
        if colouring == "disagreement" and scene.other is not None:
            other = scene.other.ravel()[pixels]
            rgb = np.where((part != other)[:, None], DIFFERS_RGB, SAME_RGB)
            return np.where(((part == BACKGROUND) & (other == BACKGROUND))[:, None], room_rgb, rgb)
        return np.asarray(self._palette[part])


def legend(scene: FrameScene, colouring: Colouring) -> tuple[str, str, UInt8] | None:
    """Return the texts at both ends of a colouring's scale, and its colours (n, 3) from the first to the
    second.

    None for a colouring without a scale, or without data in the frame: the view shows parts instead.
    """
    if colouring not in colourings(scene):
        return None
    if colouring in ("confidence", "disagreement"):
        ends = ("sure", "unsure") if colouring == "confidence" else ("same", "differs")
        mix = np.linspace(0, 1, 64)[:, None]
        return *ends, np.asarray((1 - mix) * SAME_RGB + mix * DIFFERS_RGB).astype(np.uint8)
    if colouring not in MAPS:
        return None
    near_m, far_m = scene.depth_range_m
    ends = (f"{COLD_C:.0f} °C", f"{HOT_C:.0f} °C")
    if colouring == "depth":
        ends = (f"{far_m:.1f} m", f"{near_m:.1f} m")
    share = np.linspace(0, 1, 64, dtype=np.float32)
    return *ends, mapped_rgb(share, MAPS[colouring], np.zeros(3, np.float32)).astype(np.uint8)
