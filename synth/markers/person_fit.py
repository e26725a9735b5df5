"""Fit of a person to recorded frames: bone lengths and positions of markers; and the person as a body.

Constants are untuned unless a source is given.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from annotate.array_types import Bool, Float64, Int64
from synth.body.body import Body, reference_body
from synth.body.skeleton import (
    JOINT_ID,
    JOINTS,
    N_JOINTS,
    PARENTS,
    Joint,
    Posture,
    alignment,
    euler_rad,
    forward,
)
from synth.data_files import table
from synth.markers.kinematics import State, Subject, markers_at, solve_positive
from synth.markers.posture_fit import Basis, Observed, Prior, fit_posture, shape_normal
from synth.motion_files.marker_set import MarkerSet

# Groups with a scale of their own.
_GROUPS = (
    "height", "hip_width", "pelvis", "spine", "head",
    "shoulder_width", "upper_arm", "forearm", "thigh", "shank",
)  # fmt: skip
# standard deviation of a segment's scale about the body's (Pheasant & Haslegrave 2005: 3 to 6 %)
SCALE_SPREAD = 0.06
HEIGHT_SPREAD = 0.2  # standard deviation of a person's scale about the reference body
# Frames that a recording counts as: all err alike, since skin slides the same way every time. Measured: from
# 2 to 8, markers come 0.2 to 0.5 mm nearer in seven recordings of three laboratories; at 12, not nearer.
EFFECTIVE_FRAMES = 8.0
# Standard deviation of the mean of one ankle's markers, which are on both sides of it. Measured: without it,
# a moving heel marker drew all of its foot's 40 mm to one side.
FOOT_M = 0.005
ABOUT_ANKLE_M = 0.1  # a shank's marker this near to the ankle is on it
FLAT_M = 0.05  # extent, as a root of summed squares, by which a trunk's markers span a plane
SHAPE_STEPS = 12  # greatest number of Gauss-Newton steps
LENIENT_M = 10.0  # robust residual of a search from nothing: every marker pulls
_LEG = [JOINT_ID["left_knee"], JOINT_ID["left_ankle"]]
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
# End of a limb's segment.
_CHILD = {
    JOINT_ID[f"{side}_{joint}"]: JOINT_ID[f"{side}_{child}"]
    for side in ("left", "right")
    for joint, child in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
}


def leg_length_m(bones_m: Float64) -> float:
    """Return the length from hip to ankle of bones (J, 3)."""
    return float(np.linalg.norm(bones_m[_LEG], axis=1).sum())


def zero_bones(rest_joints_m: Float64) -> Float64:
    """Return the bones (J, 3) in anatomical zero, from parent to joint, for rest joints (J, 3)."""
    _, joints = forward(Posture.zero(), rest_joints_m, alignment(rest_joints_m))
    return np.asarray(joints - np.where(PARENTS[:, None] < 0, 0, joints[PARENTS]))


def posture_prior(rest_deg: float, hold_deg: float) -> Prior:
    """Return a prior with standard deviations ``rest_deg`` from anatomical zero and ``hold_deg`` from the
    start.
    """
    spread = np.full((N_JOINTS, 3), rest_deg)
    for j, joint in enumerate(JOINTS):
        spread[j] = np.minimum(spread[j], table("joints")[joint.kind].get("stray_deg", 180))
    return Prior(np.radians(spread) ** -2, np.full(N_JOINTS, np.radians(hold_deg) ** -2), 1.0)


def _groups(joint: Joint) -> list[int]:
    """Return the index of the scale for the bone to a joint, and of the scale for its markers."""
    return [_GROUPS.index(group) for group in table("joints")[joint.kind]["scaled_by"]]


@dataclass(frozen=True)
class Template:
    """Linear map from shape parameters to a subject. marker_joint, spread_m: (M,) as in ``MarkerSet``."""

    marker_joint: Int64
    spread_m: Float64
    basis: Basis

    @staticmethod
    def of(markers: MarkerSet) -> "Template":
        """Return the template of a marker set on the reference body."""
        reference = zero_bones(reference_body().joints_m)
        bones = np.zeros((len(_GROUPS), N_JOINTS, 3))
        for j, joint in enumerate(JOINTS):
            bones[_groups(joint)[0], j] = reference[j]
            if joint.name.endswith(("_hip", "_clavicle")):
                bones[:, j, 0] = 0
                width = "hip_width" if joint.name.endswith("_hip") else "shoulder_width"
                bones[_GROUPS.index(width), j, 0] = reference[j, 0]
        offsets = np.zeros((len(_GROUPS), len(markers.names), 3))
        for m, joint_id in enumerate(markers.joint):
            offsets[_groups(JOINTS[joint_id])[1], m] = markers.at_m[m]
        return Template(markers.joint, markers.spread_m, Basis(bones, offsets))

    def subject(self, shape: Float64) -> Subject:
        """Return the subject of shape parameters (G + 3 M,): scales, then a shift of every marker."""
        groups = len(_GROUPS)
        scales, shifts = shape[:groups], shape[groups:].reshape(-1, 3)
        return Subject(
            np.tensordot(scales, self.basis.bones, 1),
            self.marker_joint,
            np.tensordot(scales, self.basis.offsets, 1) + shifts,
        )

    def shape(self, scale: float) -> Float64:
        """Return the shape parameters of a reference body scaled by ``scale``, with markers at the set's
        positions.
        """
        return np.concatenate([np.full(len(_GROUPS), scale), np.zeros(3 * len(self.marker_joint))])

    def precision(self, seen: Bool) -> Float64:
        """Return the prior precision (S, S) of shape parameters.

        The prior keeps the height's scale near 1, all other scales near the height's, and markers near their
        positions. seen: (M,) markers of the recording. Markers about an ankle stay on both sides of it.
        """
        groups = len(_GROUPS)
        result = np.diag(np.concatenate([np.zeros(groups), np.repeat(self.spread_m, 3) ** -2]))
        result[0, 0] = HEIGHT_SPREAD**-2 + (groups - 1) * SCALE_SPREAD**-2
        result[range(1, groups), range(1, groups)] = SCALE_SPREAD**-2
        result[0, 1:groups] = result[1:groups, 0] = -(SCALE_SPREAD**-2)
        for side in ("left", "right"):
            aside = groups + 3 * np.flatnonzero(seen & self._about_ankle(side))
            result[np.ix_(aside, aside)] += (FOOT_M * max(len(aside), 1)) ** -2
        return np.asarray(result)

    def _about_ankle(self, side: str) -> Bool:
        knee, ankle = JOINT_ID[f"{side}_knee"], JOINT_ID[f"{side}_ankle"]
        near = np.linalg.norm(self.basis.offsets.sum(axis=0) - self.basis.bones[:, ankle].sum(axis=0), axis=1)
        on_shank = (self.marker_joint == knee) & (near < ABOUT_ANKLE_M)
        return np.asarray((self.marker_joint == ankle) | on_shank)


def start_states(subject: Subject, observed_m: Float64) -> list[State]:
    """Return first guesses of one frame's posture: the trunk fitted to its markers, limbs in common poses."""
    seen = np.isfinite(observed_m).all(axis=1)
    trunk = seen & np.isin(subject.marker_joint, _TRUNK)
    places = markers_at(State.of(np.zeros((N_JOINTS, 3)), np.zeros(3)), subject)
    used = trunk if trunk.sum() >= 4 and _spans_a_plane(places[trunk]) else seen
    template = places[used]
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
        signed[0] = euler_rad(turn)
        states.append(State(pelvis, signed, local))
    return states


def _spans_a_plane(points_m: Float64) -> bool:
    return bool(np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)[1] > FLAT_M)


def fit_from_nothing(
    subject: Subject, observed_m: Float64, weights: Float64, prior: Prior
) -> tuple[State, float]:
    """Return one frame's best posture among fits from all first guesses, and its cost."""
    clean, starts = np.nan_to_num(observed_m), start_states(subject, observed_m)
    lenient = Observed(clean, weights, LENIENT_M)
    rough = [fit_posture(start, subject, lenient, prior, steps=40) for start in starts]
    best = min(rough, key=lambda result: result[1])[0]
    return fit_posture(best, subject, Observed(clean, weights), prior, steps=40)


def fit_shape(
    template: Template, shape: Float64, observed_m: Float64, weights: Float64
) -> tuple[Float64, list[State]]:
    """Return the most probable shape (S,) for frames (K, M, 3) under the prior, and the frames' postures.

    weights: (K, M), 0 where a marker is missing. Gauss-Newton on the shape with the postures eliminated
    (variable projection, Golub & Pereyra 2003; the Schur complement of bundle adjustment).
    """
    prior, mean = posture_prior(60, 1e3), template.shape(1.0)
    precision = template.precision(np.asarray((weights > 0).any(axis=0)))
    share = EFFECTIVE_FRAMES / len(observed_m)
    frames = [Observed(o, w) for o, w in zip(np.nan_to_num(observed_m), weights, strict=True)]
    subject = template.subject(shape)
    states = [fit_from_nothing(subject, o, w, prior)[0] for o, w in zip(observed_m, weights, strict=True)]
    for _ in range(SHAPE_STEPS):
        system, gradient = precision.copy(), precision @ (shape - mean)
        for state, frame in zip(states, frames, strict=True):
            matrix, slope = shape_normal(state, subject, frame, prior, template.basis)
            system += share * matrix
            gradient += share * slope
        step = solve_positive(system, -gradient)
        shape = shape + step
        subject = template.subject(shape)
        states = [
            fit_posture(state, subject, frame, prior, steps=20)[0]
            for state, frame in zip(states, frames, strict=True)
        ]
        if np.abs(step).max() < 1e-3:
            break
    return shape, states


def bones_of_leg(leg_m: float) -> Float64:
    """Return the bones (J, 3) of a person with legs of ``leg_m``, in the reference body's proportions."""
    bones = zero_bones(reference_body().joints_m)
    return np.asarray(leg_m / leg_length_m(bones) * bones)


def person_body(bones_m: Float64) -> Body:
    """Return a body with bones (J, 3), from parent to joint in anatomical zero.

    Limbs are stretched along their bones; trunk, hands, feet and all thicknesses are scaled uniformly.
    """
    reference = reference_body()
    rest, aligned = reference.joints_m, alignment(reference.joints_m)
    size = float(np.linalg.norm(bones_m, axis=1).sum() / np.linalg.norm(zero_bones(rest), axis=1).sum())
    joints, stretch = rest.copy(), np.tile(size * np.eye(3), (N_JOINTS, 1, 1))
    for j, parent in enumerate(PARENTS):
        if parent >= 0:
            joints[j] = joints[parent] + aligned[parent].T @ bones_m[j]
    for j, child in _CHILD.items():
        before, after = rest[child] - rest[j], joints[child] - joints[j]
        along = before / np.linalg.norm(before)
        longer = np.linalg.norm(after) / np.linalg.norm(before) - size
        stretch[j] += longer * np.outer(along, along)
    local = reference.vertices_m[:, None] - rest[reference.bones]
    moved = joints[reference.bones] + np.einsum("vkij,vkj->vki", stretch[reference.bones], local)
    vertices = np.einsum("vk,vki->vi", reference.weights, moved)
    floor = np.array([0.0, 0.0, vertices[:, 2].min()])
    return replace(
        reference, name="person", vertices_m=(vertices - floor).astype(np.float32), joints_m=joints - floor
    )
