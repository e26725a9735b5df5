"""Which of the persons in a frame is the one to label, and whether the frame shows that one well enough."""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Bool
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.person.persons import Person
from annotate.person.previous_mask import persons_before
from annotate.suit.color_model import DARK
from annotate.suit.palette import chromaticity

OFF_CENTRE = 0.3
"""Tangent of the angle off the view's middle column over which a claim to be the subject fades to 1/e:
people are aimed at, half of a Kinect v2's view is 0.7."""
BEFORE_COUNTS = 4.0
"""What a claim gains for standing where the subject was in the frame before."""
CLEAR = 2.0
"""Among three and more, the subject's claim must be that many times the next one's."""
BORDER_PX, CUT_PX = 4, 12
"""So many pixels that near to a border of the image mean that it cuts the person."""
HUE, GREYISH = 0.06, 0.15
"""Side of the cells of chromaticity that count as different colours; so near to the light's it is none."""


def colors_worn(cloud: ThermalCloud, person: Bool, room: Bool) -> float:
    """How many strong colours somebody (h, w) shows: the perplexity of their hues by the share that has any.

    A suit has many, clothes one or two, things none. room: bool (h, w), what shows the light's own colour.
    """
    own, around = (np.flatnonzero(mask & cloud.color_valid) for mask in (person, room))
    rgb, every = cloud.color_rgb.reshape(-1, 3)[own[::4]], cloud.color_rgb.reshape(-1, 3)[around[::29]]
    white = np.median(chromaticity(every), axis=0)
    chroma = chromaticity(rgb[(rgb >= DARK).any(axis=1)])
    strong = chroma[np.linalg.norm(chroma - white, axis=1) > GREYISH]
    if not len(strong):
        return 0.0
    cells = np.unique((strong / HUE).astype(np.int64) @ (1000, 1), return_counts=True)[1]
    share = cells / cells.sum()
    return float(np.exp(-(share * np.log(share)).sum()) * len(strong) / len(chroma))


def claim(person: Person, before: FrameLabels | None, wearing: ThermalCloud | None) -> float:
    """How much speaks for a person being the one to label: surface, near the middle, there before.

    wearing: the cloud where the subject is known to wear the suit: then its many colours count.
    """
    x, _, z = person.centre_m
    claimed = person.area_m2 * float(np.exp(-np.square(x / z / OFF_CENTRE)))
    if before is not None and before.depth_mm.shape == person.mask.shape:
        claimed *= 1 + BEFORE_COUNTS * float((persons_before(before)[person.mask] == 1).mean())
    if wearing is None or not wearing.color_valid.any():
        return claimed
    return claimed * (1 + colors_worn(wearing, person.mask, wearing.valid))


def crowd(persons: Sequence[Person], before: FrameLabels | None, wearing: ThermalCloud | None) -> list[str]:
    """A warning where three or more are there and none is clearly the subject."""
    if len(persons) < 3:
        return []
    first, second = (claim(person, before, wearing) for person in persons[:2])
    if first >= CLEAR * second:
        return []
    return [
        f"{len(persons)} persons in the depth and thermal images, none clearly the subject: "
        "let the others step aside or aim the cameras at one; parts are undefined"
    ]


def cut(mask: Bool) -> list[str]:
    """A warning where three borders of the image or all four cut the person."""
    borders = {
        "left": mask[:, :BORDER_PX],
        "right": mask[:, -BORDER_PX:],
        "top": mask[:BORDER_PX],
        "bottom": mask[-BORDER_PX:],
    }
    borders_cut = [name for name, border in borders.items() if border.sum() >= CUT_PX]
    if len(borders_cut) < 3:
        return []
    return [
        f"the person is larger than the depth camera's view (cut at {', '.join(borders_cut)}): "
        "move the camera back; parts are undefined"
    ]
