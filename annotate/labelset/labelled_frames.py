"""Labelled frames of a label set or dataset, and the camera of their pixels."""

from pathlib import Path
from typing import TypeAlias

from annotate.crop import crop_from_note
from annotate.frame_labels import FrameLabels
from annotate.labelset import dataset, label_set
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.errors import CalibrationError, FormatError, fault_of
from sensors.rig.camera import Intrinsics

LabelledFrames: TypeAlias = label_set.LabelSet | dataset.Dataset


def holds_frames(path: Path) -> bool:
    """Return whether a folder is a label set or a dataset."""
    return any((path / manifest).exists() for manifest in (label_set.MANIFEST, dataset.MANIFEST))


def open_frames(path: Path) -> LabelledFrames:
    """Open a label set or a dataset. Raises FormatError where the path is neither, or is broken."""
    if (path / dataset.MANIFEST).exists():
        return dataset.Dataset.open(path)
    return label_set.LabelSet.open(path)


def camera_of(frames: LabelledFrames, frame: FrameLabels) -> Intrinsics:
    """Return the undistorted depth camera of the whole image that a frame shows or was cropped from.

    Synthetic frames note their sensor's ``intrinsics`` (width, height, fx, fy, cx, cy) unless it is a Kinect
    v2. Raises FormatError for an invalid note.
    """
    if "crop" not in frame.notes:
        return frames.whole_image
    if "intrinsics" not in frame.notes:
        return KINECT2_PINHOLE
    try:
        return Intrinsics(*frame.notes["intrinsics"])
    except (TypeError, CalibrationError) as error:
        raise FormatError(
            f"frame {frame.frame_id}: field notes.intrinsics is malformed ({fault_of(error)}); "
            "give width, height, fx, fy, cx, cy"
        ) from error


def pinhole_of(frame: FrameLabels, camera: Intrinsics) -> Intrinsics:
    """Return the pinhole camera of a frame's own pixels; camera: of the whole image. Raises FormatError for a
    malformed note ``crop``.
    """
    if "crop" not in frame.notes:
        return camera
    return crop_from_note(frame.notes["crop"], "crop").camera(camera, frame.depth_mm.shape[0])
