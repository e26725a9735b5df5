"""Skeleton in metres from landmarks in the image and the depth of the surface there.

Lengths are in trunks: the distance from the middle of the shoulders to the middle of the hips.
Constants are untuned unless a source is given.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from annotate.array_types import Float32, Float64
from annotate.joint_names import JOINT_NAMES
from sensors.rig.camera import Intrinsics, undistort
from sensors.rig.rig_calibration import Pose

SIDES = ("left", "right")
JOINTS = (*JOINT_NAMES, "left_hand", "right_hand", "left_toes", "right_toes")
JOINT = {name: i for i, name in enumerate(JOINTS)}
SEEN = 0.3  # least visibility of a landmark that is used
NEAR = 16  # surface points about a landmark
FRONT = 0.4  # quantile of their depth: a limb in front of the trunk wins
TRUNK_M = (0.35, 0.62)  # bounds of a trunk's length
NETWORK_SD = 0.2  # of joints from the depth network, trunks
OVERLONG = 1.2  # longest bone over its expected length
HALF_THICK = {
    **{"head": 0.17, "shoulder": 0.14, "elbow": 0.08, "wrist": 0.055, "hand": 0.03},
    **{"hip": 0.2, "knee": 0.11, "ankle": 0.08, "toes": 0.06},
}
"""Depth of a joint behind the surface."""
LENGTHS = {
    **{("shoulder", "elbow"): 0.65, ("elbow", "wrist"): 0.51, ("wrist", "hand"): 0.3},
    **{("hip", "knee"): 0.85, ("knee", "ankle"): 0.85, ("ankle", "toes"): 0.45},
}
"""Lengths of bones (Winter, Biomechanics and Motor Control of Human Movement, 4th ed., figure 4.1)."""
ACROSS = {"shoulder": 0.9, "hip": 0.55}  # distances between the landmarks of both sides
SOURCES = {
    "head": (("left_ear", "right_ear"), ("nose",)),
    **{f"{side}_hand": ((f"{side}_index", f"{side}_pinky"),) for side in SIDES},
    **{f"{side}_toes": ((f"{side}_foot_index",),) for side in SIDES},
    "neck": (("left_shoulder", "right_shoulder"),),
    "pelvis": (("left_hip", "right_hip"),),
}
"""Landmarks whose mean is a joint, the first that a network has; other joints are landmarks themselves."""
ABOVE = {"neck": 0.21, "pelvis": 0.03}
"""Distances of the bodies' joints above the middles of shoulders and hips, along the trunk, trunks: means of
``synth/data/body_*.npz``."""


class Surface(NamedTuple):
    """Points of a person as the colour camera shows them.

    at_px: (n, 2), pixels of the colour image, centres at halves. ahead_m: (n,), their depth in the colour
    camera. camera: the colour camera. depth_from_color: pose of the depth camera.
    """

    at_px: Float64
    ahead_m: Float32
    camera: Intrinsics
    depth_from_color: Pose


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints (19, 3) by ``JOINTS`` in metres, depth camera; NaN = unknown. sd: (19,), uncertainty of joints
    that the witness does not show, in trunks. trunk_m: length of the trunk.
    """

    joints_m: Float64
    sd: Float64
    trunk_m: float

    def completed(self, joints_m: Float64) -> "Skeleton":
        """Return the skeleton with unknown joints taken from a network's joints (15, 3), bones bounded."""
        given = np.full((len(JOINTS), 3), np.nan)
        given[: len(joints_m)] = joints_m
        unknown = np.isnan(self.joints_m[:, 0])
        placed = np.where(unknown[:, None], given, self.joints_m)
        sd = np.where(unknown, NETWORK_SD, self.sd)
        for parent, child, length in _bones():
            bone, most = placed[child] - placed[parent], OVERLONG * length * self.trunk_m
            if unknown[child] and np.linalg.norm(bone) > most:
                placed[child] = placed[parent] + bone * most / np.linalg.norm(bone)
        for side in SIDES:
            _extend(placed, sd, *(JOINT[f"{side}_{name}"] for name in ("elbow", "wrist", "hand")))
        return replace(self, joints_m=placed, sd=sd)

    def body_joints_m(self) -> Float64:
        """Return the joints (15, 3) by ``JOINT_NAMES``, metres, depth camera, with neck and pelvis where the
        bodies have both: ``ABOVE`` the middles of the witness's landmarks. NaN = unknown.

        A joint from a network (``completed``) already is the bodies' joint.
        """
        joints_m = self.joints_m[: len(JOINT_NAMES)].copy()
        up = joints_m[JOINT["neck"]] - joints_m[JOINT["pelvis"]]
        for name, share in ABOVE.items():
            if self.sd[JOINT[name]] == 0:
                joints_m[JOINT[name]] += share * up
        return joints_m


def skeleton_of(landmarks: Float64, names: Sequence[str], surface: Surface) -> Skeleton:
    """Return the skeleton of landmarks (n, 3): column, row, visibility in the colour image.

    names: of the landmarks. A joint lies half a limb behind the surface. A bone to a landmark on another
    surface is too long, and is shortened along the line of sight.
    """
    at = _joints_px(dict(zip(names, landmarks, strict=True)))
    known = at[:, 2] >= SEEN
    ahead = np.full(len(at), np.nan)
    tree = cKDTree(surface.at_px)
    _, near = tree.query(at[known, :2], k=min(NEAR, len(surface.at_px)))
    around = surface.ahead_m[np.asarray(near).reshape(int(known.sum()), -1)]
    ahead[known] = np.quantile(around, FRONT, axis=1)
    camera = surface.camera
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    rays = np.column_stack([undistort(camera, (at[:, :2] - 0.5 - centre) / focal), np.ones(len(at))])
    trunk_m = _trunk_m(rays * ahead[:, None])
    ahead += trunk_m * np.array([HALF_THICK.get(_kind(name), 0.17) for name in JOINTS])
    placed = rays * ahead[:, None]
    for parent, child, length in _bones():
        placed[child] = _in_reach(placed[parent], placed[child], OVERLONG * length * trunk_m)
    return Skeleton(surface.depth_from_color.apply(placed), np.zeros(len(JOINTS)), trunk_m)


def _kind(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")


def _bones() -> list[tuple[int, int, float]]:
    """Return parent, child and length of the limbs' bones, from the trunk outwards."""
    both = ((f"{side}_{a}", f"{side}_{b}", length) for (a, b), length in LENGTHS.items() for side in SIDES)
    return [(JOINT[a], JOINT[b], length) for a, b, length in both]


def _joints_px(landmarks: Mapping[str, Float64]) -> Float64:
    """Return column, row and visibility (19, 3) of ``JOINTS``; visibility 0 = unknown."""
    at = np.zeros((len(JOINTS), 3))
    for i, name in enumerate(JOINTS):
        choices = SOURCES.get(name, ((name,),))
        held = [[landmarks[one] for one in some] for some in choices if all(one in landmarks for one in some)]
        usable = [np.array(some) for some in held if np.array(some)[:, 2].min() >= SEEN]
        if usable:
            at[i] = *usable[0][:, :2].mean(axis=0), usable[0][:, 2].min()
    return at


def _trunk_m(points_m: Float64) -> float:
    """Return the length of the trunk from points (19, 3) on the surface: the second longest of its measures,
    because a view shortens bones and a point on another surface lengthens one.
    """
    measures = [float(np.linalg.norm(points_m[JOINT["neck"]] - points_m[JOINT["pelvis"]]))]
    for kind, share in ACROSS.items():
        both = points_m[[JOINT[f"{side}_{kind}"] for side in SIDES]]
        measures.append(float(np.linalg.norm(both[0] - both[1])) / share)
    bones = (points_m[child] - points_m[parent] for parent, child, _ in _bones())
    measures += [
        float(np.linalg.norm(bone)) / length for bone, (*_, length) in zip(bones, _bones(), strict=True)
    ]
    known = sorted(one for one in measures if np.isfinite(one))
    low_m, high_m = TRUNK_M
    return min(max(known[-2:][0], low_m), high_m) if known else (low_m + high_m) / 2


def _in_reach(parent: Float64, child: Float64, most_m: float) -> Float64:
    """Return a child joint, moved along its line of sight to within ``most_m`` of its parent.

    A line of sight that stays farther away gives its nearest point.
    """
    if not (np.linalg.norm(child - parent) > most_m):
        return child
    ray = child / np.linalg.norm(child)
    middle = float(ray @ parent)
    beside = float(np.linalg.norm(middle * ray - parent))
    reach = max(most_m**2 - beside**2, 0.0) ** 0.5
    return np.asarray(ray * min(max(float(np.linalg.norm(child)), middle - reach), middle + reach))


def _extend(placed: Float64, sd: Float64, elbow: int, wrist: int, hand: int) -> None:
    """Place an unknown hand in the direction of the forearm, in place."""
    if np.isnan(placed[hand, 0]):
        placed[hand] = placed[wrist] + 0.5 * (placed[wrist] - placed[elbow])
        sd[hand] = sd[wrist] + NETWORK_SD / 2
