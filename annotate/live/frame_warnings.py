"""Complaints about a picture: its light, its person, and the colours of their suit."""

from collections.abc import Iterator

import numpy as np

from annotate.array_types import Bool, Float64
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.live.warning import LiveWarning
from annotate.parts import PARTS
from annotate.person.subject import cut_borders
from annotate.suit.color_model import CLIPPED, DARK, ColorModel, blur
from sensors.rig.camera import Intrinsics

LOST_SHARE = 0.25
"""Share of a person's colours lost to darkness or glare from which it is said: somewhat before a suit cannot
be read (``annotate.segmentation.segment.BAD_SHARE``). Untuned."""
LEAST_PIXELS = 400
"""Pixels of a person below which nothing is said of them. Untuned: a head at 4 m."""
LIMB_M, LEAST_LIMB_PX = 0.08, 8.0
"""Thickness of a forearm, and the pixels that it should have in the depth image: at 3.65 m of a Kinect v2.
Untuned."""
APART = 1.3
"""Least distance of two suit colours in the light of a frame, in standard deviations of both together: there
the colour alone takes a quarter of the pixels for the other. Untuned: it is 1.7 to 2.5 in the virtual
rig's `normal` light, up to 1.05 there by a sodium lamp (12 frames of six people, seeds 9341 and 9352)."""


def person_warnings(cloud: ThermalCloud, person: Bool) -> Iterator[LiveWarning]:
    """Complaints about the light on a person and their place; person: mask (h, w)."""
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
            "far", f"the person is {away_m:.1f} m away: more than {far_m:.1f} m is too far for this camera"
        )


def shift_warning(shift_px: tuple[float, float], camera: Intrinsics, tolerable_deg: float) -> LiveWarning:
    """The thermal image lies ``shift_px`` (right, down) off the depth image."""
    right, down = (float(np.degrees(np.arctan2(px, camera.fx))) for px in shift_px)
    ways = [
        f"{abs(angle):.1f} degrees too far {words[angle < 0]}"
        for angle, words in ((right, ("right", "left")), (down, ("down", "up")))
        if abs(angle) > tolerable_deg / 3
    ]
    return LiveWarning(
        "shifted",
        f"the thermal camera has moved: temperatures lie {' and '.join(ways)}; "
        "put it back, or calibrate again",
    )


def color_warning(cloud: ThermalCloud, person: Bool, model: ColorModel) -> LiveWarning | None:
    """The pair of suit colours that are hardest to tell apart in this light, if that is too hard.

    person: mask (h, w), read by the suit. model: its colours in the light of this frame. Pairs that are alike
    in the palette itself are the suit's own fault, which its notes say.
    """
    rgb = cloud.color_rgb[person & cloud.color_valid]
    if len(rgb) < LEAST_PIXELS:
        return None
    cloth = np.flatnonzero(~model.bare)
    part_of = model.wears[cloth].argmax(axis=1) + 1
    noise = float(np.median(blur(rgb)))
    now = _apart(model.lit[cloth], model.variance[cloth] + noise**2)
    ever = _apart(model.palette[cloth], model.variance[cloth])
    now[(ever < APART) | (part_of[:, None] == part_of)] = np.inf
    i, j = np.unravel_index(int(now.argmin()), now.shape)
    if now[i, j] >= APART:
        return None
    one, other = (PARTS[int(part_of[k])].name.replace("_", " ") for k in (i, j))
    return LiveWarning(
        "colours",
        f"the suit's colours of {one} and {other} cannot be told apart in this light: "
        "use more light, or whiter light",
    )


def _apart(chroma: Float64, variance: Float64) -> Float64:
    """Distances (K, K) of colours (K, 2) in standard deviations of both."""
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
