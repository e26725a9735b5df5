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
from annotate.reader.channels import Rectangle, channels, rectangle, relit
from annotate.reader.network import Reader
from annotate.reader.segmentation import Segmentation, unlabelled
from annotate.suit.color_model import CLIPPED, ColorModel, readable
from annotate.suit.light import fitted_to
from annotate.suit.palette import Suit

MIN_READABLE_SHARE, BAD_SHARE = 0.05, 0.3
"""Share of a person's points with a readable colour up to which the frame is not read, and share of colours
lost to darkness or glare from which on a note is given. Chosen by eye."""
OTHER_PERSON = N_CLASSES
"""The network's class of another person."""


class View(NamedTuple):
    """What the network sees of a subject, in a rectangle.

    planes: channels uint8 (24, h, w). step: pixels between two samples of an image that the network sees.
    light: the suit's colours in the frame's light.
    """

    planes: UInt8
    where: Rectangle
    step: int
    light: ColorModel


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
    light, (where, step) = fitted_to(suit, rgb[usable]), rectangle(cloud, mask)
    return View(channels(cloud, survey, person, light, before, where), where, step, light)


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
    may fit a wrong light; so they are read roughly first, and then in the light of what was read.
    """
    mask = person.mask & cloud.valid
    notes = diagnosis(cloud.color_rgb[mask], cloud.color_valid[mask])
    view = view_of(cloud, survey, person, suit, before)
    if view is None:
        return unlabelled(mask, *notes), person
    where = view.where
    light = _light_of(cloud, view, suit, reader) or view.light
    planes = relit(view.planes, light, cloud.color_rgb[where])
    named, sure = with_borders(cloud, where, reader.probabilities(planes, view.step), light)
    own = (named != BACKGROUND) & (named != OTHER_PERSON)
    parts, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
    parts[where] = np.where(own, named, BACKGROUND)
    confidence[where] = np.where(own, sure, 0)
    on_body = parts != BACKGROUND
    persons = np.where(on_body, np.uint8(1), np.where(person.mask, np.uint8(0), person.persons))
    found = Segmentation(parts, confidence, notes, light=light)
    return found, replace(person, mask=on_body, persons=persons)


def _light_of(cloud: ThermalCloud, view: View, suit: Suit, reader: Reader) -> ColorModel | None:
    """The light of the parts by one image of samples alone; None where nothing coloured is a part in it."""
    some = slice(None, None, view.step), slice(None, None, view.step)
    chance = reader.probabilities(view.planes[:, *some], 1)
    own = cloud.valid[view.where][some] & (chance[0] + chance[OTHER_PERSON] < 0.5)
    rgb = cloud.color_rgb[view.where][some][own]
    usable = readable(rgb, cloud.color_valid[view.where][some][own])
    if not usable.any():
        return None
    belief = chance[1:N_CLASSES, own].T[usable].astype(np.float64)
    return fitted_to(suit, rgb[usable], belief / belief.sum(axis=1, keepdims=True))


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
