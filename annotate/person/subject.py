"""The subject among the persons of a frame, and warnings where the frame does not show them well enough."""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Bool, Float64, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND
from annotate.person.finder import Person
from annotate.suit.color_model import STRAY, blur, evenly, readable
from annotate.suit.illuminant import fitted_to
from annotate.suit.palette import Suit, chromaticity

OFF_CENTRE = 0.3
"""Tangent of the angle off the view's middle column at which a score falls to 1/e. Chosen by eye; without it
and without a suit the subject is right in 10 of 38 frames of several people instead of in all (measured)."""
BEFORE_GAIN, CLEAR_LEAD = 4.0, 2.0
"""Factor less one by which standing where the subject stood before raises a score, and least ratio of the
best to the next among three persons and more. Chosen by eye."""
EDGE_PX = 4
"""Width in pixels of an image's rim; who fills as much of a side as a square is cut by it. Chosen by eye."""


def cloths_shown(suit: Suit, cloud: ThermalCloud, person: Bool) -> float:
    """Number of the suit's cloths that a person's (bool (h, w)) colours show, less one; not whole.

    The exponential of the mutual information of colour and swatch, in the light that explains them best: many
    for a suit, few for clothes and for things, none for colours lost in noise, each of which fits everything.
    """
    mask = person & cloud.valid
    rgb = cloud.color_rgb[mask]
    rgb = rgb[readable(rgb, cloud.color_valid[mask])]
    if not len(rgb):
        return 0.0
    rgb = rgb[evenly(len(rgb))]
    match = np.exp(fitted_to(suit, rgb).match(chromaticity(rgb), blur(rgb)))
    share = np.concatenate([match, np.full((1, len(rgb)), STRAY)])
    share /= share.sum(axis=0)
    return float(np.exp(_entropy(share.mean(axis=1)) - _entropy(share).mean()) - 1)


def _entropy(share: Float64) -> Float64:
    """Entropy (...) in nats of shares (K, ...)."""
    return np.asarray(-(share * np.log(np.maximum(share, np.finfo(np.float64).tiny))).sum(axis=0))


def subject_score(person: Person, before: FrameLabels | None, shown: float = 1.0) -> float:
    """Score in m2 of a person as the one to label: surface, near the middle, there before, in the suit.

    before: labels of the previous frame. shown: of ``cloths_shown``, 1 without a suit.
    """
    x, _, z = person.centre_m
    score = person.area_m2 * float(np.exp(-np.square(x / z / OFF_CENTRE)))
    if before is not None and before.depth_mm.shape == person.mask.shape:
        score *= 1 + BEFORE_GAIN * float((persons_before(before)[person.mask] == 1).mean())
    return score * shown**2


def persons_before(before: FrameLabels) -> UInt8:
    """Persons uint8 (h, w) of a frame's labels: 0 nobody, 1 the labelled person, 2 and on others."""
    return np.asarray(before.parts != BACKGROUND, np.uint8) if before.persons is None else before.persons


def crowd_warnings(scores: Sequence[float]) -> list[str]:
    """A warning where none of three or more persons is clearly the subject; scores: best first."""
    if len(scores) < 3 or scores[0] >= CLEAR_LEAD * scores[1]:
        return []
    return [
        f"{len(scores)} persons in the depth and thermal images, none clearly the subject: "
        "let the others step aside or aim the cameras at one; parts are undefined"
    ]


def cut_borders(mask: Bool) -> list[str]:
    """Borders of the image that cut a person's mask (h, w)."""
    first, last = slice(EDGE_PX), slice(-EDGE_PX, None)
    strips = {"left": mask[:, first], "right": mask[:, last], "top": mask[first], "bottom": mask[last]}
    return [name for name, strip in strips.items() if np.count_nonzero(strip) >= EDGE_PX**2]


def cut_warnings(mask: Bool) -> list[str]:
    """A warning where three or four borders of the image cut the person's mask (h, w)."""
    borders = cut_borders(mask)
    if len(borders) < 3:
        return []
    return [
        f"the person is larger than the depth camera's view (cut at {', '.join(borders)}): "
        "move the camera back; parts are undefined"
    ]
