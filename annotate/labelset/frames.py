"""What a label set and a dataset have in common: labelled frames, where each lies, and their camera."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from annotate.crop import crop_from_note
from annotate.frame_labels import FrameLabels
from sensors.rig.camera import Intrinsics
from sensors.rig.kinect2_factory import KINECT2_PINHOLE


class Entry(NamedTuple):
    """Where a frame lies: its id, its shard and the first byte there; a label set has no shards."""

    frame_id: str
    shard: str = ""
    offset: int = 0


class LabelledFrames(Protocol):
    """Frames with labels on disk.

    info: the manifest's entries on their making. intrinsics: the camera of their pixels; crops from all over
    an image share one that stands in its middle. whole_image: the undistorted camera of the image that frames
    are, or are crops of. source: name of what they
    were made from. identity: entries by which a label set made from these frames differs from one made from
    others.
    """

    @property
    def path(self) -> Path: ...

    @property
    def info(self) -> dict[str, Any]: ...

    @property
    def intrinsics(self) -> Intrinsics: ...

    @property
    def whole_image(self) -> Intrinsics: ...

    @property
    def source(self) -> str: ...

    @property
    def identity(self) -> dict[str, str]: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[FrameLabels]: ...

    def entries(self) -> Iterator[Entry]:
        """Where the frames lie, in order. Raises FormatError where a shard breaks off."""
        ...

    def load(self, entry: Entry) -> FrameLabels:
        """The frame of an entry. Raises FormatError where it cannot be read."""
        ...


def camera_of(frames: LabelledFrames, frame: FrameLabels) -> Intrinsics:
    """The undistorted depth camera of the whole image that a frame is, or by its notes is a crop of."""
    return KINECT2_PINHOLE if "crop" in frame.notes else frames.whole_image


def pinhole_of(frame: FrameLabels, camera: Intrinsics) -> Intrinsics:
    """The pinhole of a frame's own pixels: ``camera``, or the part of it that the frame is a crop of.

    Raises FormatError when the note on the crop is malformed.
    """
    if "crop" not in frame.notes:
        return camera
    return crop_from_note(frame.notes["crop"], "crop").camera(camera, frame.depth_mm.shape[0])
