"""Skeleton of a person as a Foxglove scene: a sphere for each joint, a line for each bone in the colour of
its part.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from annotate.parts import PART_ID, PARTS
from sensors.session.messages import time_message

_SIDED = (
    ("neck", "SIDE_shoulder", "torso"),
    ("SIDE_shoulder", "SIDE_elbow", "SIDE_upper_arm"),
    ("SIDE_elbow", "SIDE_wrist", "SIDE_forearm"),
    ("pelvis", "SIDE_hip", "hip"),
    ("SIDE_hip", "SIDE_knee", "SIDE_upper_leg"),
    ("SIDE_knee", "SIDE_ankle", "SIDE_lower_leg"),
)
BONES: tuple[tuple[str, ...], ...] = (
    ("head", "neck", "head"),
    ("neck", "pelvis", "torso"),
    *(tuple(name.replace("SIDE", side) for name in bone) for side in ("left", "right") for bone in _SIDED),
)  # joint, joint, part that defines the colour
BALL_M, LINE_M = 0.05, 0.02  # diameter of a joint, width of a bone; untuned


def skeleton_message(joints_mm: Mapping[str, Sequence[float]] | None, stamp_ns: int) -> SceneUpdate:
    """Return an entity ``person`` with a sphere for each known joint, in order, and the bones between them.

    joints_mm: (x, y, z) by name, depth camera, NaN = unknown. None removes the person.
    """
    known = {n: np.asarray(p, float) / 1000 for n, p in (joints_mm or {}).items() if np.isfinite(p).all()}
    if not known:
        everything = SceneEntityDeletion(timestamp=time_message(stamp_ns), type=SceneEntityDeletion.ALL)
        return SceneUpdate(deletions=[everything])
    entity = SceneEntity(timestamp=time_message(stamp_ns), frame_id="depth", id="person")
    for name, place in known.items():
        entity.metadata.add(key=name, value=str(len(entity.spheres)))
        ball = entity.spheres.add(color=Color(r=1, g=1, b=1, a=1))
        ball.pose.position.x, ball.pose.position.y, ball.pose.position.z = place
        ball.pose.orientation.w = 1.0
        ball.size.x = ball.size.y = ball.size.z = BALL_M
    lines = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=LINE_M)
    lines.pose.orientation.w = 1.0
    for *ends, part in BONES:
        if known.keys() >= set(ends):
            red, green, blue = (value / 255 for value in PARTS[PART_ID[part]].rgb)
            for x, y, z in (known[end] for end in ends):
                lines.points.append(Point3(x=x, y=y, z=z))
                lines.colors.append(Color(r=red, g=green, b=blue, a=1))
    return SceneUpdate(entities=[entity])
