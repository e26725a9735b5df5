"""Simulated witness: landmarks of a person's true joints with the errors of a colour network.

Jitter and lost heads are BlazePose's on ten frames of one man on a sofa, with crops from the finder. The
reference is landmarks made before the faces were blurred. The median distance is 3 to 4 % of the trunk in the
image. Heads are off by up to a trunk. Shares of missed and exchanged landmarks are assumed.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Float32, Float64
from annotate.witness.onnx_pose import NAMES as COCO
from annotate.witness.person_crop import PersonCrop
from sensors.rig.camera import Intrinsics, project
from synth.body.skeleton import JOINT_ID

NAMES = tuple(name for name in COCO if "eye" not in name and "ear" not in name)
"""Landmarks of the simulated witness: nose and twelve joints of limbs."""
_OF = {"nose": "head"}
MASK_PX = 256  # side of a simulated mask's crop
MASK_ERROR_PX = 1.5  # standard deviation of its border; assumed


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
        return self.times(2)

    def times(self, size: float) -> "WitnessErrors":
        """Return errors of ``size`` times the size and share."""
        return WitnessErrors(*(size * getattr(self, name) for name in self.__dataclass_fields__))

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


def mask_with_errors(at_px: Float64, crop: PersonCrop, rng: np.random.Generator, size: float) -> Float32:
    """Return the mask (256, 256) of a person's points (n, 2), its border displaced by smooth noise.

    size: factor of the displacement.
    """
    turn = cv2.invertAffineTransform(crop.placement(MASK_PX, MASK_PX))
    at = np.rint((at_px - 0.5) @ turn[:, :2].T + turn[:, 2]).astype(int).clip(0, MASK_PX - 1)
    plane = np.zeros((MASK_PX, MASK_PX), np.uint8)
    plane[at[:, 1], at[:, 0]] = 1
    plane = cv2.morphologyEx(plane, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    inside, outside = (cv2.distanceTransform(one, cv2.DIST_L2, 3) for one in (plane, 1 - plane))
    noise = cv2.GaussianBlur(rng.normal(size=plane.shape), (0, 0), 6)
    noise *= size * MASK_ERROR_PX / noise.std()
    return (1 / (1 + np.exp(-(inside - outside + noise)))).astype(np.float32)
