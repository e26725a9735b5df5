"""Training targets for facing, posture and joints of a person, as one row of values; NaN = unknown."""

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt16
from annotate.crop import RANGE_MM, SIZE, network_crop
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, pinhole_of
from annotate.posture import POSTURES
from eval.scores.joint_errors import noted_joints_mm
from eval.scores.joints import IN_SKELETON, N_JOINTS, TWIN
from sensors.rig.camera import Intrinsics
from synth.body.skeleton import N_JOINTS as N_SKELETON
from synth.pose.pose_parameters import posture_class

FACING, POSTURE, JOINTS = slice(0, 2), 2, slice(3, 3 + 3 * N_JOINTS)
"""Places in a row: cosine and sine of the camera's azimuth about the trunk; index of the posture; joints
(J, 3) as ``NetworkOutput.joints``."""
ROW = JOINTS.stop


def no_targets() -> Float32:
    """Return a row (ROW,) of targets that are all unknown."""
    return np.full(ROW, np.nan, np.float32)


def body_targets(frames: LabelledFrames, frame: FrameLabels) -> Float32:
    """Return the row (ROW,) of targets from a frame's notes, joints in the crop of ``to_crop``."""
    row = no_targets()
    posture = frame.notes.get("posture", posture_class(str(frame.notes.get("activity", ""))))
    if posture in POSTURES:
        row[POSTURE] = POSTURES.index(posture)
    joints_mm = noted_joints_mm(frame)
    if joints_mm is None:
        return row
    camera = pinhole_of(frame, camera_of(frames, frame))
    seen = frame.on_person & (frame.depth_mm > 0)
    return with_joints(row, joints_mm[IN_SKELETON], camera, (frame.depth_mm, seen))


def with_joints(row: Float32, joints_mm: Float64, camera: Intrinsics, image: tuple[UInt16, Bool]) -> Float32:
    """Return a row of targets with joints (J, 3), millimetres in the camera frame, and the facing by them.

    camera: pinhole camera of the image. image: depth and the pixels of the crop's person, both (h, w). Joints
    become columns and rows in shares of the crop's side, and depth in its units. A joint in the camera's
    plane is unknown, because the image has no place for it.
    """
    from synth.images.standing_statistics import facing_deg

    joints_mm = np.where(joints_mm[:, 2:] == 0, np.nan, joints_mm)
    skeleton = np.full((N_SKELETON, 3), np.nan)
    skeleton[IN_SKELETON] = joints_mm
    azimuth = np.radians(facing_deg(skeleton))
    (depth_mm, seen), (x, y, z) = image, joints_mm.T
    crop = network_crop(seen)
    u = (x / z * camera.fx + camera.cx + 0.5 - crop.left) / crop.side
    v = (y / z * camera.fy + camera.cy + 0.5 - crop.top) / crop.side
    z = (z - float(np.median(depth_mm[seen]))) / RANGE_MM + 0.5
    other = row.copy()
    other[FACING], other[JOINTS] = (np.cos(azimuth), np.sin(azimuth)), np.column_stack([u, v, z]).ravel()
    return other


def swap_sides(row: Float32) -> Float32:
    """Return a row of targets with left and right exchanged; the joints' image columns are not mirrored."""
    other = row.copy()
    other[1] = -row[1]
    other[JOINTS] = row[JOINTS].reshape(N_JOINTS, 3)[TWIN].ravel()
    return other


def move_joints(row: Float32, crop_from_source: Float64, size: int = SIZE) -> Float32:
    """Return a row of targets, its joints moved by an affine map (2, 3) of pixels. size: side of the crop,
    px.
    """
    other = row.copy()
    joints = other[JOINTS].reshape(N_JOINTS, 3)
    pixels = joints[:, :2] * size - 0.5
    joints[:, :2] = (pixels @ crop_from_source[:, :2].T + crop_from_source[:, 2] + 0.5) / size
    return other
