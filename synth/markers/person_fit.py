"""A person as the solver knows one: bone lengths and where the markers sit, fitted to recorded frames."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from synth.body.body import shipped_bodies
from synth.body.skeleton import JOINT_ID, JOINTS, N_JOINTS, PARENTS, Float64, Posture, alignment, forward
from synth.markers.kinematics import State, markers_at
from synth.markers.markerset import MarkerSet
from synth.markers.posture_fit import Prior, fit_posture, shape_normal, solve_positive

REFERENCE_BODY = 4
"""The shipped body of 1.70 m on which marker sets are stated."""
_GROUPS = (
    "height",
    "hip_width",
    "pelvis",
    "spine",
    "head",
    "shoulder_width",
    "upper_arm",
    "forearm",
    "thigh",
    "shank",
)
SCALE_SPREAD = 0.06
"""How far a segment's scale strays from the body's (Pheasant & Haslegrave 2005: 3 to 6 % of length)."""
HEIGHT_SPREAD = 0.2
EFFECTIVE_FRAMES = 2.0
"""Frames of one recording err alike (skin slides the same way every time): together they count as so many.
At 10, an ankle marker left its place by 40 mm to gain 0.3 mm of fit, and the foot stood askew."""
CALIBRATION_STEPS = 12


@dataclass(frozen=True)
class Subject:
    """bones_m: (J, 3) joint from parent in anatomical zero. marker_joint: (M,), offsets_m: (M, 3) in the
    joint's frame at anatomical zero."""

    bones_m: Float64
    marker_joint: NDArray[np.int64]
    offsets_m: Float64

    @property
    def leg_m(self) -> float:
        """Length from hip to ankle."""
        return leg_length_m(self.bones_m)


def leg_length_m(bones_m: Float64) -> float:
    """Length from hip to ankle of bones (J, 3)."""
    return float(np.linalg.norm(bones_m[_LEG], axis=1).sum())


_LEG = [JOINT_ID["left_knee"], JOINT_ID["left_ankle"]]


def zero_bones(rest_joints_m: Float64) -> Float64:
    """Bones (J, 3) of a body in anatomical zero, joint from parent, of its rest joints (J, 3)."""
    _, joints = forward(Posture.zero(), rest_joints_m, alignment(rest_joints_m))
    return np.asarray(joints - np.where(PARENTS[:, None] < 0, 0, joints[PARENTS]))


def posture_prior(rest_deg: float, hold_deg: float) -> Prior:
    """Pulls that let a joint stray ``rest_deg`` from zero and ``hold_deg`` from its start at one sigma."""
    spread = np.full((N_JOINTS, 3), rest_deg)
    for j, joint in enumerate(JOINTS):
        kind = joint.name.removeprefix("left_").removeprefix("right_")
        spread[j] = np.minimum(spread[j], _SPREAD_DEG.get(kind, 180))
    return Prior(np.radians(spread) ** -2, np.full(N_JOINTS, np.radians(hold_deg) ** -2), 1.0)


_SPREAD_DEG = {
    "spine_lower": (30, 15, 15),
    "spine_middle": (30, 15, 15),
    "spine_upper": (30, 15, 15),
    "neck": (40, 25, 40),
    "head": (40, 25, 40),
    "clavicle": (20, 20, 20),
    "elbow": (180, 3, 90),
    "wrist": (40, 15, 90),
    "knee": (180, 2, 8),
    "ankle": (30, 5, 5),
}
"""How far joints stray from zero, for angles that few markers tell: about half their range."""


def _group_of_joint(name: str) -> str:
    kinds = {
        "pelvis": "pelvis", "spine_lower": "pelvis", "spine_middle": "spine", "spine_upper": "spine",
        "neck": "spine", "head": "head", "clavicle": "spine", "shoulder": "shoulder_width",
        "elbow": "upper_arm", "wrist": "forearm", "hip": "pelvis", "knee": "thigh", "ankle": "shank",
    }  # fmt: skip
    return kinds.get(name) or kinds[name.partition("_")[2]]


def _group_of_marker(joint: int) -> str:
    kinds = {
        "pelvis": "pelvis", "spine_lower": "spine", "spine_middle": "spine", "spine_upper": "spine",
        "neck": "head", "head": "head", "clavicle": "shoulder_width", "shoulder": "upper_arm",
        "elbow": "forearm", "wrist": "forearm", "hip": "thigh", "knee": "shank", "ankle": "shank",
    }  # fmt: skip
    name = JOINTS[joint].name
    return kinds.get(name) or kinds[name.partition("_")[2]]


@dataclass(frozen=True)
class Template:
    """How shape parameters make a subject: metres per group's scale, bones (G, J, 3), markers (G, M, 3)."""

    marker_joint: NDArray[np.int64]
    spread_m: Float64
    bone_basis: Float64
    offset_basis: Float64

    @staticmethod
    def of(markers: MarkerSet) -> "Template":
        """Template of a marker set on the reference body."""
        reference = zero_bones(shipped_bodies()[REFERENCE_BODY].joints_m)
        bones = np.zeros((len(_GROUPS), N_JOINTS, 3))
        for j, joint in enumerate(JOINTS):
            bones[_GROUPS.index(_group_of_joint(joint.name)), j] = reference[j]
            if joint.name.endswith(("_hip", "_clavicle")):
                bones[:, j, 0] = 0
                width = "hip_width" if joint.name.endswith("_hip") else "shoulder_width"
                bones[_GROUPS.index(width), j, 0] = reference[j, 0]
        offsets = np.zeros((len(_GROUPS), len(markers.names), 3))
        for m, joint_id in enumerate(markers.joint):
            offsets[_GROUPS.index(_group_of_marker(int(joint_id))), m] = markers.at_m[m]
        return Template(markers.joint, markers.spread_m, bones, offsets)

    def subject(self, shape: Float64) -> Subject:
        """Subject of shape parameters (G + 3 M,): scales, then a shift of every marker."""
        groups = len(_GROUPS)
        scales, shifts = shape[:groups], shape[groups:].reshape(-1, 3)
        return Subject(
            np.tensordot(scales, self.bone_basis, 1),
            self.marker_joint,
            np.tensordot(scales, self.offset_basis, 1) + shifts,
        )

    def shape(self, scale: float) -> Float64:
        """Shape of a body ``scale`` times the reference, markers where the set says."""
        return np.concatenate([np.full(len(_GROUPS), scale), np.zeros(3 * len(self.marker_joint))])

    def precision(self) -> Float64:
        """Prior precision (S, S): scales near the height, height near 1, markers near their places."""
        groups = len(_GROUPS)
        result = np.diag(np.concatenate([np.zeros(groups), np.repeat(self.spread_m, 3) ** -2]))
        result[0, 0] = HEIGHT_SPREAD**-2 + (groups - 1) * SCALE_SPREAD**-2
        result[range(1, groups), range(1, groups)] = SCALE_SPREAD**-2
        result[0, 1:groups] = result[1:groups, 0] = -(SCALE_SPREAD**-2)
        return np.asarray(result)


def start_states(subject: Subject, observed_m: Float64) -> list[State]:
    """Guesses at one frame's posture from nothing: the trunk laid over its markers, limbs in common poses."""
    seen = np.isfinite(observed_m).all(axis=1)
    trunk = seen & np.isin(subject.marker_joint, _TRUNK)
    used = trunk if trunk.sum() >= 4 else seen
    zero = State.of(np.zeros((N_JOINTS, 3)), np.zeros(3))
    template = markers_at(zero, subject.bones_m, subject.marker_joint, subject.offsets_m)[used]
    found = observed_m[used]
    from scipy.spatial.transform import Rotation

    turn, _ = Rotation.align_vectors(found - found.mean(axis=0), template - template.mean(axis=0))
    pelvis = found.mean(axis=0) - turn.apply(template.mean(axis=0))
    states = []
    for arms, legs in product(_ARMS, _LEGS):
        angles = np.zeros((N_JOINTS, 3))
        for side in ("left", "right"):
            for joint, degrees in {**arms, **legs}.items():
                angles[JOINT_ID[f"{side}_{joint}"]] = np.radians(degrees)
        state = State.of(angles, pelvis)
        local = state.local.copy()
        local[0] = turn.as_matrix()
        signed = state.signed_rad.copy()
        signed[0] = turn.as_euler("XYZ")
        states.append(State(pelvis, signed, local))
    return states


_TRUNK = [JOINT_ID[name] for name in ("pelvis", "spine_lower", "spine_middle", "spine_upper")]
_ARMS: tuple[dict[str, tuple[float, float, float]], ...] = (
    {"elbow": (20, 0, 0)},
    {"shoulder": (0, 80, 0), "elbow": (20, 0, 0)},
    {"shoulder": (80, 10, 0), "elbow": (30, 0, 0)},
)
_LEGS: tuple[dict[str, tuple[float, float, float]], ...] = (
    {"hip": (5, 0, 0), "knee": (-10, 0, 0)},
    {"hip": (80, 10, 0), "knee": (-80, 0, 0)},
)


def fit_from_nothing(
    subject: Subject, observed_m: Float64, weights: Float64, prior: Prior
) -> tuple[State, float]:
    """Best posture of one frame over all starts, and its cost."""
    args = (
        subject.bones_m,
        subject.marker_joint,
        subject.offsets_m,
        np.nan_to_num(observed_m),
        weights,
        prior,
    )
    rough = [fit_posture(s, *args, steps=40, robust_m=10.0) for s in start_states(subject, observed_m)]
    best = min(rough, key=lambda result: result[1])[0]
    return fit_posture(best, *args, steps=40)


def calibrate(
    template: Template, shape: Float64, observed_m: Float64, weights: Float64
) -> tuple[Float64, list[State]]:
    """Shape (S,) that explains frames (K, M, 3) best under the prior, and the frames' postures.

    weights: (K, M), 0 where a marker is missing. Gauss-Newton on the shape with the postures eliminated
    (variable projection, Golub & Pereyra 2003; the Schur complement of bundle adjustment).
    """
    prior, precision, mean = posture_prior(60, 1e3), template.precision(), template.shape(1.0)
    share = EFFECTIVE_FRAMES / len(observed_m)
    clean = np.nan_to_num(observed_m)
    subject = template.subject(shape)
    states = [fit_from_nothing(subject, o, w, prior)[0] for o, w in zip(observed_m, weights, strict=True)]
    for _ in range(CALIBRATION_STEPS):
        system, gradient = precision.copy(), precision @ (shape - mean)
        for k, state in enumerate(states):
            matrix, slope = shape_normal(
                state, subject.bones_m, subject.marker_joint, subject.offsets_m, clean[k], weights[k], prior,
                template.bone_basis, template.offset_basis,
            )  # fmt: skip
            system += share * matrix
            gradient += share * slope
        step = solve_positive(system, -gradient)
        shape = shape + step
        subject = template.subject(shape)
        states = [
            fit_posture(s, subject.bones_m, subject.marker_joint, subject.offsets_m, o, w, prior, steps=20)[0]
            for s, o, w in zip(states, clean, weights, strict=True)
        ]
        if np.abs(step).max() < 1e-3:
            break
    return shape, states
