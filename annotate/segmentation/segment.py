"""Labels of a subject by the reader of suits: one way from the cloud to parts, persons and confidence."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.coarse import enlarged
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, N_CLASSES
from annotate.person.extract import PersonMask, Survey
from annotate.segmentation.border_refinement import with_borders
from annotate.segmentation.flip_averaging import read_twice
from annotate.segmentation.input_channels import (
    SEEN,
    VALID,
    Rectangle,
    channels,
    in_light,
    rectangle,
    with_before,
)
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.segmentation.suit_network import Reader
from annotate.suit.color_model import CLIPPED, ColorModel, readable, refit_colors, under, unfitted
from annotate.suit.illuminant import fitted_to
from annotate.suit.palette import Suit

MIN_READABLE_SHARE, BAD_SHARE = 0.05, 0.3
"""Share of a person's points with a readable colour up to which the frame is not read, and share of colours
lost to darkness or glare from which on a note is given. Chosen by eye."""
SAMPLE_M, MOST_SAMPLES = 0.012, 256
"""Metres between two samples of what the network sees, as in its training, so that people have the same size
before every camera; samples along the longer side at most. Chosen by eye, for borders and for speed."""
ROUGH_M, ROUGH_MARGIN_M = 0.018, 0.1
"""Metres between two samples of a rough reading in a light that is known, and around the parts that it shows.
Of 0.012, 0.018 and 0.024 the last costs 0.001 of the recall of 128 frames; by colours alone it costs 0.01."""
SAME_LIGHT, WORN_SHARE = 0.1, 0.7
"""Difference of log gains up to which it is the light of the frame before, and least share of the colours
that their parts wear in it. Chosen by eye."""
LIGHT, MOST_GAIN = "light", 2.0
"""Name of the note of a frame's log gains of red and blue, and the highest one that is believed."""
OTHER_PERSON = N_CLASSES
"""The network's class of another person."""


class View(NamedTuple):
    """What is seen of a subject, in a rectangle around them.

    planes: channels uint8 (24, h, w), the likeness still 0. rgb: uint8 (h, w, 3). pixels_per_m: at the
    subject. colors: readable ones uint8 (n, 3) of the rough outline. kept: the suit's colours in the light of
    the frame before, if that was read.
    """

    where: Rectangle
    planes: UInt8
    rgb: UInt8
    pixels_per_m: float
    colors: UInt8
    kept: ColorModel | None = None

    def after(self, before: FrameLabels | None, suit: Suit) -> "View":
        """The same with the labels of the frame before, if any, and the suit's colours in its light."""
        if before is None:
            return self
        planes = with_before(self.planes, before, self.where)
        return self._replace(planes=planes, kept=_kept(suit, before))

    def step(self, sample_m: float) -> int:
        """Pixels between two samples of images that the network sees, ``sample_m`` metres or more apart."""
        longest = max(self.planes.shape[1:])
        return max(1, round(sample_m * self.pixels_per_m), -(-int(longest) // MOST_SAMPLES))


def view_of(cloud: ThermalCloud, survey: Survey, person: PersonMask) -> View | None:
    """View of the subject before any other frame; None where hardly a colour of theirs is readable.

    survey, person: of the same frame, found without the suit.
    """
    mask = person.mask & cloud.valid
    rgb = cloud.color_rgb[mask]
    usable = readable(rgb, cloud.color_valid[mask])
    if usable.sum() <= MIN_READABLE_SHARE * len(usable):
        return None
    where, pixels_per_m = rectangle(cloud, mask)
    planes = channels(cloud, survey, person, where)
    return View(where, planes, cloud.color_rgb[where], pixels_per_m, rgb[usable])


def _kept(suit: Suit, before: FrameLabels) -> ColorModel | None:
    """The suit's colours in the light that a frame's labels tell, if they do."""
    gains = before.notes.get(LIGHT)
    if not isinstance(gains, list) or [type(gain) for gain in gains] != [float, float]:
        return None
    return under(unfitted(suit), np.array(gains)) if all(abs(gain) <= MOST_GAIN for gain in gains) else None


def read(
    cloud: ThermalCloud,
    view: View | None,
    person: PersonMask,
    suit: Suit,
    before: FrameLabels | None,
    reader: Reader,
    *,
    glance: bool = False,
) -> tuple[Segmentation, PersonMask]:
    """Labels of the subject, and the person with the mask that follows from them.

    view: of the person, who was found without the suit. before: labels of the previous frame. All points of a
    frame without readable colours stay undefined; a note gives the reason. Colours alone may fit a wrong
    light, and the rectangle is large; so a frame is read roughly first, and then again around the parts that
    this shows, in their light. glance: every second pixel or so alone, for a live picture.
    """
    mask = person.mask & cloud.valid
    notes = diagnosis(cloud.color_rgb[mask], cloud.color_valid[mask])
    if view is None:
        return unlabelled(mask, *notes), person
    view = view.after(before, suit)
    near, light = looked_over(view, suit, reader)
    where, named, sure = (_at_a_glance if glance else finely)(cloud, view, near, light, reader)
    own = (named != BACKGROUND) & (named != OTHER_PERSON)
    parts, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
    parts[where] = np.where(own, named, BACKGROUND)
    confidence[where] = np.where(own, sure, 0)
    on_body = parts != BACKGROUND
    persons = np.where(on_body, np.uint8(1), np.where(person.mask, np.uint8(0), person.persons))
    found = Segmentation(parts, confidence, notes, light=light)
    return found, replace(person, mask=on_body, persons=persons)


def finely(
    cloud: ThermalCloud, view: View, near: Rectangle, light: ColorModel | None, reader: Reader
) -> tuple[Rectangle, UInt8, Float32]:
    """Where a view was read; the class (h, w) of each pixel there, and its probability (h, w).

    near: what is read of the view. light: the suit's colours in the frame's light; None = no suit.
    """
    where, step, planes = view.where.part(near), view.step(SAMPLE_M), view.planes
    if light is not None:
        seen = np.zeros(view.rgb.shape[:2], np.bool_)
        seen[::step, ::step], seen[near] = True, True
        planes = in_light(planes, view.rgb, light, seen)
    return where, *with_borders(cloud, where, read_twice(reader, planes, step, near), light)


def _at_a_glance(
    cloud: ThermalCloud, view: View, near: Rectangle, light: ColorModel, reader: Reader
) -> tuple[Rectangle, UInt8, Float32]:
    """As ``finely``, of one image of samples: other pixels are as the nearest sample of their surface."""
    step = view.step(SAMPLE_M)
    some = slice(None, None, step), slice(None, None, step)
    samples = Rectangle(*(slice(own.start // step, -(-own.stop // step)) for own in near))
    chance = reader.probabilities(in_light(view.planes[:, *some], view.rgb[some], light), 1, samples)
    near = Rectangle(*(slice(own.start - own.start % step, own.stop) for own in near))
    where = view.where.part(near)
    depth_mm = np.ascontiguousarray(cloud.depth_mm[where])
    pixel = np.arange(depth_mm.size).reshape(depth_mm.shape)[some]
    pixel = np.where(depth_mm[some] > 0, pixel, -1)
    named = enlarged(depth_mm, pixel, chance.argmax(axis=0).astype(np.uint8), step)
    sure = chance.max(axis=0).repeat(step, axis=0).repeat(step, axis=1)
    return where, named, sure[: named.shape[0], : named.shape[1]]


def looked_over(view: View, suit: Suit, reader: Reader) -> tuple[Rectangle, ColorModel]:
    """Where in a view parts are, read roughly, with some margin, and the suit's colours in their light.

    The light of the frame before is kept where the parts seen in it tell the same one and wear its colours.
    Else they are read in the light that fits all colours of the outline.
    """
    if view.kept is not None:
        near, rgb, belief = _rough(view, view.kept, ROUGH_M, reader)
        if len(rgb):
            light = refit_colors(view.kept, rgb, belief)
            moved = np.abs(light.log_gain - view.kept.log_gain).max()
            if moved < SAME_LIGHT and light.worn(rgb, belief) > WORN_SHARE:
                return near, light
    light = fitted_to(suit, view.colors)
    near, rgb, belief = _rough(view, light, SAMPLE_M, reader)
    return near, fitted_to(suit, rgb, belief) if len(rgb) else light


def _rough(
    view: View, light: ColorModel, sample_m: float, reader: Reader
) -> tuple[Rectangle, UInt8, Float64]:
    """Where parts are by one image of samples in a light; their colours (n, 3), and beliefs in parts (n, 11).

    All of the view where no part is seen.
    """
    step = view.step(sample_m)
    some = slice(None, None, step), slice(None, None, step)
    planes, rgb = view.planes[:, *some], view.rgb[some]
    chance = reader.probabilities(in_light(planes, rgb, light), 1)
    own = ((planes[0] & VALID) > 0) & (chance[0] + chance[OTHER_PERSON] < 0.5)
    shape, margin = view.rgb.shape[:2], round(ROUGH_MARGIN_M * view.pixels_per_m)
    near = Rectangle(*(slice(0, side) for side in shape))
    if own.any():
        sides = (_grown(own.any(axis=1 - axis), step, margin, side) for axis, side in enumerate(shape))
        near = Rectangle(*sides)
    seen = own & ((planes[0] & SEEN) > 0)
    belief = chance[1:N_CLASSES, seen].T.astype(np.float64)
    return near, rgb[seen], belief / belief.sum(axis=1, keepdims=True)


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
