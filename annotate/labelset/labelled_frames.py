"""Labelled frames of a folder: a label set or a dataset, and the camera of their pixels."""

from pathlib import Path
from typing import TypeAlias

from annotate.crop import crop_from_note
from annotate.frame_labels import FrameLabels
from annotate.labelset import dataset
from annotate.labelset import label_set as store
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.errors import CalibrationError, FormatError
from sensors.rig.camera import Intrinsics

LabelledFrames: TypeAlias = store.LabelSet | dataset.Dataset
"""Frames with labels on disk; both kinds are read the same way."""


def holds_frames(path: Path) -> bool:
    """Whether a folder is a label set or a dataset."""
    return any((path / manifest).is_file() for manifest in (store.MANIFEST, dataset.MANIFEST))


def open_frames(path: Path) -> LabelledFrames:
    """Open a label set or a dataset. Raises FormatError when the folder is neither."""
    if (path / dataset.MANIFEST).is_file():
        return dataset.Dataset.open(path)
    return store.LabelSet.open(path)


def camera_of(frames: LabelledFrames, frame: FrameLabels) -> Intrinsics:
    """The undistorted depth camera of the whole image that a frame is, or by its notes is a crop of.

    Synthetic frames note their sensor's ``intrinsics`` (width, height, fx, fy, cx, cy) unless it is a Kinect
    v2. Raises FormatError when that note is malformed.
    """
    if "crop" not in frame.notes:
        return frames.whole_image
    if "intrinsics" not in frame.notes:
        return KINECT2_PINHOLE
    try:
        return Intrinsics(*frame.notes["intrinsics"])
    except (TypeError, CalibrationError) as error:
        raise FormatError(
            f"frame {frame.frame_id}: its note 'intrinsics' is malformed ({error}); "
            "give width, height, fx, fy, cx, cy"
        ) from error


def pinhole_of(frame: FrameLabels, camera: Intrinsics) -> Intrinsics:
    """The pinhole of a frame's own pixels: ``camera``, or the part of it that the frame is a crop of.

    Raises FormatError when the note on the crop is malformed.
    """
    if "crop" not in frame.notes:
        return camera
    return crop_from_note(frame.notes["crop"], "crop").camera(camera, frame.depth_mm.shape[0])
