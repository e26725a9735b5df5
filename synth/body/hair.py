"""Where hair grows on a body."""

import numpy as np

from annotate.array_types import Bool
from annotate.parts import PART_ID
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID


def hair_faces(body: Body) -> Bool:
    """Faces (F,) where hair grows: the head above the brow, and its back down to the neck."""
    _, y, z = body.vertices_m[body.faces].mean(axis=1).T
    head = body.joints_m[JOINT_ID["head"]]
    top = body.vertices_m[:, 2].max()
    above = z > head[2] + 0.6 * (top - head[2])
    behind = (y > head[1] + 0.02) & (z > head[2])
    return np.asarray((body.face_parts == PART_ID["head"]) & (above | behind), np.bool_)
