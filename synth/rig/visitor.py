"""Somebody else in the room: at the edge of the view, in ordinary clothes, touching nobody."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.rig.rig_calibration import Pose
from synth.body.body import Body
from synth.pose.moment import Behaviour, Moment
from synth.pose.sitting import on_seat
from synth.pose.upright import on_legs
from synth.rig.props import moved
from synth.surface.arrays import Float32, Float64
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


def find_visitor(
    body: Body,
    reach: tuple[Float64, Float64],
    wall_y: float,
    half_room_m: float,
    camera_from_world: Pose,
    rng: np.random.Generator,
) -> Visitor | None:
    """Somebody near the edge of the view who has room there, or None.

    reach: lowest and highest (x, y) that the subject and the furniture come to. wall_y,
    half_room_m: back and side walls.
    """
    inverse = camera_from_world.inverse()
    eye, forward = inverse.translation_m[:2], inverse.rotation[:2, 2]
    heading = np.arctan2(forward[1], forward[0])
    for _ in range(TRIES):
        aside = rng.choice((-1, 1)) * HALF_VIEW_RAD * rng.uniform(*AT_EDGE)
        distance, sits = rng.uniform(*AWAY_M), rng.random() < 0.3
        at = eye + distance * np.array([np.cos(heading + aside), np.sin(heading + aside)])
        outside = np.maximum(reach[0] - at, at - reach[1])
        room = KEEP_M + (0.35 if sits else 0.0)
        indoors = abs(at[0]) < half_room_m - room and at[1] < wall_y - room
        if indoors and np.hypot(*np.maximum(outside, 0)) >= room:
            # A body faces -y; it looks roughly at the subject.
            turn = np.arctan2(-at[1], -at[0]) + np.pi / 2 + rng.normal(0, 0.5)
            chair = Chair.sample(rng) if sits else None
            behaviour = on_seat(chair, *SEATED) if chair else on_legs(None, "standing")
            return Visitor(body, chair, behaviour, np.array([*at, 0.0]), float(turn))
    return None
