"""Unit quaternions (x, y, z, w) of rotation matrices, as ROS and Foxglove write them."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def quaternion_of(rotation: Array) -> Array:
    """Quaternion (4,) of a rotation matrix (3, 3), by its largest component (Shepperd 1978)."""
    m, trace = rotation, np.trace(rotation)
    largest = int(np.argmax([*np.diag(m), trace]))
    if largest == 3:
        q = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + trace])
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = np.empty(4)
        q[i] = 1 - trace + 2 * m[i, i]
        q[j], q[k] = m[j, i] + m[i, j], m[k, i] + m[i, k]
        q[3] = m[k, j] - m[j, k]
    return np.asarray(q / np.linalg.norm(q))


def rotation_of(quaternion: Array) -> Array:
    """Rotation matrix (3, 3) of a quaternion (4,) of any length.

    Raises ValueError where it has none.
    """
    length = float(np.linalg.norm(quaternion))
    if not 0 < length < np.inf:
        raise ValueError(f"a quaternion of length {length:g}")
    x, y, z, w = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
