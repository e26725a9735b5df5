"""Joints of the networks by name, in the order of a frame's notes, and the bones between joints."""

_SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
JOINT_NAMES = ("head", "neck", "pelvis", *(f"{side}_{kind}" for side in ("left", "right") for kind in _SIDED))
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
