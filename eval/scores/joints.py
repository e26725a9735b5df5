"""Joints of the networks, by name, and the bones between joints."""

import numpy as np

from annotate import joint_names
from synth.body.skeleton import JOINT_ID

JOINT_NAMES, BONES = joint_names.JOINT_NAMES, joint_names.BONES
N_JOINTS = len(JOINT_NAMES)
JOINT = {name: i for i, name in enumerate(JOINT_NAMES)}


def _twin(name: str) -> str:
    return name.replace("left", "right") if "left" in name else name.replace("right", "left")


TWIN = np.array([JOINT[_twin(name)] for name in JOINT_NAMES])
"""Index of each joint's twin on the other side; a middle joint is its own twin."""
IN_SKELETON = np.array([JOINT_ID[name] for name in JOINT_NAMES])
"""Index of each joint in `synth.body.skeleton`, the order of a label set's notes."""
