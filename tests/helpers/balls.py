"""A person of balls before a wall, which a depth camera sees without error."""

import numpy as np

from annotate.frame_labels import FrameLabels
from sensors.rig.camera import Intrinsics, rays

CAMERA = Intrinsics(200, 160, 190.0, 190.0, 99.5, 79.5)
BODY = {
    1: (0, -0.42, 1.8, 0.13),
    2: (0, 0, 1.8, 0.26),
    4: (-0.36, 0.05, 1.75, 0.1),
    3: (0.36, 0.05, 1.75, 0.1),
}
"""part: (x, y, z, radius) of the ball that stands for it, metres, camera frame."""


def seen(shift=(0.0, 0.0, 0.0), frame_id="a") -> FrameLabels:
    """The balls, moved, before a wall; the nearest surface counts."""
    direction = rays(CAMERA)
    depth, parts = np.full(CAMERA.shape, 2.6), np.zeros(CAMERA.shape, np.uint8)
    for part, (*middle, radius) in BODY.items():
        middle = np.array(middle) + shift
        a, b = (direction**2).sum(axis=-1), direction @ middle
        inside = b**2 - a * (middle @ middle - radius**2)
        z = (b - np.sqrt(np.maximum(inside, 0))) / a
        nearer = (inside > 0) & (z < depth)
        depth[nearer], parts[nearer] = z[nearer], part
    return FrameLabels(frame_id, np.rint(depth * 1000).astype(np.uint16), parts)
