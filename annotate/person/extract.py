"""Mask (h, w) of the person in a cloud: found by a network in depth and warmth, with a number that lasts.

Nishi & Miura 2017, section 4.2.1, take every point of 25 to 35 degrees Celsius. Here the window of
temperatures is the frame's own, and only what the finder makes of it and of the shape counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.frame_labels import FrameLabels
from annotate.person.alignment import contrasts, degrees, is_warmer, misplacement_px
from annotate.person.finder import Person, people_in
from annotate.person.planes import TOLERANCE, Plane, distance_m, find_planes
from annotate.person.subject import cloths_shown, crowd_warnings, cut_warnings, subject_score
from annotate.person.tracking import numbers_of
from annotate.person.warmth import WINDOW_C, find_window, is_warm, warmth, warmth_share
from annotate.suit.palette import Suit

LOCAL_M = 0.3
"""Metres in which temperatures are compared, to each side. Chosen by eye."""


@dataclass(frozen=True)
class PersonMask:
    """Pixels (h, w) of the person in the undistorted depth image, all with a reading.

    method: "thermal", or "depth" where the frame has no temperature. persons: uint8 (h, w), 0 nobody, 1 the
    subject, 2 and on others, whose numbers last over a recording; known: those seen so far, as of
    ``numbers_of``. notes: remarks for the user, e.g. why the mask is empty. trusted: False where the frame is
    unreliable; a note then names the stream and the remedy.
    """

    mask: Bool
    method: Literal["thermal", "depth"]
    persons: UInt8
    notes: tuple[str, ...] = ()
    trusted: bool = True
    known: list[list[int]] = field(default_factory=list)

    @property
    def others(self) -> Bool:
        """Pixels (h, w) of other persons."""
        return np.asarray(self.persons > 1, np.bool_)


class Survey:
    """Everything about the persons of one frame that needs no other frame, for work ahead of its turn.

    Persons are found in the coarse cloud, and their outlines enlarged. window_c: surface temperatures of a
    person, degrees Celsius; None = found from the frame itself; where nothing is as warm there is nobody.
    suit: of the subject, if they wear one, whose colours then tell them from others. everybody: all persons
    are labelled: the earlier subject keeps number 1, none has to stand out. glance: as of ``people_in``.
    """

    def __init__(
        self,
        cloud: CoarseCloud,
        window_c: tuple[float, float] | None = None,
        suit: Suit | None = None,
        *,
        everybody: bool = False,
        glance: bool = False,
    ) -> None:
        self.cloud, self._coarse, self._everybody = cloud, cloud.cloud, everybody
        self._suit = suit
        self._is_felt = bool(np.isfinite(self._coarse.temperature_c).any())
        found = find_window(self._coarse, self._loose) if self._is_felt and window_c is None else window_c
        self.window_c = found or WINDOW_C
        """Surface temperatures of a person in this frame."""
        self.warmth = warmth(self._coarse.temperature_c, self.window_c)
        """Warmth (h, w) of the coarse cloud's points."""
        is_cold = self._is_felt and not self._warm.any()
        self._persons = [] if is_cold else people_in(self._coarse, self.warmth, glance=glance)
        self._misaligned = self._misalignment() if self._is_felt else ()

    @cached_property
    def planes(self) -> tuple[Plane, ...]:
        """Planes of the room."""
        return find_planes(self._coarse)

    @cached_property
    def _loose(self) -> Bool:
        """Points (h, w) off the planes: a sunlit wall is no person."""
        points_m = self._coarse.points_m
        return self._coarse.valid & (distance_m(self.planes, points_m) > TOLERANCE * points_m[..., 2])

    @cached_property
    def _warm(self) -> Bool:
        """Points (h, w) off the planes and as warm as a person."""
        return self._loose & is_warm(self._coarse.temperature_c, self.window_c)

    def _misalignment(self) -> tuple[str, ...]:
        """Warning where the thermal image does not lie on the depth image."""
        surface = contrasts(self._coarse, self.window_c, self._warm)
        shift_px = None if surface is None else misplacement_px(surface)
        persons = self._numbered(self._persons, None).persons > 0
        if shift_px is None or not is_warmer(self.warmth.clip(0, 1), persons, shift_px):
            return ()
        right, down = (self.cloud.stride * px for px in shift_px)
        return (
            f"thermal image lies {right:+.0f}, {down:+.0f} pixels (right, down) off the depth image, "
            + f"{degrees(shift_px, self._coarse.camera):.1f} degrees: calibrate the thermal camera again; "
            "parts are undefined",
        )

    def person(self, before: FrameLabels | None = None) -> PersonMask:
        """The subject; before: labels of the previous frame of the same source.

        Without a person the mask is empty and a note gives the reason; that is no error.
        """
        found = self._person(None if before is None else self.cloud.coarse(before))
        persons = self.cloud.enlarged(found.persons)
        return replace(found, mask=persons == 1, persons=persons)

    def _person(self, before: FrameLabels | None) -> PersonMask:
        """The person in the coarse cloud; before: coarse, too."""
        ranked = self._ranked(before)
        scores, persons = [score for score, _ in ranked], [person for _, person in ranked]
        found = self._numbered(persons, before)
        notes = () if self._is_felt else ("found by depth alone: record temperature for a surer outline",)
        if not persons:
            return replace(found, notes=(self._nobody(), *self._misaligned), trusted=not self._misaligned)
        crowded = [] if self._everybody else crowd_warnings(scores)
        warnings = (*self._misaligned, *crowded, *cut_warnings(persons[0].mask))
        return replace(found, notes=(*notes, *warnings), trusted=not warnings)

    def _nobody(self) -> str:
        """Note of a frame without a person."""
        if not self._is_felt:
            return "no person in the depth image; let somebody step into the view"
        low_c, high_c = self.window_c
        return (
            f"no person in the thermal and depth images: nothing of human shape and size is {low_c:.1f} to "
            f"{high_c:.1f} degrees warm; let somebody step into the view, or give the window of temperatures"
        )

    def _ranked(self, before: FrameLabels | None) -> list[tuple[float, Person]]:
        """Persons with their scores, best first; the subject is the first."""
        if len(self._persons) < 2:
            return [(1.0, person) for person in self._persons]
        shown = zip(self._persons, self._shown, strict=True)
        scored = [(subject_score(one, before, cloths), one) for one, cloths in shown]
        return sorted(scored, key=lambda pair: -pair[0])

    @cached_property
    def _shown(self) -> list[float]:
        """Cloths of the suit that each person shows, which take time to count; 1 where there is no suit."""
        suit = self._suit if self._coarse.color_valid.any() else None
        return [cloths_shown(suit, self._coarse, one.mask) if suit else 1.0 for one in self._persons]

    def _numbered(self, persons: Sequence[Person], before: FrameLabels | None) -> PersonMask:
        """Masks and numbers of persons, the subject first."""
        numbers, known = numbers_of(persons, before, subject_first=not self._everybody)
        whose = np.zeros(self._coarse.valid.shape, np.uint8)
        for person, number in zip(reversed(persons), reversed(numbers), strict=True):
            whose[person.mask] = number
        return PersonMask(whose == 1, "thermal" if self._is_felt else "depth", whose, known=known)

    @cached_property
    def share(self) -> Float32:
        """Share (h, w) of the way from what is around to a person's temperature; NaN = not felt."""
        if not self._warm.any():
            return np.full(self.cloud.depth_mm.shape, np.nan, np.float32)
        middle_m = float(np.median(self._coarse.points_m[..., 2][self._warm]))
        size_px = 2 * round(LOCAL_M * self._coarse.camera.fx / middle_m) + 1
        coarse = warmth_share(self._coarse.temperature_c, self._warm, self.window_c, size_px)
        rows, columns = (
            np.minimum(np.arange(side) // self.cloud.stride, n - 1)
            for side, n in zip(self.cloud.depth_mm.shape, coarse.shape, strict=True)
        )
        return np.asarray(coarse[np.ix_(rows, columns)], np.float32)
