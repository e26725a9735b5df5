"""The person in a thermal cloud: warm, off the room's planes, connected in space, of human size.

Nishi & Miura 2017, section 4.2.1, take every point of 25 to 35 degrees Celsius. Here temperature is the
first of several witnesses: what lies on a plane of the room is no person however warm, a colour that is
the sofa's speaks for the sofa, and hair and cold cloth go with the surface that they continue.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from annotate.array_types import Bool, Float32
from annotate.cloud.color_odds import by_color, lab_of
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine, Steps
from annotate.frame_labels import FrameLabels
from annotate.person.alignment import thermal_alignment
from annotate.person.clothed_mask import Clues, clues, worn
from annotate.person.halves import whole
from annotate.person.persons import SPECK_M2, Person, persons_of
from annotate.person.pieces import Piece, pieces_of
from annotate.person.pixel_odds import by_planes, by_warmth, inherited, warmth_share
from annotate.person.planes import (
    MIN_COLD_PLANE_M2,
    MIN_PANEL_M2,
    Plane,
    close_to,
    find_planes,
    lies_on,
    normals_at,
    panel_of,
)
from annotate.person.previous_mask import by_before, persons_before
from annotate.person.silhouette import Links
from annotate.person.subject import claim, crowd, cut
from annotate.person.warm_window import WINDOW_C, find_window
from annotate.suit.palette import Suit

LOCAL_M = 0.3
"""Half side of the window in which person and background temperatures are compared."""
REACH_M = 0.3
"""How far a temperature speaks for the surface it lies on, where the thermal camera does not see it."""
SURROUNDINGS_M = 0.4
"""How far around what is warm a cold sleeve or a foot behind an arm rest may reach."""
LEGS_M, FAINT = 0.9, 0.25
"""How far from what is warm a foot may be seen below a blanket, off all planes, and the least share of a
person's warmth that it has then."""
SURELY_COLD = 0.12
"""What lies close to a plane and is no warmer than this share of a person needs no further look."""
RIM_PX, TAUGHT_PX = 2, 10
"""How far beyond the candidates the background is heard, and how far its colours are learnt."""
RIM_JUMP = 0.05
"""Depth difference there, as a share of the depth: 10 cm at 2 m."""
EDGES_PX = 25
"""How far around what is warm silhouettes are compared with the temperatures: four degrees."""
BESIDE_PX, LEAST_BESIDE = 45, -3.0
"""How far around the person what is as cold as the room may yet be theirs: a lower leg; not on a plane."""
BODY_M, NEIGHBOUR_M = 1.3, 1.0
"""So far from their middle a person's warm feet may be, seen apart below a blanket; no other person is nearer
to it than the second."""
DOUBT = -0.5
"""Above these log odds what was found by warmth stays: most rooms have no blanket."""
LOST = (
    "no temperature in this frame, and the rig has moved since the one before: depth alone would take "
    "furniture for the person, parts are undefined; label it by hand, or hold still while the flag is closed"
)
BETWEEN_PX = 13
"""How wide gaps in a blanket are that is told by its colours."""


@dataclass(frozen=True)
class Undecided:
    """What was known of everything that may be the person's, for who knows more later.

    clues: of patches of one colour; told: log odds (h, w) by them. room: bool (h, w), what surely is nobody.
    decided: the mask (h, w) by other log odds (h, w), 0 = nothing told.
    """

    clues: Clues
    told: Float32
    room: Bool
    decided: Callable[[Float32], Bool]


@dataclass(frozen=True)
class PersonMask:
    """Which pixels (h, w) of the undistorted depth image are the person; a subset of the valid ones.

    method: "thermal"; "before" where the cloud has no temperature but the frame before had a person;
    "depth" where there is neither. others: bool (h, w), pixels of other persons. notes: what the user
    should know, e.g. why the mask is empty. trusted: False where the frame can't be relied on; a note
    says which stream is to blame and what to do. undecided: where a suit was asked.
    """

    mask: Bool
    method: Literal["thermal", "depth", "before"]
    others: Bool
    notes: tuple[str, ...] = ()
    trusted: bool = True
    undecided: Undecided | None = None


@dataclass(frozen=True)
class _Field:
    """Log odds (h, w) of being a person before planes, colour and neighbours have spoken.

    candidates: pixels to decide on, the others are background. cold: background if on a plane at all.
    nobody: the note where there is no person after all. notes: what to say anyway; warnings: why the frame
    is not to be trusted.
    """

    method: Literal["thermal", "before"]
    odds: Float32
    candidates: Bool
    cold: Bool
    planes: tuple[Plane, ...]
    nobody: str
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def extract_person(
    cloud: ThermalCloud,
    window_c: tuple[float, float] | None = None,
    before: FrameLabels | None = None,
    suit: Suit | None = None,
) -> PersonMask:
    """Find the person by temperature; without any by the frame before; else by depth alone.

    window_c: surface temperatures of a person, degrees Celsius; None = found from the frame itself.
    before: the labels of the previous frame of the same source. suit: what the person is known to wear; with
    it what lies on them is told by its colours. Where there is no person the mask is empty and a note says
    so; that is no error.
    """
    return Survey(cloud, window_c, suit).person(before)


class Survey:
    """Who a cloud shows as far as it tells alone, which can be worked out before the frame's turn comes.

    cloud: what was looked at. Arguments as of ``extract_person``.
    """

    def __init__(
        self,
        cloud: ThermalCloud,
        window_c: tuple[float, float] | None = None,
        suit: Suit | None = None,
        engine: Engine | None = None,
    ) -> None:
        self.cloud, self._suit, self._engine = cloud, suit, engine or Engine()
        steps = self._engine.steps
        self._planes = find_planes(cloud, cloud.valid) if steps.room_planes else ()
        self._warm: _Silhouettes | None = None
        if np.isfinite(cloud.temperature_c).any():
            field = _by_temperature(cloud, window_c, self._planes, suit, steps)
            self._warm = _Silhouettes(cloud, field, steps)

    def person(self, before: FrameLabels | None) -> PersonMask:
        """The person, given the labels of the frame before; as ``extract_person``."""
        cloud, silhouettes = self.cloud, self._warm
        if silhouettes is None:
            carried = _by_before(cloud, before, self._planes)
            if carried is None:
                found = _by_depth(cloud, self._planes)
                return replace(found, notes=(LOST,), trusted=False) if _was_felt(before) else found
            silhouettes = _Silhouettes(cloud, carried, self._engine.steps)
        field = silhouettes.field
        persons, undecided = _persons(cloud, silhouettes, self._suit, before, self._engine)
        mask, others = np.zeros((2, *cloud.valid.shape), np.bool_)
        if not persons:
            return PersonMask(mask, field.method, others, (field.nobody, *field.warnings), not field.warnings)
        for person in persons[1:]:
            others |= person.mask
        crowded = crowd(persons, before, cloud if self._suit else None)
        warnings = [*field.warnings, *crowded, *cut(persons[0].mask)]
        notes = (*field.notes, *warnings)
        return PersonMask(persons[0].mask, field.method, others, notes, not warnings, undecided)


def _by_temperature(
    cloud: ThermalCloud,
    window_c: tuple[float, float] | None,
    planes: tuple[Plane, ...],
    suit: Suit | None,
    steps: Steps,
) -> _Field:
    loose = cloud.valid & ~close_to(planes, cloud.points_m)
    low, high = window_c or find_window(cloud, loose) or WINDOW_C
    celsius = cloud.temperature_c
    if steps.room_planes:
        planes += find_planes(cloud, loose & (celsius < low), MIN_COLD_PLANE_M2)
    loose &= ~close_to(planes, cloud.points_m)
    hot = loose & (celsius >= low)
    panel = np.zeros_like(hot)
    # A chest can be as flat: where a suit is known its colours tell a screen from one.
    for plane in find_planes(cloud, hot, MIN_PANEL_M2) if suit is None and steps.room_planes else ():
        panel |= panel_of(plane, cloud, hot)
    loose &= ~panel
    warm = loose & (celsius >= low) & (celsius <= high)
    nobody = (
        f"no person in the thermal and depth images: nothing of human size is {low:.1f} to {high:.1f} "
        "degrees warm; let somebody step into the view, or give the window of temperatures"
    )
    if not warm.any():
        zero = np.zeros(loose.shape, np.float32)
        return _Field("thermal", zero, warm, warm, planes, nobody)
    alignment = thermal_alignment(cloud, (low, high), _around(warm, EDGES_PX))
    pixels_per_m = cloud.camera.fx / float(np.median(cloud.points_m[..., 2][warm]))
    share = warmth_share(celsius, warm, (low, high), 2 * round(LOCAL_M * pixels_per_m) + 1)
    cold = share < SURELY_COLD
    near_warm = _around(warm, SURROUNDINGS_M * pixels_per_m)
    legs = loose & (share > FAINT) & _around(warm, LEGS_M * pixels_per_m)
    candidates = cloud.valid & (near_warm & (loose | ~cold) | legs) & ~panel
    warnings: tuple[str, ...] = ()
    if alignment.is_off:
        right, down = alignment.shift_px
        warnings = (
            f"thermal image lies {right:+.0f}, {down:+.0f} pixels (right, down) off the depth image, "
            f"{alignment.degrees(cloud.camera.fx):.1f} degrees: calibrate the thermal camera again; "
            "parts are undefined",
        )
    odds = by_warmth(share, celsius, high)
    odds += inherited(odds, cloud, candidates, REACH_M * pixels_per_m)
    return _Field("thermal", odds, candidates, cold, planes, nobody, warnings=warnings)


def _by_depth(cloud: ThermalCloud, planes: tuple[Plane, ...]) -> PersonMask:
    """Without temperature: the human-sized piece off the planes nearest to the view's middle."""
    labels, pieces = pieces_of(cloud, cloud.valid & ~close_to(planes, cloud.points_m), SPECK_M2)
    persons = [piece for piece in pieces if piece.is_human_sized]
    none = np.zeros(labels.shape, np.bool_)
    if not persons:
        note = (
            "no person in the depth image: no connected surface of human size; let somebody step into the "
            "view, and record temperature to tell people from things"
        )
        return PersonMask(none, "depth", none, (note,))
    chosen = labels == max(persons, key=_centrality).label
    note = "found by depth alone: things that touch the person are in the mask"
    warnings = cut(chosen)
    return PersonMask(chosen, "depth", none, (note, *warnings), not warnings)


def _was_felt(before: FrameLabels | None) -> bool:
    """Whether the frame before had a person found by temperature, or carried over from one that had."""
    return before is not None and before.notes.get("extraction") in ("thermal", "before")


def _centrality(piece: Piece) -> float:
    """Surface over squared distance, nearer to the middle of the view first."""
    x, y, z = piece.centre_m
    return float(piece.area_m2 / (z * z) * np.exp(-(x * x + y * y) / (z * z) / 0.5**2))


def _by_before(cloud: ThermalCloud, before: FrameLabels | None, planes: tuple[Plane, ...]) -> _Field | None:
    carried = by_before(cloud.depth_mm, before) if before is not None else None
    if before is None or carried is None:
        return None
    odds, still = carried
    loose = cloud.valid & ~close_to(planes, cloud.points_m)
    was = (persons_before(before) > 0) & (before.depth_mm > 0)
    pixels_per_m = cloud.camera.fx * 1000 / float(np.median(before.depth_mm[was]))
    candidates = cloud.valid & _around(was, SURROUNDINGS_M * pixels_per_m) & (loose | ~still)
    nobody = (
        "no person: no thermal image in this frame, and whoever was in the depth image before is gone; "
        "label again from a frame with both"
    )
    note = "no temperature in this frame: the person is carried over from the frame before"
    return _Field("before", odds, candidates, still, planes, nobody, (note,))


def _around(mask: Bool, reach_px: float) -> Bool:
    """A mask (h, w) grown by a square."""
    side = 2 * round(reach_px) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0, np.bool_)


class _Silhouettes:
    """Planes, colour and neighbours heard: who in a field is a person, as often as something new is known.

    field: what was heard before. odds: log odds (h, w) now. persons: everybody there, in no order.
    """

    def __init__(self, cloud: ThermalCloud, field: _Field, steps: Steps) -> None:
        self._cloud, self.field, self._steps = cloud, field, steps
        self._candidates = cloud.valid & _around(field.candidates, RIM_PX)
        normals = np.full_like(cloud.points_m, np.nan)
        own = normals_at(cloud, *np.nonzero(self._candidates))
        normals[self._candidates] = own
        near, on = close_to(field.planes, cloud.points_m), field.cold.copy()
        on[self._candidates] |= lies_on(field.planes, cloud.points_m[self._candidates], own)
        on &= near
        surface_m2 = cloud.points_m[..., 2] ** 2 / np.float32(cloud.camera.fx * cloud.camera.fy)
        shaped = np.isfinite(normals[..., 0])
        self.odds = field.odds + by_planes(on, near, shaped, field.cold, surface_m2)
        self._lab = lab_of(cloud.color_rgb, cloud.color_valid & ~_rims(cloud))
        self._taught = cloud.valid & _around(field.candidates, TAUGHT_PX)
        self._links = Links(self._candidates, cloud.points_m[..., 2], normals, self._lab)
        self.persons = self._persons()

    @property
    def surroundings(self) -> Bool:
        """Pixels (h, w) around what may be a person that surely are not."""
        return self._taught & ~self._candidates

    def beside(self, persons: Sequence[Person]) -> Bool:
        """Pixels (h, w) around the first of the persons that may be theirs too.

        What was taken for somebody too near to be another person is asked again: feet and a blanket.
        """
        first = persons[0]
        away_m = np.linalg.norm(self._cloud.points_m - first.centre_m.astype(np.float32), axis=-1)
        beside = _around(first.mask, BESIDE_PX) & (self.odds > LEAST_BESIDE)
        beside |= (away_m < BODY_M) & (self.odds > 0)
        beside &= self._candidates & ~first.mask
        for person in persons[1:]:
            if np.linalg.norm(person.centre_m - first.centre_m) > NEIGHBOUR_M:
                beside &= ~person.mask
        return np.asarray(beside, np.bool_)

    def _persons(self) -> list[Person]:
        """Everybody there."""
        if not self._candidates.any():
            return []
        persons = persons_of(self._cloud, self._links.settle(self._with_colors(self.odds)) > 0)
        return whole(self._cloud, persons) if self._steps.join_halves else persons

    def _with_colors(self, odds: Float32) -> Float32:
        """Log odds (h, w) to which those of the colours of person and room are added."""
        if not self._steps.room_colors:
            return odds
        return odds + by_color(self._lab, odds, self._candidates, self._taught)

    def dressed(self, persons: Sequence[Person], told: Float32) -> list[Person]:
        """The persons again, since colours have told (log odds (h, w), 0 = nothing) what is the first one's.

        What they wear is theirs, however far a blanket keeps it from the rest of them.
        """
        told = np.where(persons[0].mask & (told < 0) & (told > DOUBT), np.float32(0), told)
        odds = np.where(told != 0, told, self.odds + np.minimum(_between(told), 0))
        odds = np.where(told != 0, told, self._with_colors(odds))
        first, theirs = persons[0], self._links.settle(odds) > 0
        near = theirs & ((told > 0) | _around(first.mask, RIM_PX))
        for person in persons[1:]:
            near &= ~person.mask | (told > 0)
        if not near.any():
            return list(persons)
        others = [replace(person, mask=person.mask & ~near) for person in persons[1:]]
        return [replace(first, mask=np.asarray(near, np.bool_)), *(one for one in others if one.mask.any())]


def _between(told: Float32) -> Float32:
    """Mean (h, w) of the odds (h, w) told about what is around, 0 where nothing is."""
    total, count = (cv2.blur(one, (BETWEEN_PX,) * 2) for one in (told, (told != 0).astype(np.float32)))
    return np.asarray(np.where(count > 0.1, total / np.maximum(count, 0.1), 0), np.float32)


def _persons(
    cloud: ThermalCloud,
    silhouettes: _Silhouettes,
    suit: Suit | None,
    before: FrameLabels | None,
    engine: Engine,
) -> tuple[list[Person], Undecided | None]:
    """Everybody there, the subject first, by the colours of what they wear where these are known."""

    def ordered(persons: list[Person]) -> list[Person]:
        return sorted(persons, key=lambda person: -claim(person, before, cloud if suit else None))

    persons = ordered(silhouettes.persons)
    if suit is None or not persons:
        return persons, None
    beside, room = silhouettes.beside(persons), silhouettes.surroundings
    known = clues(cloud, persons[0].mask, beside, room, suit, silhouettes.odds, engine.weights.clothed)
    if known is None:
        return persons, None
    told = worn(known, engine.weights)
    if not engine.steps.suit_for_person:
        told = np.zeros_like(told)
    dressed = silhouettes.dressed(persons, told) if told.any() else persons

    def decided(told: Float32) -> Bool:
        return silhouettes.dressed(persons, told)[0].mask

    return dressed, Undecided(known, told, room, decided)


def _rims(cloud: ThermalCloud) -> Bool:
    """Pixels (h, w) beside a depth jump: colour is a pixel or two off there, in place and in time."""
    depth_mm, window = cloud.depth_mm, np.ones((RIM_PX * 2 + 1,) * 2, np.uint8)
    farthest = cv2.dilate(depth_mm, window)
    nearest = cv2.erode(np.where(cloud.valid, depth_mm, np.uint16(65535)), window)
    return np.asarray(farthest > nearest * (1 + RIM_JUMP), np.bool_)
