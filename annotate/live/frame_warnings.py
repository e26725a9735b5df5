"""Warnings about a frame: its lighting, its person, the colours of the suit, the thermal camera's alignment.

Constants are untuned unless a source is given.
"""

from collections import deque
from collections.abc import Iterator

import numpy as np

from annotate.array_types import Bool, Float64
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.live.warning import LiveWarning
from annotate.person.alignment import TOLERABLE_DEG, is_warmer, misplacement_px, warm_contrasts
from annotate.person.subject import cut_borders
from annotate.person.warmth import WINDOW_C, find_window, warmth
from annotate.suit.color_model import CLIPPED, DARK, ColorModel, blur
from sensors.rig.camera import Intrinsics

# Of a person's colours lost to darkness or glare; below ``annotate.segmentation.segment.BAD_SHARE``.
LOST_SHARE = 0.25
LEAST_PIXELS = 400  # px of a person without warnings, a head at 4 m
LIMB_M, LEAST_LIMB_PX = 0.08, 8.0  # thickness of a forearm (m) and its least pixels: at 3.65 m of a Kinect v2
# Least distance of two suit colours in a frame's light, in standard deviations: 1.7 to 2.5 in the virtual
# rig's `normal` light, at most 1.05 by a sodium lamp (12 frames of six people, seeds 9341 and 9352).
APART = 1.3
EVERY_NS, FRAMES = 500_000_000, 8  # ns between two checks of the alignment, and checks that are averaged


def person_warnings(cloud: ThermalCloud, person: Bool) -> Iterator[LiveWarning]:
    """Yield warnings about bad light, cut borders and distance of a person. person: mask (h, w)."""
    if np.count_nonzero(person) < LEAST_PIXELS:
        return
    yield from _light(cloud, person)
    if borders := cut_borders(person):
        yield LiveWarning(
            "cut off",
            f"the person is cut off at the {' and the '.join(borders)} of the picture: "
            "move the camera back, or turn it",
        )
    far_m = LIMB_M * cloud.camera.fx / LEAST_LIMB_PX
    away_m = float(np.median(cloud.points_m[..., 2][person]))
    if away_m > far_m:
        yield LiveWarning(
            "far", f"the person is {away_m:.1f} m away, too far for this camera: stay within {far_m:.1f} m"
        )


def _shift_warning(shift_px: tuple[float, float], camera: Intrinsics) -> LiveWarning:
    """Return the warning for a thermal image shifted by ``shift_px`` (right, down)."""
    right, down = (float(np.degrees(np.arctan2(px, camera.fx))) for px in shift_px)
    ways = [
        f"{abs(angle):.1f} degrees too far {words[angle < 0]}"
        for angle, words in ((right, ("right", "left")), (down, ("down", "up")))
        if abs(angle) > TOLERABLE_DEG / 3
    ]
    return LiveWarning(
        "shifted",
        f"the thermal camera has moved: temperatures lie {' and '.join(ways)}; "
        "put it back, or calibrate again",
    )


def color_warning(cloud: ThermalCloud, person: Bool, model: ColorModel) -> LiveWarning | None:
    """Return a warning about the two most similar suit colours in this illuminant, None if they differ
    enough.

    person: mask (h, w). model: colours in this frame's illuminant. Pairs that are similar in the palette
    itself are excluded, because the suit's notes report them.
    """
    rgb = cloud.color_rgb[person & cloud.color_valid]
    if len(rgb) < LEAST_PIXELS:
        return None
    cloth = np.flatnonzero(~model.bare)
    part_of = np.array(model.parts)[cloth]
    noise = float(np.median(blur(rgb)))
    now = _apart(model.lit[cloth], model.variance[cloth] + noise**2)
    ever = _apart(model.palette[cloth], model.variance[cloth])
    now[(ever < APART) | (part_of[:, None] == part_of)] = np.inf
    i, j = np.unravel_index(int(now.argmin()), now.shape)
    if now[i, j] >= APART:
        return None
    one, other = (part_of[k].replace("_", " ") for k in (i, j))
    return LiveWarning(
        "colours",
        f"the suit's colours of {one} and {other} are too similar in this light: "
        "use more light, or whiter light",
    )


def _apart(chroma: Float64, variance: Float64) -> Float64:
    """Return the distances (K, K) between colours (K, 2), in standard deviations of their difference."""
    away = np.linalg.norm(chroma[:, None] - chroma[None], axis=-1)
    return np.asarray(away / np.sqrt(variance[:, None] + variance[None]))


def _light(cloud: ThermalCloud, person: Bool) -> Iterator[LiveWarning]:
    rgb = cloud.color_rgb[person & cloud.color_valid]
    if len(rgb) < LEAST_PIXELS:
        return
    dark, glare = (rgb.max(axis=1) < DARK).mean(), ((rgb >= CLIPPED).sum(axis=1) > 1).mean()
    if dark > LOST_SHARE:
        yield LiveWarning(
            "dark",
            f"{dark:.0%} of the person is too dark to read colours: light the room, or expose for longer",
        )
    if glare > LOST_SHARE:
        yield LiveWarning(
            "glare", f"{glare:.0%} of the person is over-exposed: use less light, or a shorter exposure"
        )


class ShiftWatch:
    """Detector of a thermal camera that has moved, by its alignment over the last frames.

    Source of the alignment: ``annotate.person.alignment``.
    """

    def __init__(self) -> None:
        self._surfaces = deque[Float64](maxlen=FRAMES)
        self._checked_ns = 0
        self._warning: LiveWarning | None = None

    def warning(self, cloud: ThermalCloud, person: Bool, now_ns: int) -> LiveWarning | None:
        """Return the warning of the last check, or None; first check this frame if a check is due.

        person: mask (h, w). now_ns: arrival of the frame.
        """
        if now_ns - self._checked_ns >= EVERY_NS and np.isfinite(cloud.temperature_c).any():
            self._checked_ns = now_ns
            surface = warm_contrasts(cloud)
            if surface is not None:
                self._surfaces.append(surface)
            self._warning = self._checked(cloud, person)
        return self._warning

    def _checked(self, cloud: ThermalCloud, person: Bool) -> LiveWarning | None:
        if len(self._surfaces) < FRAMES:
            return None
        shift_px = misplacement_px(np.mean(self._surfaces, axis=0))
        if shift_px is None:
            return None
        warm = warmth(cloud.temperature_c, find_window(cloud, cloud.valid) or WINDOW_C).clip(0, 1)
        return _shift_warning(shift_px, cloud.camera) if is_warmer(warm, person, shift_px) else None
