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
from annotate.cloud.color_odds import color_odds, lab_of
from annotate.cloud.grid import grown
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine, Steps
from annotate.frame_labels import FrameLabels
from annotate.person.clothed_mask import PatchClues, clothed_odds, patch_clues
from annotate.person.depth_finder import people_in
from annotate.person.evidence import Evidence, previous_evidence, thermal_evidence
from annotate.person.known import Known, numbers_of
from annotate.person.persons import Person, persons_of, with_joined_halves
from annotate.person.pixel_odds import plane_odds
from annotate.person.planes import Plane, close_to, find_planes, lies_on, normals_at
from annotate.person.silhouette import Links
from annotate.person.subject import crowd_warnings, cut_warnings, subject_score
from annotate.suit.palette import Suit

RIM_PX, LEARNT_PX = 2, 10
"""Pixels beyond the candidates in which the background counts, and in which its colours are learnt. Chosen by
eye."""
RIM_JUMP = 0.05
"""Depth difference, as a share of the depth, of a rim: 10 cm at 2 m. Chosen by eye."""
BESIDE_SUBJECT_PX, LEAST_BESIDE_ODDS = 45, -3.0
"""Pixels around the subject that surface as cold as the room (a lower leg) may lie in, with the least log
odds: no plane of the room. Chosen by eye."""
BODY_M, NEIGHBOUR_M = 1.3, 1.0
"""Metres from a person's middle to their feet below a blanket, and to another's middle. Chosen by eye."""
KEPT_ABOVE_ODDS, BETWEEN_PX = -0.5, 13
"""Log odds by the suit down to which the mask without it stays, as most rooms have no blanket; side in pixels
of the window that bridges gaps in one. Chosen by eye."""
NOBODY = "no person in the depth image; let somebody step into the view"
"""Note of a frame in which depth alone shows nobody."""
BY_DEPTH = "found by depth alone: record temperature for a surer outline"
"""Note of a person found without temperatures."""
LOST = (
    "no temperature in this frame, and the rig has moved since the one before: depth alone would take "
    "furniture for the person, parts are undefined; label it by hand, or hold still while the flag is closed"
)
"""Note of a frame without temperatures after the rig has moved."""


@dataclass(frozen=True)
class MaskCandidates:
    """Pixels that may be the subject's, for a second decision on their mask.

    clues: of patches of one colour; odds: log odds (h, w) by these. room: bool (h, w), background around.
    silhouettes, persons: as found without the suit, the subject first.
    """

    clues: PatchClues
    odds: Float32
    room: Bool
    silhouettes: "_Silhouettes"
    persons: Sequence[Person]

    def mask(self, odds: Float32) -> Bool:
        """The subject's mask (h, w) by other log odds (h, w), 0 = unknown."""
        return self.silhouettes.dressed(self.persons, odds)[0].mask


@dataclass(frozen=True)
class PersonMask:
    """Pixels (h, w) of the person in the undistorted depth image, all with a reading.

    method: "thermal"; "before" where the cloud has no temperature but the frame before had; "depth" in
    recordings without temperature. persons: uint8 (h, w), 0 nobody, 1 the subject, 2 and on others, whose
    numbers last over a recording; known: those seen so far. notes: remarks for the user, e.g. why the mask is
    empty. trusted: False where the frame is unreliable; a note then names the stream and the remedy.
    candidates: with a suit, for a second decision.
    """

    mask: Bool
    method: Literal["thermal", "depth", "before"]
    persons: UInt8
    notes: tuple[str, ...] = ()
    trusted: bool = True
    candidates: MaskCandidates | None = None
    known: Known = field(default_factory=list)

    @property
    def others(self) -> Bool:
        """Pixels (h, w) of other persons."""
        return np.asarray(self.persons > 1, np.bool_)


class Survey:
    """Everything about the persons of one cloud that needs no other frame, for work ahead of its turn.

    window_c: surface temperatures of a person, degrees Celsius; None = found from the frame itself. suit:
    palette of the person's clothing, whose colours part them from things on them. everybody: all persons are
    to be labelled: the earlier subject keeps number 1, and none has to stand out.
    """

    def __init__(
        self,
        cloud: ThermalCloud,
        window_c: tuple[float, float] | None = None,
        suit: Suit | None = None,
        engine: Engine | None = None,
        *,
        everybody: bool = False,
    ) -> None:
        self.cloud, self._suit, self._engine, self._everybody = cloud, suit, engine or Engine(), everybody
        steps = self._engine.steps
        self._warm: _Silhouettes | None = None
        if np.isfinite(cloud.temperature_c).any():
            evidence = thermal_evidence(cloud, window_c, self.planes, suit, steps)
            self._warm = _Silhouettes(cloud, evidence, steps)
        self._by_depth = [] if self._warm else people_in(cloud)

    @cached_property
    def planes(self) -> tuple[Plane, ...]:
        """Planes of the whole cloud; none without that step."""
        return find_planes(self.cloud, self.cloud.valid) if self._engine.steps.room_planes else ()

    def person(self, before: FrameLabels | None = None) -> PersonMask:
        """The person by temperature; while the flag is closed by the frame before; else by depth alone.

        before: labels of the previous frame of the same source. Without a person the mask is empty and a note
        gives the reason; that is no error.
        """
        cloud, silhouettes = self.cloud, self._warm
        if silhouettes is None:
            felt = before is not None and before.notes.get("extraction") in ("thermal", "before")
            previous = previous_evidence(cloud, before, self.planes) if felt else None
            if previous is None:
                found = self._depth_mask(before)
                return replace(found, method="before", notes=(LOST,), trusted=False) if felt else found
            silhouettes = _Silhouettes(cloud, previous, self._engine.steps)
        evidence = silhouettes.evidence
        persons, candidates = self._persons(silhouettes, before)
        if not persons:
            notes = (evidence.nobody, *evidence.warnings)
            return replace(
                self._numbered([], evidence.method, before), notes=notes, trusted=not evidence.warnings
            )
        crowded = [] if self._everybody else crowd_warnings(persons, before, cloud if self._suit else None)
        warnings = [*evidence.warnings, *crowded, *cut_warnings(persons[0].mask)]
        found = self._numbered(persons, evidence.method, before)
        notes = (*evidence.notes, *warnings)
        return replace(found, notes=notes, trusted=not warnings, candidates=candidates)

    def _depth_mask(self, before: FrameLabels | None) -> PersonMask:
        """Mask by depth alone; before: labels of the frame before, whose subject stays the subject."""
        persons = sorted(self._by_depth, key=lambda person: -subject_score(person, before, None))
        found = self._numbered(persons, "depth", before)
        if not persons:
            return replace(found, notes=(NOBODY,))
        crowded = [] if self._everybody else crowd_warnings(persons, before, None)
        warnings = [*crowded, *cut_warnings(persons[0].mask)]
        return replace(found, notes=(BY_DEPTH, *warnings), trusted=not warnings)

    def _numbered(
        self,
        persons: Sequence[Person],
        method: Literal["thermal", "depth", "before"],
        before: FrameLabels | None,
    ) -> PersonMask:
        """Masks and numbers of persons, the subject first."""
        numbers, known = numbers_of(persons, before, subject_first=not self._everybody)
        whose = np.zeros(self.cloud.valid.shape, np.uint8)
        for person, number in zip(reversed(persons), reversed(numbers), strict=True):
            whose[person.mask] = number
        return PersonMask(whose == 1, method, whose, known=known)

    def _persons(
        self, silhouettes: "_Silhouettes", before: FrameLabels | None
    ) -> tuple[list[Person], MaskCandidates | None]:
        """All persons, the subject first, with the mask by the suit; candidates where there is one."""
        cloud, suit, weights = self.cloud, self._suit, self._engine.weights
        wearing = cloud if suit else None
        persons = sorted(silhouettes.persons, key=lambda person: -subject_score(person, before, wearing))
        if suit is None or not persons:
            return persons, None
        beside, room = silhouettes.beside(persons), silhouettes.surroundings
        clues = patch_clues(cloud, persons[0].mask, beside, room, suit, silhouettes.odds, weights)
        if clues is None:
            return persons, None
        odds = clothed_odds(clues, weights)
        if not self._engine.steps.suit_for_person:
            odds = np.zeros_like(odds)
        dressed = silhouettes.dressed(persons, odds) if odds.any() else persons
        return dressed, MaskCandidates(clues, odds, room, silhouettes, persons)


class _Silhouettes:
    """Persons of a cloud by its evidence, the planes, colours and neighbours of its pixels.

    evidence: of temperature or of the frame before. odds: log odds (h, w) with the planes. surroundings: bool
    (h, w), background around the candidates. persons: all persons, in no order.
    """

    def __init__(self, cloud: ThermalCloud, evidence: Evidence, steps: Steps) -> None:
        self._cloud, self.evidence, self._steps = cloud, evidence, steps
        self._candidates = cloud.valid & grown(evidence.candidates, RIM_PX)
        normals, own = np.full_like(cloud.points_m, np.nan), normals_at(cloud, *np.nonzero(self._candidates))
        normals[self._candidates] = own
        near, on = close_to(evidence.planes, cloud.points_m), evidence.cold.copy()
        on[self._candidates] |= lies_on(evidence.planes, cloud.points_m[self._candidates], own)
        on &= near
        surface_m2 = cloud.points_m[..., 2] ** 2 / np.float32(cloud.camera.fx * cloud.camera.fy)
        shaped = np.isfinite(normals[..., 0])
        self.odds = evidence.odds + plane_odds(on, near, shaped, evidence.cold, surface_m2)
        self._lab = lab_of(cloud.color_rgb, cloud.color_valid & ~_rims(cloud))
        self._learnt = cloud.valid & grown(evidence.candidates, LEARNT_PX)
        self._links = Links(self._candidates, cloud.points_m[..., 2], normals, self._lab)
        self.surroundings = self._learnt & ~self._candidates
        self.persons: list[Person] = []
        if self._candidates.any():
            self.persons = persons_of(cloud, self._links.belief(self._with_colors(self.odds)) > 0)
            self.persons = with_joined_halves(cloud, self.persons) if steps.join_halves else self.persons

    def beside(self, persons: Sequence[Person]) -> Bool:
        """Pixels (h, w) around the first person that may be theirs too, as of persons too near: feet."""
        first = persons[0]
        away_m = np.linalg.norm(self._cloud.points_m - first.centre_m.astype(np.float32), axis=-1)
        beside = grown(first.mask, BESIDE_SUBJECT_PX) & (self.odds > LEAST_BESIDE_ODDS)
        beside |= (away_m < BODY_M) & (self.odds > 0)
        beside &= self._candidates & ~first.mask
        for person in persons[1:]:
            if np.linalg.norm(person.centre_m - first.centre_m) > NEIGHBOUR_M:
                beside &= ~person.mask
        return np.asarray(beside, np.bool_)

    def _with_colors(self, odds: Float32) -> Float32:
        """Log odds (h, w) with those of the colours of person and room added."""
        if not self._steps.room_colors:
            return odds
        return odds + color_odds(self._lab, odds, self._candidates, self._learnt)

    def dressed(self, persons: Sequence[Person], suit_odds: Float32) -> list[Person]:
        """Persons with the first one's mask by log odds (h, w) of their suit, 0 = unknown.

        Their clothes belong to the mask, however far a blanket keeps them from the rest of the body.
        """
        first = persons[0]
        kept = first.mask & (suit_odds < 0) & (suit_odds > KEPT_ABOVE_ODDS)
        known = np.where(kept, np.float32(0), suit_odds)
        odds = np.where(known != 0, known, self.odds + np.minimum(_between(known), 0))
        odds = np.where(known != 0, known, self._with_colors(odds))
        own = (self._links.belief(odds) > 0) & ((known > 0) | grown(first.mask, RIM_PX))
        for person in persons[1:]:
            own &= ~person.mask | (known > 0)
        if not own.any():
            return list(persons)
        others = [replace(person, mask=person.mask & ~own) for person in persons[1:]]
        return [replace(first, mask=np.asarray(own, np.bool_)), *(p for p in others if p.mask.any())]


def _between(odds: Float32) -> Float32:
    """Mean (h, w) of the known log odds (h, w) around each pixel, 0 where few are known (not 0)."""
    total, count = (cv2.blur(plane, (BETWEEN_PX,) * 2) for plane in (odds, (odds != 0).astype(np.float32)))
    return np.asarray(np.where(count > 0.1, total / np.maximum(count, 0.1), 0), np.float32)


def _rims(cloud: ThermalCloud) -> Bool:
    """Pixels (h, w) beside a depth jump, where colour is a pixel or two off, in place and in time."""
    depth_mm, window = cloud.depth_mm, np.ones((RIM_PX * 2 + 1,) * 2, np.uint8)
    farthest = cv2.dilate(depth_mm, window)
    nearest = cv2.erode(np.where(cloud.valid, depth_mm, np.uint16(65535)), window)
    return np.asarray(farthest > nearest * (1 + RIM_JUMP), np.bool_)
