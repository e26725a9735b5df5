"""One subject's stay in front of the robot: the people, the things around them, and all temperatures.

Faces of the whole scene run: subject, visitor (if any), cushions, things, and what never moves.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Float32, Float64, Int32
from annotate.suit.palette import Suit
from sensors.rig.rig_calibration import Pose
from synth.appearance.outfit import Outfit, dress, dress_plainly
from synth.appearance.photograph import Setting, set_up
from synth.appearance.warmth import BodyWarmth, Clothing, surface_temperatures
from synth.body.body import Body, blend, hair_faces, shipped_bodies
from synth.clothes.dress import cut_loose
from synth.pose.pose_parameters import Moment
from synth.rig.difficulty import Difficulty
from synth.rig.locations import Place
from synth.rig.surroundings import furnish, invite
from synth.surface.furniture import Surface, empty_room
from synth.surface.rasterize import Mesh, face_means, merge, tagged

MOST_BLENDED = 0.35
"""Each subject is one of the shipped bodies with up to this share of another: all builds between them."""
PRIOR_MOMENTS, PRIOR_S = 8, 40.0
"""Postures of the subject before the recording, and seconds each was held: they warmed the seat. Chosen by
eye."""
SPOT_ASIDE_M, ROOM_TO_SIT_M, SPOT_HEAT = 0.35, 0.4, (0.35, 0.9)
"""Distance of a seat just left from the subject, half the width it needs, and what is left of its heat, least
and most. No source: chosen by eye."""
VISITOR_OFFSET_C = (-1.5, 1.0)
"""Ordinary clothes are thicker than the suit: mean and standard deviation; no source."""
BLACK_LUMINANCE, BLACK_LOSS = 0.04, 0.5
"""Cloth darker than this (linear, of 1) returns little infrared; it loses up to this share of what hair
loses. No source: dyes differ; libfreenect2's amplitude thresholds hit both."""


@dataclass(frozen=True)
class Tableau:
    """All that is before the cameras at one moment, world frame, metres.

    vertices_m: float32 (V, 3); following_m: the same one frame later. joints_m: (J, 3) of the subject.
    celsius: (F,) of every face.
    """

    vertices_m: Float32
    following_m: Float32
    joints_m: Float64
    celsius: Float64


@dataclass(frozen=True)
class Cast:
    """What does not change while a subject stays.

    faces: int32 (F, 3). tags: int32 (F,) part ids of the subject, ``Surface`` elsewhere. outfits: of subject
    and visitor, whose faces come first; subject, people: vertices of the first, and of both. setting: room
    colours and lamps. dark: float32 (F + 1,) in [0, 1], how little infrared comes back; the last for nothing.
    """

    name: str
    faces: Int32
    tags: Int32
    outfits: list[Outfit]
    subject: int
    people: int
    setting: Setting
    dark: Float32
    camera_from_world: Pose
    room_c: float
    clothing: Clothing


class Stay:
    """Subject ``number`` of a rig in a drawn place, with what stands about; ``tableaux`` plays it.

    Deterministic in (seed, number). body: of the subject, by default one of all builds. cast: what does not
    change.
    """

    def __init__(
        self,
        place: Callable[[np.random.Generator], Place],
        difficulty: Difficulty,
        suit: Suit,
        seed: int,
        number: int,
        frames_per_second: float,
        body: Body | None = None,
    ) -> None:
        rng, bodies = np.random.default_rng((seed, number)), shipped_bodies()
        self._fps, self._motion = frames_per_second, np.random.default_rng((seed, number, 7))
        self._difficulty = difficulty
        own, like = bodies[(number + seed) % len(bodies)], bodies[int(rng.integers(len(bodies)))]
        build = blend(own, like, float(rng.uniform(0, MOST_BLENDED)))
        self._skin = build if body is None else body
        tailor = np.random.default_rng((seed, number, 13))
        self._body, self._place = self._wear(self._skin, tailor), place(rng)
        self._room_c = float(rng.uniform(*difficulty.room_c))
        self._cushions = self._place.cushions()
        camera_from_world = self._place.robot_eye(rng, difficulty.stray)
        behaviour = self._place.behaviour
        prior = [behaviour.pose(self._body, behaviour.draw(rng))[0] for _ in range(PRIOR_MOMENTS)]
        self._things = furnish(self._place, self._body, prior, difficulty.clutter, rng)
        other = bodies[int(rng.integers(len(bodies)))]
        come = rng.random() < difficulty.clutter.company
        self._visitor_skin, around = other, (self._place, self._things, prior)
        worn = self._wear(other, tailor)
        self._visitor = invite(*around, worn, camera_from_world, rng) if come else None
        clothing = Clothing.sample(rng, difficulty.warmth)
        self._warmth = BodyWarmth(self._skin, clothing, self._room_c, rng, self._body)
        if difficulty.warmth > 0:
            for vertices in prior:
                self._press(vertices, PRIOR_S)
        if rng.random() < difficulty.clutter.warm_spot:
            self._leave_warm_spot(prior[-1], rng)
        self._still = self._stage()
        self._visitor_c, self._things_c = self._steady_temperatures(rng)
        self.cast = self._cast(f"subject-{number}", suit, camera_from_world, clothing, rng)

    def tableaux(self) -> Iterator[Tableau]:
        """An endless stream, frame by frame."""
        own, visitor = self._place.behaviour.stream(self._motion, self._fps), self._visitor
        others = visitor.behaviour.stream(self._motion.spawn(1)[0], self._fps) if visitor else None
        now = self._tableau(next(own), next(others) if others else None)
        while True:
            following = self._tableau(next(own), next(others) if others else None)
            yield replace(now, following_m=following.vertices_m)
            now = following

    def _wear(self, skin: Body, rng: np.random.Generator) -> Body:
        """The body with what it wears for a skin: the skin itself, or loose clothes."""
        return cut_loose(skin, rng) if rng.random() < self._difficulty.loose else skin

    def _tableau(self, moment: Moment, other: Moment | None) -> Tableau:
        """The next moment; ``following_m`` is not known yet."""
        person, joints = self._place.behaviour.pose(self._body, moment)
        vertices = [person]
        if self._visitor is not None and other is not None:
            vertices.append(self._visitor.pose(other))
        dents = self._press(person, 1 / self._fps)
        vertices += [c.vertices(dent) for c, dent in zip(self._cushions, dents, strict=True)]
        vertices += [thing.vertices(person, joints) for thing in self._things]
        whole = np.concatenate([*vertices, self._still.vertices_m])
        cushions_c = [cushion.celsius(self._room_c) for cushion in self._cushions]
        celsius = np.concatenate([self._warmth.celsius(), self._visitor_c, *cushions_c, self._things_c])
        return Tableau(whole, whole, joints, celsius)

    def _press(self, person_m: Float32, seconds: float) -> list[Float64]:
        """Let a posture last so long: it dents the cushions, and seat and person warm each other."""
        points = np.concatenate([person_m, face_means(person_m, self._body.faces)])
        dents = [cushion.press(points) for cushion in self._cushions]
        if self._difficulty.warmth > 0:
            for cushion, dent in zip(self._cushions, dents, strict=True):
                cushion.warm(dent, seconds)
            pressed = np.zeros(len(person_m), np.bool_)
            for solid in self._place.furniture.solids():
                pressed |= solid.depth_m(person_m) > 0
            self._warmth.update(person_m, pressed, seconds)
        return dents

    def _leave_warm_spot(self, person_m: Float32, rng: np.random.Generator) -> None:
        """Where there is room beside the subject, somebody got up a moment ago."""
        room = self._place.furniture.footprint.half_width_m - ROOM_TO_SIT_M
        if room > SPOT_ASIDE_M:
            aside = rng.choice((-1, 1)) * rng.uniform(SPOT_ASIDE_M, room)
            heat = float(rng.uniform(*SPOT_HEAT))
            for cushion in self._cushions:
                cushion.leave_warm(cushion.press(person_m + np.array([aside, 0, 0], np.float32)), heat)

    def _stage(self) -> Mesh:
        """What never moves: the room, and furniture that does not give."""
        meshes = [empty_room(self._place.wall_y)]
        meshes += [solid.mesh() for solid in self._place.hard_solids()]
        return merge(meshes + (self._visitor.furniture() if self._visitor else []))

    def _steady_temperatures(self, rng: np.random.Generator) -> tuple[Float64, Float64]:
        """Temperatures of the visitor's faces, and of things and stage: they stay as they are."""
        strength, visitor_c = self._difficulty.warmth, np.zeros(0)
        if self._visitor is not None:
            clothing = replace(Clothing.sample(rng, strength), offset_c=float(rng.normal(*VISITOR_OFFSET_C)))
            worn = (self._room_c, rng, self._visitor.body)
            visitor_c = BodyWarmth(self._visitor_skin, clothing, *worn).celsius()
        tags = np.concatenate([*(thing.mesh.tags for thing in self._things), self._still.tags])
        return visitor_c, surface_temperatures(tags, self._room_c, strength, rng)

    def _cast(
        self, name: str, suit: Suit, camera_from_world: Pose, clothing: Clothing, rng: np.random.Generator
    ) -> Cast:
        color, bodies = self._difficulty.color, [self._skin]
        outfits = [dress(self._skin, suit, color.wear, rng)]
        meshes = [Mesh(self._body.vertices_m, self._body.faces, self._body.face_parts.astype(np.int32))]
        if self._visitor is not None:
            bodies.append(self._visitor_skin)
            outfits.append(dress_plainly(bodies[1], color.wear, rng))
            meshes.append(tagged(bodies[1].vertices_m, bodies[1].faces, Surface.OTHER_PERSON))
        people = sum(len(mesh.vertices_m) for mesh in meshes)
        setting = set_up(color, suit, rng)
        meshes += [c.mesh for c in self._cushions] + [t.mesh for t in self._things] + [self._still]
        whole = merge(meshes)
        dark, subject = _darkness(bodies, outfits, setting.room.rgb[whole.tags]), len(self._body.vertices_m)
        scene = (name, whole.faces, whole.tags, outfits, subject, people, setting, dark)
        return Cast(*scene, camera_from_world, self._room_c, clothing)


def _darkness(bodies: list[Body], outfits: list[Outfit], rgb: Float64) -> Float32:
    """How little infrared faces return, (F + 1,) in [0, 1]: hair little, black cloth less than others.

    rgb: linear (F, 3) of all faces, where those of the bodies come first and are taken from the outfits.
    """
    cloth = np.concatenate([o.face_rgb(body.faces) for body, o in zip(bodies, outfits, strict=True)])
    hair = np.concatenate([hair_faces(body) for body in bodies])
    luminance = np.concatenate([cloth, rgb[len(cloth) :]]) @ (0.2126, 0.7152, 0.0722)
    dark = BLACK_LOSS * np.clip(1 - luminance / BLACK_LUMINANCE, 0, 1)
    dark[: len(hair)] = np.maximum(dark[: len(hair)], hair)
    return np.append(dark, 0).astype(np.float32)
