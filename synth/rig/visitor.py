"""Somebody else in the room: at the edge of the view, in ordinary clothes, touching nobody."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float32, Float64
from sensors.rig.rig_calibration import Pose
from synth.body.body import Body
from synth.pose.moment import Behaviour, Moment
from synth.pose.sitting import on_seat
from synth.pose.upright import on_legs
from synth.rig.place import ROOM_HALF_WIDTH_M, Place
from synth.rig.props import Thing, moved
from synth.surface.furniture import Chair
from synth.surface.rasterize import Mesh

HALF_VIEW_RAD = np.radians(35.0)
"""Half the Kinect's horizontal field of view (512 px at f = 365 px)."""
AT_EDGE = (0.65, 1.05)
"""Where they stand in the view: 0 its middle, 1 its edge."""
AWAY_M = (1.6, 3.6)
"""From the robot."""
KEEP_M = 0.45
"""From what the subject and the furniture reach, measured to the middle of the body."""
TRIES = 200
"""Places tried before nobody comes."""
SEATED = ("resting", "crossed_left", "gadget", "reading")
"""What somebody on a chair does."""


@dataclass(frozen=True)
class Visitor:
    """Another person standing or sitting somewhere. turn_rad, at_m: from the body's place to the world."""

    body: Body
    chair: Chair | None
    behaviour: Behaviour
    at_m: Float64
    turn_rad: float

    def pose(self, moment: Moment) -> Float32:
        """Float32 (V, 3), world."""
        vertices, _ = self.behaviour.pose(self.body, moment)
        rotation = Rotation.from_euler("z", self.turn_rad).as_matrix()
        return np.asarray(vertices @ rotation.T + self.at_m, np.float32)

    def furniture(self) -> list[Mesh]:
        """What they sit on, world."""
        return [] if self.chair is None else [moved(self.chair.mesh(), self.at_m, self.turn_rad)]


def invite(
    place: Place,
    things: list[Thing],
    prior: list[Float32],
    body: Body,
    camera: Pose,
    rng: np.random.Generator,
) -> Visitor | None:
    """Somebody near the edge of the view who has room there, or None.

    prior: earlier postures (V, 3) of the subject, whose reach is kept free. camera: from the world.
    """
    footprint = place.furniture.footprint
    low: Float64 = np.array([-footprint.half_width_m, footprint.front_y])
    high: Float64 = np.array([footprint.half_width_m, footprint.back_y])
    for vertices in [*prior, *(t.mesh.vertices_m for t in things if t.name in ("table", "radiator"))]:
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
        indoors = abs(at[0]) < ROOM_HALF_WIDTH_M - room and at[1] < place.wall_y - room
        if indoors and np.hypot(*np.maximum(outside, 0)) >= room:
            # A body faces -y; it looks roughly at the subject.
            turn = np.arctan2(-at[1], -at[0]) + np.pi / 2 + rng.normal(0, 0.5)
            chair = Chair.sample(rng) if sits else None
            behaviour = on_seat(chair, *SEATED) if chair else on_legs(None, "standing")
            return Visitor(body, chair, behaviour, np.array([*at, 0.0]), float(turn))
    return None
