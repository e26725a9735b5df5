"""Labelled frames of any origin, and the camera that saw them."""

from pathlib import Path

from annotate.crop import crop_from_note
from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import MANIFEST, Dataset
from annotate.labelset.store import LabelSet
from sensors.rig.camera import Intrinsics
from sensors.rig.kinect2_factory import KINECT2_PINHOLE

Frames = LabelSet | Dataset
"""Whatever holds labelled frames: one reader serves both."""


def open_frames(path: Path) -> Frames:
    """Open a label set or a dataset. Raises FormatError when the folder is neither."""
    return Dataset.open(path) if (path / MANIFEST).is_file() else LabelSet.open(path)


def camera_of(frames: Frames, frame: FrameLabels) -> Intrinsics:
    """The undistorted depth camera of the whole image that a set's frame is, or by its notes is a crop of."""
    if isinstance(frames, LabelSet) and "crop" not in frame.notes:
        return frames.intrinsics.undistorted()
    return KINECT2_PINHOLE


def pinhole_of(frame: FrameLabels, camera: Intrinsics) -> Intrinsics:
    """The pinhole of a frame's own pixels: ``camera``, or the part of it that the frame is a crop of.

    Raises FormatError when the note on the crop is malformed.
    """
    if "crop" not in frame.notes:
        return camera
    return crop_from_note(frame.notes["crop"], "crop").camera(camera, frame.depth_mm.shape[0])
