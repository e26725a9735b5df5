"""Camera descriptions and transforms of ROS and Foxglove messages (from any decoder) as plain values."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.lens_models import intrinsics_from_opencv, intrinsics_from_rational
from sensors.errors import CalibrationError, Setting
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, rotation_of

Decoded = Any
"""A message of the classes that rosbags and protobuf make at run time."""
_BROWN = ("plumb_bob", "rational_polynomial", "radtan", "brown_conrady", "")
"""Lens models with OpenCV's coefficients. image_geometry passes plumb_bob and rational_polynomial to OpenCV
alike, with any number of coefficients; radtan is Kalibr's name for the first four."""
_FISHEYES = ("equidistant", "fisheye", "kannala", "omni", "double_sphere", "ftheta", "f_theta", "ucm")
_PLAIN, _RATIONAL, _MOST = 5, 8, 14  # numbers of the polynomial, rational and tilted thin-prism lens


class Window(NamedTuple):
    """Region of the calibrated sensor that an image shows, with binning.

    left, top: corner of the region. block_x, block_y: sensor pixels per image pixel. size: (width, height) of
    the image in its own pixels.
    """

    left: int
    top: int
    block_x: int
    block_y: int
    size: tuple[int, int]


def window_of(message: Decoded) -> Window:
    """Return the binning and the region of interest of a CameraInfo; a CameraCalibration has none.

    A region is in unbinned pixels, 0 wide or high is the whole sensor, binning 0 is 1 (REP 104).
    """
    x, y = (max(1, int(getattr(message, f"binning_{axis}", 1))) for axis in "xy")
    width, height, left, top = int(message.width), int(message.height), 0, 0
    region = getattr(message, "roi", None)
    if region is not None and region.width and region.height:
        left, top, width, height = (
            int(getattr(region, part)) for part in ("x_offset", "y_offset", "width", "height")
        )
    return Window(left, top, x, y, (width // x, height // y))


def describes(message: Decoded, size: tuple[int, int]) -> bool:
    """Return whether a camera message describes images of this size (width, height)."""
    return size in (window_of(message).size, (int(message.width), int(message.height)))


def intrinsics_from(
    message: Decoded, rectified: bool, name: str, size: tuple[int, int] | None = None
) -> Intrinsics:
    """Return the camera of a CameraInfo or CameraCalibration.

    rectified: True for the camera of the rectified image. size: (width, height) of the image; None = the
    message's. Binning and region of interest that give this size are applied as
    ``image_geometry::PinholeCameraModel::fromCameraInfo`` does. Raises CalibrationError, which names the
    topic ``name``.
    """
    # ROS 1 and Foxglove write large letters, ROS 2 small ones.
    fields = (getattr(message, letter if hasattr(message, letter) else letter.upper()) for letter in "dkp")
    d, k, p = (np.array(field, np.float64) for field in fields)
    matrix = k.reshape(3, 3) if k.size == 9 else np.zeros((3, 3))
    if rectified and p.size == 12 and p[0] > 0:
        matrix = p.reshape(3, 4)[:, :3]
    if not matrix[:2, :2].any():
        raise CalibrationError(
            f"{name} holds no calibration (its matrix K is zero); calibrate the camera, or give its "
            "intrinsics",
            Setting.INTRINSICS,
        )
    full = int(message.width), int(message.height)
    window = window_of(message)
    if size is not None and size != full and size == window.size:
        shift = np.array([[1.0, 0, -window.left], [0, 1, -window.top], [0, 0, 1]])
        matrix = np.diag([1 / window.block_x, 1 / window.block_y, 1.0]) @ shift @ matrix
    model = str(message.distortion_model).strip().lower().replace(" ", "_")
    return _with_lens(matrix, size or full, np.zeros(0) if rectified else d, model, name)


def _with_lens(
    matrix: NDArray[np.float64], size: tuple[int, int], d: NDArray[np.float64], model: str, name: str
) -> Intrinsics:
    """Return a pinhole with OpenCV's coefficients k1 k2 p1 p2 k3 k4 k5 k6 and more; missing last ones
    are 0.
    """
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not np.isfinite(d).all():
        raise CalibrationError(
            f"{name} has lens coefficients that are not finite ({', '.join(f'{n:g}' for n in d[:5])}); "
            "give intrinsics",
            Setting.INTRINSICS,
        )
    fisheye = d.size > 0 and any(word in model for word in _FISHEYES)
    used = int(np.flatnonzero(d)[-1]) + 1 if d.any() else 0
    if not fisheye and not used:
        return Intrinsics(*size, fx, fy, cx, cy)
    if fisheye or model not in _BROWN or d.size > _MOST:
        raise CalibrationError(
            f"{name} has lens model {model[:40]!r} with {d.size} coefficients; give plumb_bob or "
            f"rational_polynomial with at most {_MOST}, or record the rectified image"
        )
    if used > _RATIONAL:
        return intrinsics_from_opencv(Intrinsics(*size, fx, fy, cx, cy), np.pad(d, (0, _MOST - d.size)), name)
    lens = np.pad(d[:used], (0, _RATIONAL - used))
    if used <= _PLAIN:
        return Intrinsics(*size, fx, fy, cx, cy, *lens[:_PLAIN].tolist())
    return intrinsics_from_rational(size, matrix, lens)


def links_from(message: Decoded) -> Iterator[tuple[str, str, Pose]]:
    """Yield (parent, child, parent_from_child) of every transform of a message. Raises CalibrationError for
    an impossible rotation.
    """
    for transform in message.transforms if hasattr(message, "transforms") else [message]:
        if hasattr(transform, "header"):
            parent, child, move = transform.header.frame_id, transform.child_frame_id, transform.transform
        else:
            parent, child, move = transform.parent_frame_id, transform.child_frame_id, transform
        t, q = move.translation, move.rotation
        quaternion = np.array([q.x, q.y, q.z, q.w], np.float64)
        if not 0.5 < (length := float(np.linalg.norm(quaternion))) < 2:
            raise CalibrationError(
                f"the transform to {child[:60]!r} has a rotation quaternion of length {length:g} instead "
                "of 1; record it again"
            )
        pose = Pose(rotation_of(quaternion), np.array([t.x, t.y, t.z], np.float64))
        yield str(parent).lstrip("/"), str(child).lstrip("/"), pose  # ROS writes some names with a slash
