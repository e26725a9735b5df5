"""Episode of one subject in front of the robot: people, nearby objects and temperatures.

The faces of the scene are in this order: subject, visitor (if any), cushions, objects, fixed furniture and
room.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64, Int32
from annotate.suit.palette import Suit
from sensors.rig.rig_calibration import Pose
from synth.appearance.outfit import Outfit, dress, dress_plainly
from synth.appearance.photograph import Setting, set_up
from synth.appearance.warmth import BodyWarmth, Clothing, surface_temperatures
from synth.body.atlas_border import face_regions
from synth.body.body import Body, blend, hair_faces
from synth.body.crowd import suit_wearers
from synth.clothes.dress import cut_loose
from synth.data_files import TRAINING, Cast
from synth.pose.pose_parameters import Moment
from synth.rig.difficulty import Difficulty
from synth.rig.locations import Location
from synth.rig.surroundings import Guest, furnish, invite
from synth.rig.warm_things import lay_warm_things
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, face_means, merge, tagged

MOST_BLENDED = 0.35  # share of another shipped body in a subject
PRIOR_MOMENTS, PRIOR_S = 8, 40.0  # postures before the recording, which warm the seat, and their duration
SPOT_ASIDE_M, ROOM_TO_SIT_M = 0.35, 0.4  # of a warm spot from the subject, and half its width; untuned
SPOT_HEAT = (0.35, 0.9)  # of a warm spot; untuned
VISITOR_OFFSET_C = (-1.5, 1.0)  # of clothes thicker than the suit, mean and standard deviation; untuned
BLACK_LUMINANCE, BLACK_LOSS = 0.04, 0.5  # black cloth loses up to this share of hair's loss; untuned


@dataclass(frozen=True)
class SceneState:
    """Scene in one frame, world frame, metres.

    vertices_m: float32 (V, 3); following_m: the same one frame later. joints_m: (J, 3) of the subject.
    celsius: (F,).
    """

    vertices_m: Float32
    following_m: Float32
    joints_m: Float64
    celsius: Float64


@dataclass(frozen=True)
class Scene:
    """Properties of a scene that are constant during an episode.

    bodies: names, of which the subject is a blend.
    faces: int32 (F, 3). tags: int32 (F,) region ids of the subject, ``Surface`` elsewhere. outfits: of
    subject and visitor. subject, people: number of the subject's vertices, and of both people's. dark:
    float32 (F + 1,) absorbed share of infrared, last for no face.
    """

    name: str
    bodies: tuple[str, ...]
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


class EpisodeSetup(NamedTuple):
    """Settings that all episodes of a rig have in common.

    location: draws the place of an episode. body: body of the subject; None = draw one at random. wearers:
    bodies to draw from; None = all of the cast's. warm_things: share of subjects beside whom warm things lie.
    """

    location: Callable[[np.random.Generator], Location]
    difficulty: Difficulty
    suit: Suit
    seed: int
    frames_per_second: float
    body: Body | None = None
    cast: Cast = TRAINING
    wearers: tuple[Body, ...] | None = None
    warm_things: float = 0.0


def blended_bodies(cast: Cast, seed: int, number: int) -> tuple[str, str]:
    """Return the names of the two bodies of subject ``number`` of a cast's virtual rig."""
    own, like = _drawn(suit_wearers(cast), seed, number, np.random.default_rng((seed, number)))
    return own.name, like.name


def _drawn(bodies: tuple[Body, ...], seed: int, number: int, rng: np.random.Generator) -> tuple[Body, Body]:
    """Draw the body of subject ``number`` and the body that it is blended with."""
    return bodies[(number + seed) % len(bodies)], bodies[int(rng.integers(len(bodies)))]


class Episode:
    """Episode of subject ``number`` of a rig at a random location; deterministic in (seed, number)."""

    def __init__(self, setup: EpisodeSetup, number: int) -> None:
        seed, difficulty, bodies = setup.seed, setup.difficulty, setup.wearers or suit_wearers(setup.cast)
        rng, self._fps = np.random.default_rng((seed, number)), setup.frames_per_second
        self._motion, tailor = (np.random.default_rng((seed, number, key)) for key in (7, 13))
        self._difficulty, self._cast = difficulty, setup.cast
        own, like = _drawn(bodies, seed, number, rng)
        self.bodies = (own.name, like.name) if setup.body is None else (setup.body.name,)
        build = blend(own, like, float(rng.uniform(0, MOST_BLENDED)))
        self._skin = build if setup.body is None else setup.body
        self._body, self._location = self._wear(self._skin, tailor), setup.location(rng)
        self._room_c = float(rng.uniform(*difficulty.room_c))
        self._cushions = self._location.cushions()
        camera_from_world = self._location.robot_eye(rng, difficulty.stray)
        behaviour = self._location.behaviour
        prior = [behaviour.pose(self._body, behaviour.draw(rng))[0] for _ in range(PRIOR_MOMENTS)]
        self._things = furnish(self._location, self._body, prior, difficulty.clutter, rng)
        things_rng = np.random.default_rng((seed, number, 17))
        if things_rng.random() < setup.warm_things:
            self._things += lay_warm_things(self._location, prior, things_rng)
        other = bodies[int(rng.integers(len(bodies)))]
        come = rng.random() < difficulty.clutter.company
        self._visitor_skin, worn = other, self._wear(other, tailor)
        standing = [t.mesh.vertices_m for t in self._things if t.name in ("table", "radiator")]
        occupied = [*prior, *standing]
        guest = Guest(worn, setup.cast)
        self._visitor = invite(self._location, occupied, guest, camera_from_world, rng) if come else None
        clothing = Clothing.sample(rng, difficulty.warmth)
        self._warmth = BodyWarmth(self._skin, clothing, self._room_c, rng, self._body)
        if difficulty.warmth > 0:
            for vertices in prior:
                self._press(vertices, PRIOR_S)
        if rng.random() < difficulty.clutter.warm_spot:
            self._leave_warm_spot(prior[-1], rng)
        room = self._location.room.mesh(self._location.wall_y)
        fixed = [room, *(solid.mesh() for solid in self._location.hard_solids())]
        self._fixed = merge(fixed + (self._visitor.furniture() if self._visitor else []))
        self._visitor_c, self._things_c = self._fixed_temperatures(rng)
        outfits = self._dress(setup.suit, rng)
        setting = set_up(difficulty.color, setup.suit, rng, setup.cast)
        self.scene = self._scene(f"subject-{number}", outfits, setting, camera_from_world, clothing)

    def states(self) -> Iterator[SceneState]:
        """Yield the scene frame by frame, without end."""
        own, visitor = self._location.behaviour.stream(self._motion, self._fps), self._visitor
        others = visitor.behaviour.stream(self._motion.spawn(1)[0], self._fps) if visitor else None
        now = self._state(next(own), next(others) if others else None)
        while True:
            following = self._state(next(own), next(others) if others else None)
            yield replace(now, following_m=following.vertices_m)
            now = following

    def _wear(self, skin: Body, rng: np.random.Generator) -> Body:
        return cut_loose(skin, rng, self._cast) if rng.random() < self._difficulty.loose else skin

    def _state(self, moment: Moment, other: Moment | None) -> SceneState:
        person, joints = self._location.behaviour.pose(self._body, moment)
        vertices = [person]
        if self._visitor is not None and other is not None:
            vertices.append(self._visitor.pose(other))
        dents = self._press(person, 1 / self._fps)
        vertices += [c.vertices(dent) for c, dent in zip(self._cushions, dents, strict=True)]
        vertices += [thing.vertices(person, joints) for thing in self._things]
        whole = np.concatenate([*vertices, self._fixed.vertices_m])
        cushions_c = [cushion.celsius(self._room_c) for cushion in self._cushions]
        celsius = np.concatenate([self._warmth.celsius(), self._visitor_c, *cushions_c, self._things_c])
        return SceneState(whole, whole, joints, celsius)

    def _press(self, person_m: Float32, seconds: float) -> list[Float64]:
        """Warm seat and person by some seconds in one posture; return the dents of the cushions."""
        points = np.concatenate([person_m, face_means(person_m, self._body.faces)])
        dents = [cushion.press(points) for cushion in self._cushions]
        if self._difficulty.warmth > 0:
            for cushion, dent in zip(self._cushions, dents, strict=True):
                cushion.warm(dent, seconds)
            pressed = np.zeros(len(person_m), np.bool_)
            for solid in self._location.furniture.solids():
                pressed |= solid.depth_m(person_m) > 0
            self._warmth.update(person_m, pressed, seconds)
        return dents

    def _leave_warm_spot(self, person_m: Float32, rng: np.random.Generator) -> None:
        """Warm a free seat beside the subject, as if a person had just left it."""
        room = self._location.furniture.top.half_width_m - ROOM_TO_SIT_M
        if room > SPOT_ASIDE_M:
            aside = rng.choice((-1, 1)) * rng.uniform(SPOT_ASIDE_M, room)
            heat = float(rng.uniform(*SPOT_HEAT))
            for cushion in self._cushions:
                cushion.leave_warm(cushion.press(person_m + np.array([aside, 0, 0], np.float32)), heat)

    def _fixed_temperatures(self, rng: np.random.Generator) -> tuple[Float64, Float64]:
        strength, visitor_c = self._difficulty.warmth, np.zeros(0)
        if self._visitor is not None:
            clothing = replace(Clothing.sample(rng, strength), offset_c=float(rng.normal(*VISITOR_OFFSET_C)))
            worn = (self._room_c, rng, self._visitor.body)
            visitor_c = BodyWarmth(self._visitor_skin, clothing, *worn).celsius()
        tags = np.concatenate([*(thing.mesh.tags for thing in self._things), self._fixed.tags])
        return visitor_c, surface_temperatures(tags, self._room_c, strength, rng)

    def _dress(self, suit: Suit, rng: np.random.Generator) -> list[Outfit]:
        wear = self._difficulty.color.wear
        outfits = [dress(self._skin, suit, wear, rng, self._cast)]
        if self._visitor:
            outfits.append(dress_plainly(self._visitor_skin, wear, rng, self._cast))
        return outfits

    def _scene(
        self, name: str, outfits: list[Outfit], setting: Setting, camera_from_world: Pose, clothing: Clothing
    ) -> Scene:
        bodies = [self._skin, self._visitor_skin][: len(outfits)]
        meshes = [Mesh(self._body.vertices_m, self._body.faces, face_regions(self._skin).astype(np.int32))]
        meshes += [tagged(b.vertices_m, b.faces, Surface.OTHER_PERSON) for b in bodies[1:]]
        subject, people = len(self._body.vertices_m), sum(len(mesh.vertices_m) for mesh in meshes)
        meshes += [c.mesh for c in self._cushions] + [t.mesh for t in self._things] + [self._fixed]
        whole = merge(meshes)
        dark = _darkness(bodies, outfits, setting.room.rgb[whole.tags])
        scene = (name, self.bodies, whole.faces, whole.tags, outfits, subject, people, setting, dark)
        return Scene(*scene, camera_from_world, self._room_c, clothing)


def _darkness(bodies: list[Body], outfits: list[Outfit], rgb: Float64) -> Float32:
    """Return the absorbed share of infrared (F + 1,) of hair and black cloth.

    rgb: linear (F, 3) of all faces; the bodies' faces are first and have the outfits' colours.
    """
    cloth = np.concatenate([o.face_rgb(body.faces) for body, o in zip(bodies, outfits, strict=True)])
    hair = np.concatenate([hair_faces(body) for body in bodies])
    luminance = np.concatenate([cloth, rgb[len(cloth) :]]) @ (0.2126, 0.7152, 0.0722)
    dark = BLACK_LOSS * np.clip(1 - luminance / BLACK_LUMINANCE, 0, 1)
    dark[: len(hair)] = np.maximum(dark[: len(hair)], hair)
    return np.append(dark, 0).astype(np.float32)
