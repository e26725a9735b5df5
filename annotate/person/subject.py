"""The subject among the persons of a frame, and warnings where the frame does not show them well enough."""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Bool
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.person.evidence import persons_before
from annotate.person.persons import Person
from annotate.suit.color_model import DARK
from annotate.suit.palette import chromaticity

OFF_CENTRE = 0.3
"""Tangent of the angle off the view's middle column at which a score falls to 1/e: people are aimed at, half
of a Kinect v2's view is 0.7. Chosen by eye."""
BEFORE_GAIN, CLEAR_LEAD = 4.0, 2.0
"""Factor less one by which standing where the subject stood before raises a score, and least ratio of the
best to the next among three persons and more. Chosen by eye."""
EDGE_STRIP_PX, CUT_PX = 4, 12
"""Width in pixels of the strip along a border of the image that counts as touching it, and pixels of a person
in it from which the border cuts them. Chosen by eye."""
HUE_CELL, GREYISH = 0.06, 0.15
"""Side of the cells of chromaticity that count as different colours, and distance from the light's own below
which a colour is none. Chosen by eye."""


def colors_worn(cloud: ThermalCloud, person: Bool, room: Bool) -> float:
    """Number of strong colours on a person: the perplexity of their hues times the share of coloured pixels.

    A suit has many, ordinary clothes one or two, things none. person, room: bool (h, w); the room shows
    the light's own colour.
    """
    own, around = (np.flatnonzero(mask & cloud.color_valid) for mask in (person, room))
    rgb, every = cloud.color_rgb.reshape(-1, 3)[own[::4]], cloud.color_rgb.reshape(-1, 3)[around[::29]]
    white = np.median(chromaticity(every), axis=0)
    chroma = chromaticity(rgb[(rgb >= DARK).any(axis=1)])
    strong = chroma[np.linalg.norm(chroma - white, axis=1) > GREYISH]
    if not len(strong):
        return 0.0
    cells = np.unique((strong / HUE_CELL).astype(np.int64) @ (1000, 1), return_counts=True)[1]
    share = cells / cells.sum()
    return float(np.exp(-(share * np.log(share)).sum()) * len(strong) / len(chroma))


def subject_score(person: Person, before: FrameLabels | None, wearing: ThermalCloud | None) -> float:
    """Score in m2 of a person as the one to label: surface, near the view's middle, there before.

    before: labels of the previous frame. wearing: the cloud if the subject wears a suit, whose many colours
    then count; else None.
    """
    x, _, z = person.centre_m
    score = person.area_m2 * float(np.exp(-np.square(x / z / OFF_CENTRE)))
    if before is not None and before.depth_mm.shape == person.mask.shape:
        score *= 1 + BEFORE_GAIN * float((persons_before(before)[person.mask] == 1).mean())
    if wearing is None or not wearing.color_valid.any():
        return score
    return score * (1 + colors_worn(wearing, person.mask, wearing.valid))


def crowd_warnings(
    persons: Sequence[Person], before: FrameLabels | None, wearing: ThermalCloud | None
) -> list[str]:
    """A warning where none of three or more persons is clearly the subject; persons: best first."""
    if len(persons) < 3:
        return []
    first, second = (subject_score(person, before, wearing) for person in persons[:2])
    if first >= CLEAR_LEAD * second:
        return []
    return [
        f"{len(persons)} persons in the depth and thermal images, none clearly the subject: "
        "let the others step aside or aim the cameras at one; parts are undefined"
    ]


def cut_warnings(mask: Bool) -> list[str]:
    """A warning where three or four borders of the image cut the person's mask (h, w)."""
    first, last = slice(EDGE_STRIP_PX), slice(-EDGE_STRIP_PX, None)
    borders = {"left": mask[:, first], "right": mask[:, last], "top": mask[first], "bottom": mask[last]}
    borders_cut = [name for name, border in borders.items() if border.sum() >= CUT_PX]
    if len(borders_cut) < 3:
        return []
    return [
        f"the person is larger than the depth camera's view (cut at {', '.join(borders_cut)}): "
        "move the camera back; parts are undefined"
    ]
