"""Simulated witness: landmarks of a person's true joints with the errors of a colour network.

Jitter and lost heads are BlazePose's on ten frames of one man on a sofa, with crops from the finder. The
reference is landmarks made before the faces were blurred. The median distance is 3 to 4 % of the trunk in the
image. Heads are off by up to a trunk. Shares of missed and exchanged landmarks are assumed.
"""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float64
from annotate.witness.onnx_pose import NAMES as COCO
from sensors.rig.camera import Intrinsics, project
from synth.body.skeleton import JOINT_ID

NAMES = tuple(name for name in COCO if "eye" not in name and "ear" not in name)
"""Landmarks of the simulated witness: nose and twelve joints of limbs."""
_OF = {"nose": "head"}


@dataclass(frozen=True)
class WitnessErrors:
    """Sizes of errors. jitter: standard deviation along each axis, in trunks of the image. far: share of
    landmarks with four times this jitter. missed: share of landmarks with visibility 0. exchanged: share of
    people whose sides are exchanged, and of single limbs. lost_head: share of people whose head lies on the
    chest.
    """

    jitter: float = 0.03
    far: float = 0.1
    missed: float = 0.08
    exchanged: float = 0.01
    lost_head: float = 0.1

    def doubled(self) -> "WitnessErrors":
        """Return errors of twice the size and share."""
        return WitnessErrors(*(2 * getattr(self, name) for name in self.__dataclass_fields__))

    def landmarks(self, joints_m: Float64, camera: Intrinsics, rng: np.random.Generator) -> Float64:
        """Return landmarks (13, 3) by ``NAMES`` of joints (20, 3) of ``synth.body.skeleton``, camera frame;
        pixel centres at halves.
        """
        at = project(camera, joints_m[[JOINT_ID[_OF.get(name, name)] for name in NAMES]]) + 0.5
        by = {name: i for i, name in enumerate(NAMES)}
        sides = [at[[by[f"left_{kind}"], by[f"right_{kind}"]]] for kind in ("shoulder", "hip")]
        middles = [pair.mean(axis=0) for pair in sides]
        trunk = max(float(np.linalg.norm(a - b)) for a, b in (middles, *sides))
        if rng.random() < self.lost_head:
            at[by["nose"]] = middles[0] + rng.random() * (middles[1] - middles[0]) / 2
        pairs = [(i, by[name.replace("left", "right")]) for name, i in by.items() if "left" in name]
        whole = rng.random() < self.exchanged
        for left, right in pairs:
            if whole or rng.random() < self.exchanged:
                at[[left, right]] = at[[right, left]]
        size = self.jitter * trunk * np.where(rng.random(len(at)) < self.far, 4, 1)
        at += rng.normal(size=at.shape) * size[:, None]
        seen = np.where(rng.random(len(at)) < self.missed, 0.0, 0.95)
        inside = (at >= 0).all(axis=1) & (at[:, 0] <= camera.width) & (at[:, 1] <= camera.height)
        return np.column_stack([at, np.where(inside, seen, 0.0)])
