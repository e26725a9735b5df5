"""Labels of people without a suit, read again by a reader that has learnt one person and room.

The reader of suits sees depth, the planes of the room, and in the place of the labels of the frame before the
first labels of the same frame; no colour and no temperature (docs/adr/0025).
"""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.crop import person_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.frames import LabelledFrames, camera_of, pinhole_of
from annotate.parts import BACKGROUND
from annotate.person.extract import PersonMask
from annotate.person.planes import Plane, find_planes
from annotate.reader.channels import Rectangle, channels, rectangle
from annotate.reader.network import Reader
from annotate.reader.read import OTHER_PERSON, View, finely
from sensors.rig.camera import Intrinsics, unproject

SHIPPED_AGAIN = Path(str(files("eval").joinpath("weights", "again.onnx")))
"""The reader that learnings by depth begin with: it has learnt a network's labels, of nobody in particular
(``python -m tools.fit.depth_reader``)."""


class DepthRoom(NamedTuple):
    """What depth alone tells of a frame's room, as `annotate.reader.channels.Room`."""

    planes: tuple[Plane, ...]
    share: Float32
    window_c: tuple[float, float] = (0.0, 0.0)


def camera_in(labels: LabelledFrames, first: FrameLabels) -> Intrinsics:
    """The pinhole of a labelled frame's own pixels. Raises FormatError where a note on it is malformed."""
    return pinhole_of(first, camera_of(labels, first))


def depth_view(first: FrameLabels, camera: Intrinsics) -> tuple[ThermalCloud, View] | None:
    """Cloud of a frame, and what the reader sees of the person that its first labels show; None: nobody."""
    mask = person_of(first.parts) & (first.depth_mm > 0)
    if not mask.any():
        return None
    cloud = _bare_cloud(first, camera)
    coarse = CoarseCloud.of(cloud).cloud
    room = DepthRoom(find_planes(coarse, coarse.valid), cloud.temperature_c)
    where, pixels_per_m = rectangle(cloud, mask)
    planes = channels(cloud, room, PersonMask(mask, "depth", mask.astype(np.uint8)), first, where)
    return cloud, View(where, planes, cloud.color_rgb[where], pixels_per_m, np.zeros((0, 3), np.uint8), None)


def read_again(first: FrameLabels, camera: Intrinsics, reader: Reader) -> FrameLabels:
    """A frame with the labels of a reader that has learnt; the same where it shows nobody.

    first: the frame as the network labelled it. What else that says of the person stays.
    """
    seen = depth_view(first, camera)
    if seen is None:
        return first
    cloud, view = seen
    whole = Rectangle(*(slice(0, side) for side in view.planes.shape[1:]))
    where, named, sure = finely(cloud, view, whole, None, reader)
    own = (named != BACKGROUND) & (named != OTHER_PERSON)
    parts: UInt8 = np.full(first.parts.shape, BACKGROUND, np.uint8)
    confidence: Float32 = np.zeros(first.parts.shape, np.float32)
    parts[where], confidence[where] = np.where(own, named, BACKGROUND), np.where(own, sure, 0)
    on_body = parts != BACKGROUND
    notes = first.notes | {
        "confidence": round(float(confidence[on_body].mean()), 4) if on_body.any() else 0.0
    }
    return replace(first, parts=parts, confidence=confidence, notes=notes, persons=None)


def _bare_cloud(first: FrameLabels, camera: Intrinsics) -> ThermalCloud:
    """Cloud of a depth image without colour and temperature."""
    unseen = np.full(first.depth_mm.shape, np.nan, np.float32)
    depth_m = np.where(first.depth_mm > 0, first.depth_mm * np.float32(1e-3), unseen)
    color = np.zeros((*unseen.shape, 3), np.uint8)
    return ThermalCloud(camera, first.depth_mm, unproject(camera, depth_m), color, color[..., 0] > 0, unseen)
