"""Mask (h, w) of the person in a thermal cloud: warm, off the room's planes, connected, of human size.

Nishi & Miura 2017, section 4.2.1, take every point of 25 to 35 degrees Celsius. Here temperature is one of
several sources of log odds: points on a plane of the room are no person however warm, colours of the sofa
count for the sofa, and hair and cold cloth follow the surface that they continue.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.color_odds import color_odds, lab_of
from annotate.cloud.grid import grown
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.person.depth_finder import people_in
from annotate.person.evidence import Evidence, previous_evidence, thermal_evidence
from annotate.person.known import Known, numbers_of
from annotate.person.persons import Person, persons_of, with_joined_halves
from annotate.person.pixel_odds import WINDOW_C, plane_odds
from annotate.person.planes import Plane, close_to, find_planes, lies_on, normals_at
from annotate.person.silhouette import smoothed
from annotate.person.subject import crowd_warnings, cut_warnings, subject_score
from annotate.suit.palette import Suit

RIM_PX, LEARNT_PX = 2, 10
"""Pixels beyond the candidates in which the background counts, and in which its colours are learnt. Chosen by
eye."""
RIM_JUMP = 0.05
"""Depth difference, as a share of the depth, of a rim: 10 cm at 2 m. Chosen by eye."""
NOBODY = "no person in the depth image; let somebody step into the view"
"""Note of a frame in which depth alone shows nobody."""
BY_DEPTH = "found by depth alone: record temperature for a surer outline"
"""Note of a person found without temperatures."""
LOST = (
    "no temperature in this frame, and the rig has moved since the one before: depth alone would take "
    "furniture for the person, parts are undefined; label it by hand, or hold still while the flag is closed"
)
"""Note of a frame without temperatures after the rig has moved; a suit's colours tell them from furniture."""


@dataclass(frozen=True)
class PersonMask:
    """Pixels (h, w) of the person in the undistorted depth image, all with a reading.

    method: "thermal"; "before" where the cloud has no temperature but the frame before had; "depth" in
    recordings without temperature. persons: uint8 (h, w), 0 nobody, 1 the subject, 2 and on others, whose
    numbers last over a recording; known: those seen so far. notes: remarks for the user, e.g. why the mask is
    empty. trusted: False where the frame is unreliable; a note then names the stream and the remedy.
    """

    mask: Bool
    method: Literal["thermal", "depth", "before"]
    persons: UInt8
    notes: tuple[str, ...] = ()
    trusted: bool = True
    known: Known = field(default_factory=list)

    @property
    def others(self) -> Bool:
        """Pixels (h, w) of other persons."""
        return np.asarray(self.persons > 1, np.bool_)


class Survey:
    """Everything about the persons of one frame that needs no other frame, for work ahead of its turn.

    Persons are found in the coarse cloud, and their outlines enlarged. window_c: surface temperatures of a
    person, degrees Celsius; None = found from the frame itself. suit: of the subject, if they wear one,
    whose colours then tell them from others. everybody: all persons are to be labelled: the earlier
    subject keeps number 1, and none has to stand out.
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
        self._enlarged: dict[bytes, UInt8] = {}
        self._evidence: Evidence | None = None
        if np.isfinite(self._coarse.temperature_c).any():
            self._evidence = thermal_evidence(self._coarse, window_c, self.planes, suited=suit is not None)
            self._persons = _persons(self._coarse, self._evidence)
        else:
            self._persons = people_in(self._coarse)

    @cached_property
    def planes(self) -> tuple[Plane, ...]:
        """Planes of the room."""
        return find_planes(self._coarse, self._coarse.valid)

    def person(self, before: FrameLabels | None = None) -> PersonMask:
        """The person by temperature; while the flag is closed by the frame before; else by depth alone.

        before: labels of the previous frame of the same source. Without a person the mask is empty and a note
        gives the reason; that is no error.
        """
        found = self._person(None if before is None else self.cloud.coarse(before))
        # With the frame before the persons are mostly the same as without.
        key = found.persons.tobytes()
        if key not in self._enlarged:
            self._enlarged[key] = self.cloud.enlarged(found.persons)
        persons = self._enlarged[key]
        return replace(found, mask=persons == 1, persons=persons)

    def _person(self, before: FrameLabels | None) -> PersonMask:
        """The person in the coarse cloud; before: coarse, too."""
        evidence, persons = self._evidence, self._persons
        if evidence is None:
            felt = before is not None and before.notes.get("extraction") in ("thermal", "before")
            evidence = previous_evidence(self._coarse, before, self.planes) if felt else None
            if evidence is None:
                found = self._depth_mask(before)
                lost = felt and self._suit is None
                return replace(found, method="before", notes=(LOST,), trusted=False) if lost else found
            persons = _persons(self._coarse, evidence)
        scores, persons = self._ranked(persons, before)
        found = self._numbered(persons, evidence.method, before)
        if not persons:
            notes = (evidence.nobody, *evidence.warnings)
            return replace(found, notes=notes, trusted=not evidence.warnings)
        warnings = [*evidence.warnings, *self._warnings(persons, scores)]
        return replace(found, notes=(*evidence.notes, *warnings), trusted=not warnings)

    def _depth_mask(self, before: FrameLabels | None) -> PersonMask:
        """Mask by depth alone; before: labels of the frame before, whose subject stays the subject."""
        scores, persons = self._ranked(self._persons, before)
        found = self._numbered(persons, "depth", before)
        if not persons:
            return replace(found, notes=(NOBODY,))
        warnings = self._warnings(persons, scores)
        return replace(found, notes=(BY_DEPTH, *warnings), trusted=not warnings)

    def _ranked(
        self, persons: Sequence[Person], before: FrameLabels | None
    ) -> tuple[list[float], list[Person]]:
        """Scores and persons, best first; the subject is the first."""
        if len(persons) < 2:
            return [1.0] * len(persons), list(persons)
        scores = [subject_score(person, before, self._suit, self._coarse) for person in persons]
        order = sorted(range(len(persons)), key=lambda i: -scores[i])
        return [scores[i] for i in order], [persons[i] for i in order]

    def _warnings(self, persons: Sequence[Person], scores: Sequence[float]) -> list[str]:
        """Why not to trust the subject, the first of the persons; scores: of all, best first."""
        crowded = [] if self._everybody else crowd_warnings(scores)
        return [*crowded, *cut_warnings(persons[0].mask)]

    def _numbered(
        self,
        persons: Sequence[Person],
        method: Literal["thermal", "depth", "before"],
        before: FrameLabels | None,
    ) -> PersonMask:
        """Masks and numbers of persons, the subject first."""
        numbers, known = numbers_of(persons, before, subject_first=not self._everybody)
        whose = np.zeros(self._coarse.valid.shape, np.uint8)
        for person, number in zip(reversed(persons), reversed(numbers), strict=True):
            whose[person.mask] = number
        return PersonMask(whose == 1, method, whose, known=known)

    @cached_property
    def share(self) -> Float32:
        """Share (h, w) of the way from the room's temperature to a person's; NaN = not felt."""
        coarse = self._evidence.share if self._evidence else None
        if coarse is None:
            return np.full(self.cloud.depth_mm.shape, np.nan, np.float32)
        rows, columns = (
            np.minimum(np.arange(side) // self.cloud.stride, n - 1)
            for side, n in zip(self.cloud.depth_mm.shape, coarse.shape, strict=True)
        )
        return np.asarray(coarse[np.ix_(rows, columns)], np.float32)

    @property
    def window_c(self) -> tuple[float, float]:
        """Surface temperatures of a person in this frame."""
        return self._evidence.window_c if self._evidence else WINDOW_C


def _persons(cloud: ThermalCloud, evidence: Evidence) -> list[Person]:
    """Persons of a cloud, in no order, by its evidence, the planes, colours and neighbours of its pixels."""
    candidates = cloud.valid & grown(evidence.candidates, RIM_PX)
    if not candidates.any():
        return []
    normals, own = np.full_like(cloud.points_m, np.nan), normals_at(cloud, *np.nonzero(candidates))
    normals[candidates] = own
    near, on = close_to(evidence.planes, cloud.points_m), evidence.cold.copy()
    on[candidates] |= lies_on(evidence.planes, cloud.points_m[candidates], own)
    surface_m2 = cloud.points_m[..., 2] ** 2 / np.float32(cloud.camera.fx * cloud.camera.fy)
    shaped = np.isfinite(normals[..., 0])
    odds = evidence.odds + plane_odds(on & near, near, shaped, evidence.cold, surface_m2)
    lab = lab_of(cloud.color_rgb, cloud.color_valid & ~_rims(cloud))
    odds += color_odds(lab, odds, candidates, cloud.valid & grown(evidence.candidates, LEARNT_PX))
    person = smoothed(odds, candidates, cloud.points_m[..., 2], normals, lab) > 0
    return with_joined_halves(cloud, persons_of(cloud, person))


def _rims(cloud: ThermalCloud) -> Bool:
    """Pixels (h, w) beside a depth jump, where colour is a pixel or two off, in place and in time."""
    depth_mm, window = cloud.depth_mm, np.ones((RIM_PX * 2 + 1,) * 2, np.uint8)
    farthest = cv2.dilate(depth_mm, window)
    nearest = cv2.erode(np.where(cloud.valid, depth_mm, np.uint16(65535)), window)
    return np.asarray(farthest > nearest * (1 + RIM_JUMP), np.bool_)
