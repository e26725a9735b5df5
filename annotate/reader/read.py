"""Labels of a subject by the reader of suits: one way from the cloud to parts, persons and confidence."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, N_CLASSES
from annotate.person.extract import PersonMask, Survey
from annotate.reader.borders import with_borders
from annotate.reader.channels import SEEN, VALID, Rectangle, channels, in_light, rectangle
from annotate.reader.network import Reader
from annotate.reader.segmentation import Segmentation, unlabelled
from annotate.suit.color_model import CLIPPED, ColorModel, readable
from annotate.suit.light import fitted_to
from annotate.suit.palette import Suit

MIN_READABLE_SHARE, BAD_SHARE = 0.05, 0.3
"""Share of a person's points with a readable colour up to which the frame is not read, and share of colours
lost to darkness or glare from which on a note is given. Chosen by eye."""
SAMPLE_M, MOST_SAMPLES = 0.012, 256
"""Metres between two samples of what the network sees, as in its training, so that people have the same size
before every camera; samples along the longer side at most. Chosen by eye, for borders and for speed."""
ROUGH_M, ROUGH_MARGIN_M = 0.012, 0.1
"""Metres between two samples of the rough reading, and around the parts that it shows. Chosen by eye; 0.012
and 0.3 gave no better labels of 128 frames of the virtual rig."""
OTHER_PERSON = N_CLASSES
"""The network's class of another person."""


class View(NamedTuple):
    """What is seen of a subject, in a rectangle around them.

    planes: channels uint8 (24, h, w), likeness not told. rgb: uint8 (h, w, 3). pixels_per_m: at the subject.
    light: the suit's colours in the light that fits all colours of the rough outline best.
    """

    where: Rectangle
    planes: UInt8
    rgb: UInt8
    pixels_per_m: float
    light: ColorModel

    def step(self, sample_m: float) -> int:
        """Pixels between two samples of images that the network sees, ``sample_m`` metres or more apart."""
        longest = max(self.planes.shape[1:])
        return max(1, round(sample_m * self.pixels_per_m), -(-int(longest) // MOST_SAMPLES))


def view_of(
    cloud: ThermalCloud,
    survey: Survey,
    person: PersonMask,
    suit: Suit,
    before: FrameLabels | None,
) -> View | None:
    """View of the subject, arguments as of ``read``; None where hardly a colour of theirs is readable."""
    mask = person.mask & cloud.valid
    rgb = cloud.color_rgb[mask]
    usable = readable(rgb, cloud.color_valid[mask])
    if usable.sum() <= MIN_READABLE_SHARE * len(usable):
        return None
    light, (where, pixels_per_m) = fitted_to(suit, rgb[usable]), rectangle(cloud, mask)
    planes = channels(cloud, survey, person, before, where)
    return View(where, planes, cloud.color_rgb[where], pixels_per_m, light)


def read(
    cloud: ThermalCloud,
    survey: Survey,
    person: PersonMask,
    suit: Suit,
    before: FrameLabels | None,
    reader: Reader,
) -> tuple[Segmentation, PersonMask]:
    """Labels of the subject, and the person with the mask that follows from them.

    survey, person: of the same frame, found without the suit. before: labels of the previous frame. Undefined
    stay all points of a frame without readable colours; a note gives the reason. Colours alone
    may fit a wrong light, and the rectangle is large; so a frame is read roughly first, and then again around
    the parts that this shows, in their light.
    """
    mask = person.mask & cloud.valid
    notes = diagnosis(cloud.color_rgb[mask], cloud.color_valid[mask])
    view = view_of(cloud, survey, person, suit, before)
    if view is None:
        return unlabelled(mask, *notes), person
    near, light = looked_over(view, suit, reader)
    where, step = view.where.part(near), view.step(SAMPLE_M)
    seen = np.zeros(view.rgb.shape[:2], np.bool_)
    seen[::step, ::step], seen[near] = True, True
    chance = reader.probabilities(in_light(view.planes, view.rgb, light, seen), step, near)
    named, sure = with_borders(cloud, where, chance, light)
    own = (named != BACKGROUND) & (named != OTHER_PERSON)
    parts, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
    parts[where] = np.where(own, named, BACKGROUND)
    confidence[where] = np.where(own, sure, 0)
    on_body = parts != BACKGROUND
    persons = np.where(on_body, np.uint8(1), np.where(person.mask, np.uint8(0), person.persons))
    found = Segmentation(parts, confidence, notes, light=light)
    return found, replace(person, mask=on_body, persons=persons)


def looked_over(view: View, suit: Suit, reader: Reader) -> tuple[Rectangle, ColorModel]:
    """Where in a view parts are, read roughly, with some margin, and the suit's colours in their light.

    All of the view, in its own light, where no part is seen.
    """
    step = view.step(ROUGH_M)
    some = slice(None, None, step), slice(None, None, step)
    planes, rgb = view.planes[:, *some], view.rgb[some]
    chance = reader.probabilities(in_light(planes, rgb, view.light), 1)
    own = ((planes[0] & VALID) > 0) & (chance[0] + chance[OTHER_PERSON] < 0.5)
    if not own.any():
        return Rectangle(*(slice(0, side) for side in view.rgb.shape[:2])), view.light
    margin = round(ROUGH_MARGIN_M * view.pixels_per_m)
    near = Rectangle(
        *(_grown(own.any(axis=1 - axis), step, margin, side) for axis, side in enumerate(view.rgb.shape[:2]))
    )
    seen = own & ((planes[0] & SEEN) > 0)
    if not seen.any():
        return near, view.light
    belief = chance[1:N_CLASSES, seen].T.astype(np.float64)
    return near, fitted_to(suit, rgb[seen], belief / belief.sum(axis=1, keepdims=True))


def _grown(seen: Bool, step: int, margin: int, side: int) -> slice:
    """Pixels of a side from the first to the last of samples seen (n,), any, and a margin on both ends."""
    first, last = (int(at) for at in np.flatnonzero(seen)[[0, -1]])
    return slice(max(first * step - margin, 0), min((last + 1) * step + margin, side))


def diagnosis(rgb: UInt8, seen: Bool) -> tuple[str, ...]:
    """Note on colours uint8 (n, 3), defect and remedy; seen: bool (n,), by the camera."""
    if not len(rgb):
        return ("no person: nothing to label",)
    if seen.mean() < MIN_READABLE_SHARE:
        return ("no colour on the person: point the colour camera at them and check its calibration",)
    usable = readable(rgb, seen)
    lost = rgb[seen & ~usable].max(axis=1) < CLIPPED
    if lost.sum() > BAD_SHARE * seen.sum():
        return ("colour is too dark on the person: light the room or raise the colour camera's exposure",)
    if (~lost).sum() > BAD_SHARE * seen.sum():
        return ("colour is over-exposed on the person: lower the colour camera's exposure or the light",)
    return ()
