"""Label a subject by the suit network: from the cloud to parts, persons and confidence.

Constants are untuned unless a source is given.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.coarse import nearest_labels
from annotate.cloud.pieces import unsure_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import PAPER
from annotate.person.extract import PersonDetection, PersonMask
from annotate.scheme.merging import converts
from annotate.scheme.scheme import BACKGROUND, Scheme
from annotate.segmentation.bare_sides import settle_sides
from annotate.segmentation.border_refinement import by_color, refine_borders
from annotate.segmentation.input_channels import (
    SEEN,
    VALID,
    Rectangle,
    channels,
    fitted_to,
    rectangle,
    with_before,
    with_likelihoods,
)
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.segmentation.suit_network import SuitNetwork, flip_averaged, other_person
from annotate.suit.color_model import (
    CLIPPED,
    ColorModel,
    fit_illuminant,
    readable,
    refit_colors,
    under,
    unfitted,
)
from annotate.suit.palette import Suit

MIN_READABLE_SHARE = 0.05  # of a person's points have a readable colour, or the frame is not segmented
BAD_SHARE = 0.3  # of colours lost to darkness or glare, from which a note is given
SAMPLE_M = 0.012  # between samples; the network's training uses the same
MOST_SAMPLES = 256  # along the longer side
ROUGH_M = 0.018  # between samples of the coarse pass; 0.024 costs 0.001 of the recall of 128 frames
ROUGH_MARGIN_M = 0.1  # around the parts found by the coarse pass
SAME_ILLUMINANT = 0.1  # largest difference of log gains to the previous frame's illuminant
WORN_SHARE = 0.7  # least share of the colours that their parts wear in the previous illuminant
ILLUMINANT = "light"
"""Name of the note of a frame's log gains of red and blue."""
UNSURE_ISLAND = "a piece of the person is apart from the body and unsure: check it"
"""Note of a frame to review first."""
MOST_GAIN = 2.0  # largest log gain accepted from a note


class View(NamedTuple):
    """Network input of a subject, in a rectangle around it.

    planes: channels uint8 (n, h, w), likelihoods still 0. rgb: uint8 (h, w, 3). pixels_per_m: at the
    subject. colors: readable colours uint8 (n, 3) inside the coarse mask. kept: the suit's colours in the
    previous frame's illuminant, if known.
    """

    where: Rectangle
    planes: UInt8
    rgb: UInt8
    pixels_per_m: float
    colors: UInt8
    kept: ColorModel | None = None

    def after(self, before: FrameLabels | None, suit: Suit | None, scheme: Scheme = PAPER) -> "View":
        """Return the view with the labels and illuminant of the previous frame, if any.

        scheme: of the network that takes the view. Labels that do not convert into it are left out.
        """
        planes = fitted_to(self.planes, scheme)
        if before is None:
            return self._replace(planes=planes)
        if converts(before.scheme, scheme):
            planes = with_before(planes, before, self.where, scheme)
        return self._replace(planes=planes, kept=_kept(suit, before) if suit is not None else None)

    def step(self, sample_m: float) -> int:
        """Return the sampling step in pixels: at least ``sample_m`` metres, at most ``MOST_SAMPLES`` samples
        a side.
        """
        longest = max(self.planes.shape[1:])
        return max(1, round(sample_m * self.pixels_per_m), -(-int(longest) // MOST_SAMPLES))


def view_of(cloud: ThermalCloud, detection: PersonDetection, person: PersonMask) -> View | None:
    """Return the network input for a frame's subject, from this frame alone; None with too few readable
    colours.
    """
    mask = person.mask & cloud.valid
    rgb = cloud.color_rgb[mask]
    usable = readable(rgb, cloud.color_valid[mask])
    if usable.sum() <= MIN_READABLE_SHARE * len(usable):
        return None
    where, pixels_per_m = rectangle(cloud, mask)
    planes = channels(cloud, detection, person, where)
    return View(where, planes, cloud.color_rgb[where], pixels_per_m, rgb[usable])


def _kept(suit: Suit, before: FrameLabels) -> ColorModel | None:
    """Return the suit's colours in the illuminant of a frame's notes, if valid."""
    gains = before.notes.get(ILLUMINANT)
    if not isinstance(gains, list) or [type(gain) for gain in gains] != [float, float]:
        return None
    return under(unfitted(suit), np.array(gains)) if all(abs(gain) <= MOST_GAIN for gain in gains) else None


@dataclass(frozen=True)
class SuitSegmenter:
    """Segmentation of people who wear a given suit. single_pass: without the fine pass, for live pictures.

    suit: None = segment without the suit's colours, by all other inputs.
    """

    suit: Suit | None
    network: SuitNetwork
    single_pass: bool = False

    def segment(
        self, cloud: ThermalCloud, view: View | None, person: PersonMask, before: FrameLabels | None
    ) -> tuple[Segmentation, PersonMask]:
        """Return the segmentation of a subject, and the person mask adapted to it.

        before: labels of the previous frame. Without readable colours (``view`` None) all points stay
        undefined, and a note gives the reason.
        """
        mask, scheme = person.mask & cloud.valid, self.network.scheme
        notes = diagnosis(cloud.color_rgb[mask], cloud.color_valid[mask])
        if view is None:
            return unlabelled(mask, *notes, scheme=scheme), person
        view = view.after(before, self.suit, self.network.own)
        illuminant: ColorModel | None = None
        if self.suit is None:
            near, _, _ = _find_parts(view, None, SAMPLE_M, self.network)
        else:
            near, illuminant = coarse_pass(view, self.suit, self.network)
        label = _single_pass if self.single_pass else fine_pass
        where, named, sure = label(cloud, view, near, illuminant, self.network)
        parts, confidence = placed(mask.shape, where, parts_of(named, scheme), sure)
        on_body = scheme.on_body(parts)
        if unsure_islands(cloud, on_body, confidence):
            notes = (*notes, UNSURE_ISLAND)
        persons = np.where(on_body, np.uint8(1), np.where(person.mask, np.uint8(0), person.persons))
        found = Segmentation(parts, confidence, notes, illuminant=illuminant, scheme=scheme)
        return found, replace(person, mask=on_body, persons=persons)


def parts_of(named: UInt8, scheme: Scheme) -> UInt8:
    """Return part ids of a network's classes (h, w); another person is background."""
    return np.append(scheme.class_ids, np.uint8(BACKGROUND))[named]


def placed(shape: tuple[int, ...], where: Rectangle, parts: UInt8, sure: Float32) -> tuple[UInt8, Float32]:
    """Return images (h, w) of parts and confidence, background outside a rectangle; confidence is 0 there."""
    whole, confidence = np.full(shape, BACKGROUND, np.uint8), np.zeros(shape, np.float32)
    whole[where] = parts
    confidence[where] = np.where(parts != BACKGROUND, sure, 0)
    return whole, confidence


def fine_pass(
    cloud: ThermalCloud, view: View, near: Rectangle, illuminant: ColorModel | None, network: SuitNetwork
) -> tuple[Rectangle, UInt8, Float32]:
    """Label every pixel of ``near`` in a view; return its rectangle in the image, class (h, w) and
    probability (h, w) of that class.

    illuminant: the suit's colours in the frame's illuminant; None = no suit.
    """
    where, step, planes = view.where.part(near), view.step(SAMPLE_M), view.planes
    if illuminant is not None:
        seen = np.zeros(view.rgb.shape[:2], np.bool_)
        seen[::step, ::step], seen[near] = True, True
        planes = with_likelihoods(planes, view.rgb, illuminant, seen, network.own)
    chance = flip_averaged(network, planes, step, near)
    if illuminant is not None:
        chance = settle_sides(cloud, where, chance, illuminant, network.scheme)
    named, sure = refine_borders(cloud, where, chance, illuminant, network.scheme)
    return where, named, network.undivided(chance, named) if network.divides else sure


def _single_pass(
    cloud: ThermalCloud, view: View, near: Rectangle, illuminant: ColorModel | None, network: SuitNetwork
) -> tuple[Rectangle, UInt8, Float32]:
    """Label sampled pixels like ``fine_pass``; other pixels take the nearest sample on their surface."""
    step = view.step(SAMPLE_M)
    some = slice(None, None, step), slice(None, None, step)
    samples = Rectangle(*(slice(own.start // step, -(-own.stop // step)) for own in near))
    planes = view.planes[:, *some]
    if illuminant is not None:
        planes = with_likelihoods(planes, view.rgb[some], illuminant, scheme=network.own)
    chance = network.probabilities(planes, 1, samples)
    sampled = chance.argmax(axis=0).astype(np.uint8)
    sure = chance.max(axis=0)
    if network.divides and illuminant is not None:
        sampled = _divided(chance, planes[:, *samples], view.rgb[some][samples], illuminant, network.scheme)
        sure = network.undivided(chance, sampled)
    near = Rectangle(*(slice(own.start - own.start % step, own.stop) for own in near))
    where = view.where.part(near)
    depth_mm = np.ascontiguousarray(cloud.depth_mm[where])
    pixel = np.arange(depth_mm.size).reshape(depth_mm.shape)[some]
    pixel = np.where(depth_mm[some] > 0, pixel, -1)
    named = nearest_labels(depth_mm, pixel, sampled, step)
    sure = sure.repeat(step, axis=0).repeat(step, axis=1)
    return where, named, sure[: named.shape[0], : named.shape[1]]


def _divided(chance: Float32, planes: UInt8, rgb: UInt8, illuminant: ColorModel, scheme: Scheme) -> UInt8:
    """Return the likeliest class (h, w) of a scheme by probabilities (k, h, w) and by colours (h, w, 3).

    planes: channels (n, h, w) of the same samples.
    """
    scores = np.log(np.maximum(chance, np.finfo(np.float32).tiny)).reshape(len(chance), -1)
    colors = rgb.reshape(-1, 3)
    usable = readable(colors, ((planes[0] & SEEN) > 0).ravel())
    scores += by_color(colors, usable, scores, (illuminant, scheme))
    return np.asarray(scores.argmax(axis=0).reshape(chance.shape[1:]), np.uint8)


def coarse_pass(view: View, suit: Suit, network: SuitNetwork) -> tuple[Rectangle, ColorModel]:
    """Return the rectangle of the parts in a view, with a margin, and the suit's colours in the frame's
    illuminant.

    The previous illuminant is kept if the parts found with it give nearly the same illuminant and their
    colours match the suit. Otherwise the illuminant is first fitted to all colours of the mask.
    """
    if view.kept is not None:
        near, rgb, belief = _find_parts(view, view.kept, ROUGH_M, network)
        if len(rgb):
            illuminant = refit_colors(view.kept, rgb, belief, network.scheme)
            moved = np.abs(illuminant.log_gain - view.kept.log_gain).max()
            if moved < SAME_ILLUMINANT and illuminant.worn(rgb, belief, network.scheme) > WORN_SHARE:
                return near, illuminant
    illuminant = fit_illuminant(suit, view.colors)
    near, rgb, belief = _find_parts(view, illuminant, SAMPLE_M, network)
    return near, fit_illuminant(suit, rgb, belief, network.scheme) if len(rgb) else illuminant


def _find_parts(
    view: View, illuminant: ColorModel | None, sample_m: float, network: SuitNetwork
) -> tuple[Rectangle, UInt8, Float64]:
    """Return the rectangle of the parts in one sampled image, and colours (n, 3) and part probabilities (n,
    m) of their samples.

    The rectangle is the whole view if no part is found.
    """
    step = view.step(sample_m)
    some = slice(None, None, step), slice(None, None, step)
    planes, rgb = view.planes[:, *some], view.rgb[some]
    if illuminant is not None:
        planes = with_likelihoods(planes, rgb, illuminant, scheme=network.own)
    chance, scheme = network.probabilities(planes, 1), network.scheme
    own = ((planes[0] & VALID) > 0) & (chance[0] + chance[other_person(scheme)] < 0.5)
    shape, margin = view.rgb.shape[:2], round(ROUGH_MARGIN_M * view.pixels_per_m)
    near = Rectangle(*(slice(0, side) for side in shape))
    if own.any():
        sides = (_grown(own.any(axis=1 - axis), step, margin, side) for axis, side in enumerate(shape))
        near = Rectangle(*sides)
    seen = own & ((planes[0] & SEEN) > 0)
    belief = chance[scheme.body_classes][:, seen].T.astype(np.float64)
    return near, rgb[seen], belief / belief.sum(axis=1, keepdims=True)


def _grown(seen: Bool, step: int, margin: int, side: int) -> slice:
    """Return the slice of pixels from the first to the last True sample (n,), with a margin at both ends.

    step: pixels per sample. side: length of the image's side.
    """
    first, last = (int(at) for at in np.flatnonzero(seen)[[0, -1]])
    return slice(max(first * step - margin, 0), min((last + 1) * step + margin, side))


def diagnosis(rgb: UInt8, seen: Bool) -> tuple[str, ...]:
    """Return a note on a defect of the person's colours and its remedy, or ().

    rgb: uint8 (n, 3), colours of the person. seen: bool (n,), points visible to the colour camera.
    """
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
