"""The recorded person as a body: the reference body with every segment at the person's own length."""

from dataclasses import replace

import numpy as np

from annotate.array_types import Float64
from synth.body.body import Body, reference_body
from synth.body.skeleton import JOINT_ID, N_JOINTS, PARENTS, alignment
from synth.markers.person_fit import leg_length_m, zero_bones

_CHILD = {
    JOINT_ID[f"{side}_{joint}"]: JOINT_ID[f"{side}_{child}"]
    for side in ("left", "right")
    for joint, child in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
}
"""Where a limb's segment ends."""


def bones_of_leg(leg_m: float) -> Float64:
    """Bones (J, 3) of a person of whom only the leg's length is known: the reference body's proportions."""
    bones = zero_bones(reference_body().joints_m)
    return np.asarray(leg_m / leg_length_m(bones) * bones)


def person_body(bones_m: Float64) -> Body:
    """A body whose bones have these lengths (J, 3), joint from parent in anatomical zero.

    Limbs are stretched along their bones; trunk, hands, feet and all thicknesses grow with the whole.
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
        reference,
        name="person",
        vertices_m=(vertices - floor).astype(np.float32),
        joints_m=joints - floor,
    )
