"""Camera descriptions and transforms of ROS and Foxglove messages (from any decoder) as plain values."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, intrinsics_from_rational
from sensors.rig.rig_calibration import Pose, rotation_of

Decoded = Any
"""A message of the classes that rosbags and protobuf make at run time."""


def intrinsics_from(message: Decoded, rectified: bool, name: str) -> Intrinsics:
    """The pinhole of a CameraInfo or CameraCalibration with its lens, or that of the rectified image.

    Raises CalibrationError, which names the topic ``name``.
    """
    # ROS 1 and Foxglove write large letters, ROS 2 small ones.
    d, k, p = (
        np.array(getattr(message, letter if hasattr(message, letter) else letter.upper()), np.float64)
        for letter in "dkp"
    )
    matrix = k.reshape(3, 3) if k.size == 9 else np.zeros((3, 3))
    if rectified and p.size == 12 and p[0] > 0:
        matrix = p.reshape(3, 4)[:, :3]
    size, model = (int(message.width), int(message.height)), str(message.distortion_model)
    pinhole = [float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
    if rectified or not d.any():
        return Intrinsics(*size, *pinhole)
    if model in ("plumb_bob", "") and d.size in (4, 5):
        return Intrinsics(*size, *pinhole, *d.tolist())
    if model == "rational_polynomial" and d.size == 8 and np.isfinite(d).all():
        return intrinsics_from_rational(size, matrix, d)
    raise CalibrationError(
        f"{name} has lens model {model[:40]!r} with {d.size} numbers; give plumb_bob or "
        "rational_polynomial, or record the rectified image"
    )


def links_from(message: Decoded) -> Iterator[tuple[str, str, Pose]]:
    """(parent, child, parent_from_child) of every transform of a message. Raises CalibrationError."""
    for transform in message.transforms if hasattr(message, "transforms") else [message]:
        if hasattr(transform, "header"):
            parent, child, move = transform.header.frame_id, transform.child_frame_id, transform.transform
        else:
            parent, child, move = transform.parent_frame_id, transform.child_frame_id, transform
        t, q = move.translation, move.rotation
        quaternion = np.array([q.x, q.y, q.z, q.w], np.float64)
        if not 0.5 < float(np.linalg.norm(quaternion)) < 2:
            raise CalibrationError(f"the transform to {child[:60]!r} has no rotation; record it again")
        # ROS writes some names with a slash before them.
        pose = Pose(rotation_of(quaternion), np.array([t.x, t.y, t.z], np.float64))
        yield str(parent).lstrip("/"), str(child).lstrip("/"), pose
