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

from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from sensors.session.messages import time_message

_SIDED = (
    ("neck", "SIDE_shoulder", "CHEST"),
    ("SIDE_shoulder", "SIDE_elbow", "SIDE_UPPER_ARM"),
    ("SIDE_elbow", "SIDE_wrist", "SIDE_FOREARM"),
    ("pelvis", "SIDE_hip", "HIP"),
    ("SIDE_hip", "SIDE_knee", "SIDE_UPPER_LEG"),
    ("SIDE_knee", "SIDE_ankle", "SIDE_LOWER_LEG"),
)
BONES: tuple[tuple[str, str, Region], ...] = (
    ("head", "neck", Region.HEAD),
    ("neck", "pelvis", Region.CHEST),
    *(
        (one.replace("SIDE", side), other.replace("SIDE", side), Region[name.replace("SIDE", side.upper())])
        for side in ("left", "right")
        for one, other, name in _SIDED
    ),
)  # joint, joint, region whose part defines the colour
BALL_M, LINE_M = 0.05, 0.02  # diameter of a joint, width of a bone; untuned


def skeleton_message(
    joints_mm: Mapping[str, Sequence[float]] | None, stamp_ns: int, scheme: Scheme
) -> SceneUpdate:
    """Return an entity ``person`` with a sphere for each known joint, in order, and the bones between them.

    joints_mm: (x, y, z) by name, depth camera, NaN = unknown. None removes the person. scheme: of the
    bones' colours.
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
    for *ends, region in BONES:
        if known.keys() >= set(ends):
            red, green, blue = (value / 255 for value in scheme.by_id[int(scheme.table[region])].rgb)
            for x, y, z in (known[end] for end in ends):
                lines.points.append(Point3(x=x, y=y, z=z))
                lines.colors.append(Color(r=red, g=green, b=blue, a=1))
    return SceneUpdate(entities=[entity])
