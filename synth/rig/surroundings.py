"""Surroundings of the subject: objects and a visitor, drawn at random and placed in free space."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float32, Float64
from sensors.rig.rig_calibration import Pose
from synth.body.body import Body
from synth.data_files import JUDGE, TRAINING, Cast
from synth.pose.pose_parameters import Behaviour, Moment
from synth.pose.postures import on_legs, on_seat
from synth.rig.blanket import bed_blanket, lap_blanket
from synth.rig.difficulty import Clutter
from synth.rig.locations import Location
from synth.rig.objects_nearby import Thing, laptop, moved, mug, on_wall, table
from synth.surface.furniture import Chair, Seat
from synth.surface.judge_furniture import draw_chair
from synth.surface.rasterize import Mesh

ASIDE_M, ASIDE_HEIGHT_M = 0.34, (0.42, 0.56)  # a side table's distance and height, as sold
LOW_TABLE_M, LOW_HEIGHT_M = (0.9, 0.45), (0.38, 0.46)  # a couch table's size and height, as sold
ON_LAP = 0.6  # share of laptops used on the lap; untuned
FREE_M = 0.12  # between a couch table and the farthest foot
HALF_VIEW_RAD = np.radians(35.0)  # half a Kinect's horizontal field of view (512 px at f = 365 px)
AT_EDGE = (0.65, 1.05)  # place of a visitor in the view: 0 its middle, 1 its edge
AWAY_M = (1.6, 3.6)  # of a visitor from the robot
KEEP_M = 0.45  # from the reach of subject and furniture to the middle of the visitor
TRIES = 200  # places drawn for a visitor
SEATED: dict[Cast, tuple[str, ...]] = {
    TRAINING: ("resting", "crossed_left", "gadget", "reading"),
    JUDGE: ("watching", "arms_folded", "ankle_on_knee_left", "phoning_right"),
}  # activities of a sitting visitor
ON_LEGS: dict[Cast, str] = {TRAINING: "standing", JUDGE: "waiting"}  # activity of a standing visitor


def furnish(
    location: Location, body: Body, prior: list[Float32], clutter: Clutter, rng: np.random.Generator
) -> list[Thing]:
    """Draw the objects near a subject. prior: earlier postures (V, 3) of the subject, whose space is kept
    free.
    """
    has = {name: bool(rng.random() < share) for name, share in vars(clutter).items()}
    footprint = location.furniture.footprint
    side, lies = float(rng.choice((-1, 1))), location.lies
    things, stands = [], []
    if has["low_table"] and not lies:
        foot = min(footprint.front_y, *(float(vertices[:, 1].min()) for vertices in prior))
        middle = np.array(
            [rng.normal(0, 0.2), foot - FREE_M - LOW_TABLE_M[1] / 2, rng.uniform(*LOW_HEIGHT_M)]
        )
        things.append(table(middle, LOW_TABLE_M))
        stands += [middle + np.array([x, 0.0, 0.0]) for x in (-0.27, 0.2)]
    if (has["mug"] or has["laptop"]) and len(stands) < 2:
        x = side * (footprint.half_width_m + ASIDE_M)
        y = footprint.back_y - 0.4 if lies else rng.uniform(0.0, 0.3)
        middle = np.array([x, y, rng.uniform(*ASIDE_HEIGHT_M)])
        things.append(table(middle, (0.45, 0.45)))
        stands += [middle + np.array(off) for off in ((0.1 * side, 0.1, 0.0), (0.0, -0.08, 0.0))]
    if has["mug"]:
        things.append(mug(stands[0], body, held=not lies))
    if has["laptop"]:
        lap = bool(rng.random() < ON_LAP) and isinstance(location.furniture, Seat)
        things.append(laptop(stands[1], body, on_lap=lap))
    if has["blanket"] and location.furniture.soft:
        cover = bed_blanket if lies else lap_blanket
        things.append(cover(location, body, rng))
    beside = footprint.half_width_m + rng.uniform(0.3, 0.7)
    if has["radiator"]:
        things.append(on_wall("radiator", -side * beside, location.wall_y))
    if has["window"]:
        things.append(on_wall("window", rng.uniform(-1.4, 1.4), location.wall_y))
    elif has["sunlit"]:
        things.append(on_wall("sunlit wall", rng.uniform(-1.2, 1.2), location.wall_y))
    return things


@dataclass(frozen=True)
class Visitor:
    """Second person, standing or sitting. turn_rad, at_m: pose world from body."""

    body: Body
    chair: Chair | None
    behaviour: Behaviour
    at_m: Float64
    turn_rad: float

    def pose(self, moment: Moment) -> Float32:
        """Return the vertices, float32 (V, 3), metres, world frame."""
        vertices, _ = self.behaviour.pose(self.body, moment)
        rotation = Rotation.from_euler("z", self.turn_rad).as_matrix()
        return np.asarray(vertices @ rotation.T + self.at_m, np.float32)

    def furniture(self) -> list[Mesh]:
        """Return the mesh of the visitor's chair in a list, world frame; empty without a chair."""
        return [] if self.chair is None else [moved(self.chair.mesh(), self.at_m, self.turn_rad)]


class Guest(NamedTuple):
    """Body of a visitor, and the cast of the visitor's poses and chair."""

    body: Body
    cast: Cast


def invite(
    location: Location, occupied: list[Float32], guest: Guest, camera: Pose, rng: np.random.Generator
) -> Visitor | None:
    """Draw a visitor near the edge of the view, or None without free space.

    occupied: vertices (V, 3) to keep free. camera: from world.
    """
    body, cast = guest
    footprint = location.furniture.footprint
    low: Float64 = np.array([-footprint.half_width_m, footprint.front_y])
    high: Float64 = np.array([footprint.half_width_m, footprint.back_y])
    for vertices in occupied:
        low = np.minimum(low, vertices[:, :2].min(axis=0))
        high = np.maximum(high, vertices[:, :2].max(axis=0))
    inverse = camera.inverse()
    eye, forward = inverse.translation_m[:2], inverse.rotation[:2, 2]
    heading = np.arctan2(forward[1], forward[0])
    for _ in range(TRIES):
        aside = rng.choice((-1, 1)) * HALF_VIEW_RAD * rng.uniform(*AT_EDGE)
        distance, sits = rng.uniform(*AWAY_M), rng.random() < 0.3
        at = eye + distance * np.array([np.cos(heading + aside), np.sin(heading + aside)])
        outside = np.maximum(low - at, at - high)
        room = KEEP_M + (0.35 if sits else 0.0)
        indoors = location.room.left_x + room < at[0] < location.room.right_x - room
        indoors &= bool(at[1] < location.wall_y - room)
        if indoors and np.hypot(*np.maximum(outside, 0)) >= room:
            # A body faces -y; the visitor looks roughly at the subject.
            turn = np.arctan2(-at[1], -at[0]) + np.pi / 2 + rng.normal(0, 0.5)
            chair = draw_chair(cast, rng) if sits else None
            if chair:
                behaviour = on_seat(chair, *SEATED[cast], cast=cast)
            else:
                behaviour = on_legs(None, ON_LEGS[cast], cast=cast)
            return Visitor(body, chair, behaviour, np.array([*at, 0.0]), float(turn))
    return None
