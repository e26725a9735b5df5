"""Person detection in one frame, and the mask of its subject with track ids.

Nishi & Miura 2017, section 4.2.1, take every point of 25 to 35 degrees Celsius as the person. Here each frame
has its own temperature range, and a network weighs warmth and shape.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.frame_labels import FrameLabels
from annotate.person.alignment import contrasts, degrees, is_warmer, misplacement_px
from annotate.person.detection.finder import find_people
from annotate.person.detection.odds import LIKELY_ODDS
from annotate.person.planes import TOLERANCE, Plane, distance_m, find_planes
from annotate.person.subject import cloths_shown, crowd_warnings, cut_warnings, subject_score
from annotate.person.tracking import Sightings, Tracks
from annotate.person.warmth import WINDOW_C, find_window, is_warm, warmth, warmth_share
from annotate.suit.palette import Suit

LOCAL_M = 0.3  # to each side, within which temperatures are compared; untuned


@dataclass(frozen=True)
class PersonMask:
    """Pixels (h, w) of the subject in the undistorted depth image, all with a reading.

    method: "depth" where the frame has no temperature. persons: uint8 (h, w), 0 = no person, 1 the subject,
    others by track id. notes: for the user, e.g. the reason for an empty mask. trusted: False for an
    unreliable frame; a note then names the stream and the remedy. tracks: open ones, None without track ids.
    """

    mask: Bool
    method: Literal["thermal", "depth"]
    persons: UInt8
    notes: tuple[str, ...] = ()
    trusted: bool = True
    tracks: Tracks | None = None

    @property
    def others(self) -> Bool:
        """Return the pixels (h, w) of other persons."""
        return np.asarray(self.persons > 1, np.bool_)


class PersonDetection:
    """Persons of one frame, detected in the coarse cloud, independent of other frames.

    window_c: lowest and highest surface temperature of a person; None = from the frame. Without pixels in
    this range no person is found. suit: suit of the subject, which distinguishes the subject from others.
    everybody: label all persons; the earlier subject keeps id 1, and no clear subject is required.
    """

    def __init__(
        self,
        cloud: CoarseCloud,
        window_c: tuple[float, float] | None = None,
        suit: Suit | None = None,
        *,
        everybody: bool = False,
    ) -> None:
        self.cloud, self._coarse, self._everybody = cloud, cloud.cloud, everybody
        self._suit = suit
        self._whole: dict[bytes, UInt8] = {}
        self._is_felt = bool(np.isfinite(self._coarse.temperature_c).any())
        found = find_window(self._coarse, self._loose) if self._is_felt and window_c is None else window_c
        self.window_c = found or WINDOW_C
        """Surface temperatures of a person in this frame."""
        self.warmth = warmth(self._coarse.temperature_c, self.window_c)
        """Warmth (h, w) of the coarse cloud's points."""
        is_cold = self._is_felt and not self._warm.any()
        self._persons = [] if is_cold else find_people(self._coarse, self.warmth)
        self._misaligned = self._misalignment() if self._is_felt else ()

    @cached_property
    def planes(self) -> tuple[Plane, ...]:
        """Return the planes of the room."""
        return find_planes(self._coarse)

    @cached_property
    def _loose(self) -> Bool:
        """Return flags (h, w) of points off the room's planes; a sunlit wall is as warm as a person."""
        points_m = self._coarse.points_m
        return self._coarse.valid & (distance_m(self.planes, points_m) > TOLERANCE * points_m[..., 2])

    @cached_property
    def _warm(self) -> Bool:
        """Return flags (h, w) of points off the planes and as warm as a person."""
        return self._loose & is_warm(self._coarse.temperature_c, self.window_c)

    def _misalignment(self) -> tuple[str, ...]:
        """Return a warning if the thermal image is shifted against the depth image."""
        surface = contrasts(self._coarse, self.window_c, self._warm)
        shift_px = None if surface is None else misplacement_px(surface)
        persons = np.zeros(self._coarse.valid.shape, np.bool_)
        for person in self._persons:
            persons |= person.mask & (person.odds >= LIKELY_ODDS)
        if shift_px is None or not is_warmer(self.warmth.clip(0, 1), persons, shift_px):
            return ()
        right, down = (self.cloud.stride * px for px in shift_px)
        return (
            f"thermal image lies {right:+.0f}, {down:+.0f} pixels (right, down) off the depth image, "
            + f"{degrees(shift_px, self._coarse.camera):.1f} degrees: calibrate the thermal camera again; "
            "parts are undefined",
        )

    def person(self, before: FrameLabels | None = None) -> PersonMask:
        """Return the subject's mask, given the labels of the previous frame.

        Without a person the mask is empty and a note gives the reason.
        """
        found = self._person(before)
        key = found.persons.tobytes()
        if key not in self._whole:
            self._whole[key] = self.cloud.enlarged(found.persons)
        persons = self._whole[key]
        return replace(found, mask=persons == 1, persons=persons)

    def _person(self, before: FrameLabels | None) -> PersonMask:
        """Return the subject's mask in the coarse cloud. before: labels of the previous frame."""
        earlier = None if before is None else Tracks.of(before.notes)
        sightings = Sightings(self._persons, earlier, self._coarse.stamp_ns)
        ranked = self._ranked(sightings.shown, before)
        scores = [score for score, _ in ranked]
        found = self._numbered(sightings, [i for _, i in ranked])
        notes = () if self._is_felt else ("found by depth alone: record temperature for a surer outline",)
        if not ranked:
            return replace(found, notes=(self._no_person(), *self._misaligned), trusted=not self._misaligned)
        crowded = [] if self._everybody else crowd_warnings(scores)
        warnings = (*self._misaligned, *crowded, *cut_warnings(self._persons[ranked[0][1]].mask))
        return replace(found, notes=(*notes, *warnings), trusted=not warnings)

    def _no_person(self) -> str:
        if not self._is_felt:
            return "the depth image shows no person; let a person step into the view"
        low_c, high_c = self.window_c
        return (
            f"the thermal and depth images show no person: nothing of human shape and size is {low_c:.1f} to "
            f"{high_c:.1f} degrees warm; let a person step into the view, or give the window of temperatures"
        )

    def _ranked(self, shown: Sequence[bool], before: FrameLabels | None) -> list[tuple[float, int]]:
        """Return the indices of the shown persons with their scores, best first; the first is the subject."""
        chosen = [i for i, flag in enumerate(shown) if flag]
        if len(chosen) < 2:
            return [(1.0, i) for i in chosen]
        before = None if before is None else self.cloud.coarse(before)
        scored = [(subject_score(self._persons[i], before, self._cloths[i]), i) for i in chosen]
        return sorted(scored, key=lambda pair: -pair[0])

    @cached_property
    def _cloths(self) -> list[float]:
        """Return ``cloths_shown`` for each person; 1 without a suit."""
        suit = self._suit if self._coarse.color_valid.any() else None
        return [cloths_shown(suit, self._coarse, one.mask) if suit else 1.0 for one in self._persons]

    def _numbered(self, sightings: Sightings, ranked: Sequence[int]) -> PersonMask:
        """Return the person mask with track ids; ranked: indices of the shown persons, the subject first."""
        numbers, tracks = sightings.numbered(ranked[0] if ranked and not self._everybody else None)
        whose = np.zeros(self._coarse.valid.shape, np.uint8)
        for i in reversed(ranked):
            whose[self._persons[i].mask] = numbers[i]
        return PersonMask(whose == 1, "thermal" if self._is_felt else "depth", whose, tracks=tracks)

    @cached_property
    def share(self) -> Float32:
        """Return the temperature (h, w) relative to local background (0) and local person (1), or NaN."""
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
