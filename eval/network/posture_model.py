"""Calibrated posture of a person: logistic regression on the network's posture and its joints.

The network alone takes people whose legs are out of view for standing ones, and is sure of it. The model also
has the inclination of trunk, thighs and shanks, and which of hips, knees and ankles the image shows.
``python -m tools.fit.posture`` fits its weights.
"""

import json
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from itertools import combinations_with_replacement

import numpy as np

from annotate.array_types import Bool, Float64, UInt16
from annotate.posture import POSTURES
from eval.network.body_state import BodyState
from eval.scores.joint_visibility import VISIBLE, visibility
from eval.scores.joints import JOINT
from sensors.rig.camera import Intrinsics

LEAST_SHARE = 1e-4  # of the network's probability of a posture, before its logarithm
LEGS = np.array(
    [[JOINT[f"{side}_{name}"] for name in ("hip", "knee", "ankle")] for side in ("left", "right")]
)
ANGLES = ("trunk up", "thigh along trunk", "shank along thigh", "thigh up", "shank up")
PAIRS = tuple(combinations_with_replacement(range(len(ANGLES)), 2))
FEATURES = (
    "constant",
    *(f"log10 {name}" for name in POSTURES),
    *("hips seen", "knees seen", "ankles seen", "trunk away"),
    *ANGLES,
    *(f"{ANGLES[i]} x {ANGLES[j]}" for i, j in PAIRS),
)
"""Names of the model's inputs: cosines of the trunk and of the straighter leg, and their products, because a
posture is a range of angles. up: to the camera's up; away: to the line of sight."""


@dataclass(frozen=True, eq=False)
class PostureModel:
    """Weights (P, F) by ``POSTURES`` and ``FEATURES``."""

    weights: Float64

    def probabilities(self, features: Float64) -> Float64:
        """Return probabilities (..., P) of features (..., F)."""
        scores = features @ self.weights.T
        shares = np.exp(scores - scores.max(axis=-1, keepdims=True))
        return np.asarray(shares / shares.sum(axis=-1, keepdims=True))


@cache
def shipped_posture_model() -> PostureModel:
    """Return the shipped model."""
    rows = json.loads(files("eval").joinpath("weights", "posture.json").read_text())
    return PostureModel(np.array([[rows[name][feature] for feature in FEATURES] for name in POSTURES]))


def with_posture(state: BodyState, image: tuple[UInt16, Bool], camera: Intrinsics) -> BodyState:
    """Return a network's state with calibrated probabilities of the postures.

    image: depth in millimetres and the person's pixels, both (h, w). camera: undistorted, of these pixels.
    """
    shares = shipped_posture_model().probabilities(posture_features(state, image, camera))
    return replace(state, posture=shares.astype(np.float32))


def posture_features(state: BodyState, image: tuple[UInt16, Bool], camera: Intrinsics) -> Float64:
    """Return the inputs (F,) of the model; arguments as in ``with_posture``."""
    depth_mm, person = image
    joints = state.joints_mm(camera)
    own_mm = np.where(person, depth_mm, np.uint16(0))
    seen = (visibility(joints, own_mm, camera) == VISIBLE)[LEGS].mean(axis=0)
    hips, knees, ankles = joints[LEGS].transpose(1, 0, 2)
    trunk = _direction(joints[JOINT["neck"]] - joints[JOINT["pelvis"]])
    thighs, shanks = _direction(hips - knees), _direction(knees - ankles)
    along_trunk, along_thigh = thighs @ trunk, (shanks * thighs).sum(axis=1)
    leg = int((along_trunk + along_thigh).argmax())
    angles = np.array([-trunk[1], along_trunk[leg], along_thigh[leg], -thighs[leg, 1], -shanks[leg, 1]])
    logs = np.log10(np.maximum(state.posture, LEAST_SHARE))
    products = angles[[i for i, _ in PAIRS]] * angles[[j for _, j in PAIRS]]
    return np.array([1.0, *logs, *seen, trunk[2], *angles, *products])


def _direction(vectors: Float64) -> Float64:
    """Return vectors (..., 3) of length 1."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))
