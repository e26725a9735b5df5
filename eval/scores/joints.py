"""Joints of the networks, by name, and the bones between joints."""

import numpy as np

from synth.body.skeleton import JOINT_ID

_SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
JOINT_NAMES = ("head", "neck", "pelvis", *(f"{side}_{kind}" for side in ("left", "right") for kind in _SIDED))
N_JOINTS = len(JOINT_NAMES)
JOINT = {name: i for i, name in enumerate(JOINT_NAMES)}


def _twin(name: str) -> str:
    return name.replace("left", "right") if "left" in name else name.replace("right", "left")


TWIN = np.array([JOINT[_twin(name)] for name in JOINT_NAMES])
"""Index of each joint's twin on the other side; a middle joint is its own twin."""
IN_SKELETON = np.array([JOINT_ID[name] for name in JOINT_NAMES])
"""Index of each joint in `synth.body.skeleton`, the order of a label set's notes."""
BONES = (
    ("neck", "head"),
    ("neck", "pelvis"),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    *(
        (f"{side}_{a}", f"{side}_{b}")
        for side in ("left", "right")
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
    ),
    *(("neck", f"{side}_shoulder") for side in ("left", "right")),
)
