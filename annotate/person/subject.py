"""The subject among the persons of a frame, and warnings about its visibility.

Constants are untuned unless a source is given.
"""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Bool, Float64, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.person.detection.finder import Person
from annotate.suit.color_model import STRAY, blur, evenly, fit_illuminant, readable
from annotate.suit.palette import Suit, chromaticity

OFF_CENTRE = 0.3  # tangent off the middle column where a score falls to 1/e; measured: 38 of 38, without 10
BEFORE_GAIN = 4.0  # factor less one for the place of the previous subject
CLEAR_LEAD = 2.0  # least ratio of the best score to the next among three persons and more
EDGE_PX = 4  # width of an image's rim; EDGE_PX^2 pixels on a rim count as cut there


def cloths_shown(suit: Suit, cloud: ThermalCloud, person: Bool) -> float:
    """Return the effective number of the suit's cloths in a person's colours (mask (h, w)), minus one.

    The number is the exponential of the mutual information of colour and swatch in the best illuminant. It is
    high for a suit, low for other clothes and things, 0 for colours lost in noise.
    """
    mask = person & cloud.valid
    rgb = cloud.color_rgb[mask]
    rgb = rgb[readable(rgb, cloud.color_valid[mask])]
    if not len(rgb):
        return 0.0
    rgb = rgb[evenly(len(rgb))]
    match = np.exp(fit_illuminant(suit, rgb).match(chromaticity(rgb), blur(rgb)))
    share = np.concatenate([match, np.full((1, len(rgb)), STRAY)])
    share /= share.sum(axis=0)
    return float(np.exp(_entropy(share.mean(axis=1)) - _entropy(share).mean()) - 1)


def _entropy(share: Float64) -> Float64:
    """Return the entropy (...) in nats of probabilities (K, ...)."""
    return np.asarray(-(share * np.log(np.maximum(share, np.finfo(np.float64).tiny))).sum(axis=0))


def subject_score(person: Person, before: FrameLabels | None, shown: float = 1.0) -> float:
    """Return a person's score as the subject: visible area in m2, weighted by place, previous subject and
    suit.

    shown: number of the suit's cloths on the person, from ``cloths_shown``; 1 without a suit.
    """
    x, _, z = person.centre_m
    score = person.area_m2 * float(np.exp(-np.square(x / z / OFF_CENTRE)))
    if before is not None and before.depth_mm.shape == person.mask.shape:
        score *= 1 + BEFORE_GAIN * float((persons_before(before)[person.mask] == 1).mean())
    return score * shown**2


def persons_before(before: FrameLabels) -> UInt8:
    """Return the persons uint8 (h, w) of a frame's labels: 0 = no person, 1 the subject, others by
    track id.
    """
    return before.on_person.astype(np.uint8) if before.persons is None else before.persons


def crowd_warnings(scores: Sequence[float]) -> list[str]:
    """Return a warning if none of three or more persons has a clearly best score. scores: best first."""
    if len(scores) < 3 or scores[0] >= CLEAR_LEAD * scores[1]:
        return []
    return [
        f"{len(scores)} persons in the depth and thermal images, none clearly the subject: "
        "let the others step aside or aim the cameras at one; parts are undefined"
    ]


def cut_borders(mask: Bool) -> list[str]:
    """Return the names of the image borders that cut a person's mask (h, w)."""
    first, last = slice(EDGE_PX), slice(-EDGE_PX, None)
    strips = {"left": mask[:, first], "right": mask[:, last], "top": mask[first], "bottom": mask[last]}
    return [name for name, strip in strips.items() if np.count_nonzero(strip) >= EDGE_PX**2]


def cut_warnings(mask: Bool) -> list[str]:
    """Return a warning if three or four borders of the image cut the person's mask (h, w)."""
    borders = cut_borders(mask)
    if len(borders) < 3:
        return []
    return [
        f"the person is larger than the depth camera's view (cut at {', '.join(borders)}): "
        "move the camera back; parts are undefined"
    ]
