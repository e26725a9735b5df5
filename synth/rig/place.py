"""Where the rig's person is: sofa, chair or bed, how it is posed there, and where the robot stands."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CloudError
from sensors.rig.rig_calibration import Pose
from synth.body.body import Body
from synth.body.skeleton import Float64
from synth.pose.recumbent import IN_BED, RECUMBENT, lie
from synth.pose.sitting import SITTING, sit
from synth.rig.cushion import Cushion, Side
from synth.surface.furniture import Bed, Chair, Sofa, Solid, beside, look_at

SCENES = ("sofa", "chair", "bed")
PUFF_M = {"sofa": 0.012, "chair": 0.0, "bed": 0.006}
"""How far a cushion bulges in its middle; no source, upholstery looks like it."""
SOFA_GIVE_M = (0.015, 0.045)
"""How deep a sitter sinks: from firm to soft foam; no source."""
BED_AZIMUTH_RAD = (np.radians(25.0), np.radians(110.0))
"""From the foot, to either side: the head of the bed stands at the wall, and from its very foot somebody who
lies is mostly feet."""


@dataclass(frozen=True)
class Place:
    """A piece of furniture before a wall, with a robot before it. World frame, metres.

    half_width_m, front_y, back_y: its footprint, centred on x = 0. wall_y: the wall behind it.
    """

    furniture: Sofa | Chair | Bed
    half_width_m: float
    front_y: float
    back_y: float
    wall_y: float
    puff_m: float

    @staticmethod
    def sample(scene: str, rng: np.random.Generator) -> "Place":
        """A place of that kind. Raises CloudError for an unknown scene."""
        furniture: Sofa | Chair | Bed
        if scene == "sofa":
            furniture = replace(Sofa.sample(rng), give_m=rng.uniform(*SOFA_GIVE_M))
            half, front, back = furniture.width / 2 + furniture.arm_width, 0.0, furniture.depth + 0.3
        elif scene == "chair":
            furniture = Chair.sample(rng)
            half, front, back = furniture.width / 2, 0.0, furniture.depth + 0.12
        elif scene == "bed":
            furniture = Bed.sample(rng)
            half, front, back = furniture.width / 2, -furniture.length / 2, furniture.length / 2 + 0.05
        else:
            raise CloudError(f"scene {scene!r} is unknown; use {', '.join(SCENES)}")
        gap = rng.uniform(0.02, 0.1) if scene == "bed" else rng.uniform(0.3, 1.1)
        return Place(furniture, half, front, back, back + gap, PUFF_M[scene])

    def moments(self, rng: np.random.Generator, frames_per_second: float) -> Iterator[Any]:
        """What somebody does here, moment by moment."""
        if isinstance(self.furniture, Bed):
            return RECUMBENT.moments(rng, frames_per_second, tuple(IN_BED))
        return SITTING.moments(rng, frames_per_second, tuple(SITTING.activities))

    def draw(self, rng: np.random.Generator) -> Any:  # noqa: ANN401 - a moment of either family
        """A moment of any activity."""
        if isinstance(self.furniture, Bed):
            return RECUMBENT.draw(str(rng.choice(tuple(IN_BED))), rng)
        return SITTING.draw(str(rng.choice(tuple(SITTING.activities))), rng)

    def pose(self, body: Body, moment: Any) -> tuple[NDArray[np.float32], Float64]:  # noqa: ANN401
        """Vertices (V, 3) and joints (J, 3) of a body in a moment of ``moments``."""
        if isinstance(self.furniture, Bed):
            return lie(body, self.furniture, moment)
        return sit(body, self.furniture, moment)

    @property
    def seat_height_m(self) -> float:
        """What carries the person, over the floor."""
        return self.furniture.height if isinstance(self.furniture, Bed) else self.furniture.seat_height

    def cushions(self) -> list[Cushion]:
        """What of it is soft and carries: seat and back rest, arm rests, mattress and pillow."""
        solids = self.furniture.solids()
        return [Cushion(solids[i], side, self.puff_m) for i, side in enumerate(self._soft())]

    def hard_solids(self) -> list[Solid]:
        """The rest of it."""
        return self.furniture.solids()[len(self._soft()) :]

    def robot_eye(self, rng: np.random.Generator, stray: float) -> Pose:
        """``camera_from_world`` of a robot that looks at the person, ``stray`` times as well as it can."""
        roll = np.radians(rng.normal(0, 1.5))
        if isinstance(self.furniture, Bed):
            azimuth, distance = rng.choice((-1, 1)) * rng.uniform(*BED_AZIMUTH_RAD), rng.uniform(1.7, 2.4)
            height = self.furniture.height + rng.uniform(0.7, 1.6)
            target = np.array([0.0, 0.0, self.furniture.height]) + stray * rng.normal(0, (0.08, 0.12, 0.05))
        else:
            azimuth, distance = np.radians(rng.uniform(-40, 40)), rng.uniform(1.9, 2.5)
            height = rng.uniform(1.0, 1.35)
            target = np.array([0.0, 0.0, 0.68]) + stray * rng.normal(0, 0.06, 3)
        return look_at(beside(np.zeros(3), azimuth, distance, height), target, roll)

    def _soft(self) -> tuple[Side, ...]:
        """The soft side of each of the first solids."""
        if isinstance(self.furniture, Sofa):
            return ("top", "front", "top", "top")
        return ("top", "front") if isinstance(self.furniture, Chair) else ("top", "top")
