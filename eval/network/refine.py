"""Labels of a person without a suit, read again: by the shipped reader, or by one that has learnt.

Like the reader of suits it sees depth and the planes of the room, and in the place of the labels of the frame
before the first labels of the same frame; no colour, no temperature (docs/adr/0025).
"""

from dataclasses import replace
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.cloud.coarse import CoarseFuser
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.crop import person_of
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, pinhole_of
from annotate.parts import BACKGROUND
from annotate.person.extract import PersonMask
from annotate.person.planes import Plane, find_planes
from annotate.segmentation.input_channels import SUBJECT, Rectangle, channels, rectangle, with_before
from annotate.segmentation.segment import OTHER_PERSON, View, fine_pass
from annotate.segmentation.suit_network import SuitNetwork
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration

SHIPPED_AGAIN = Path(str(files("eval").joinpath("weights", "refine.onnx")))
"""The reader that has learnt to read a network's labels, of nobody in particular: learnings begin with it
(``python -m tools.fit.refinement_network``)."""
NEAR_M = 0.1
"""Metres around the first labels that are read; more changes nothing on two recordings (chosen by eye)."""


@cache
def shipped_again() -> SuitNetwork:
    """The reader that comes with the package."""
    return SuitNetwork(SHIPPED_AGAIN)


class DepthRoom(NamedTuple):
    """What depth alone tells of a frame's room, as `annotate.segmentation.input_channels.Room`."""

    planes: tuple[Plane, ...]
    share: Float32
    window_c: tuple[float, float] = (0.0, 0.0)


def camera_in(labels: LabelledFrames, first: FrameLabels) -> Intrinsics:
    """The pinhole of a labelled frame's own pixels. Raises FormatError where a note on it is malformed."""
    return pinhole_of(first, camera_of(labels, first))


def depth_view(
    first: FrameLabels, camera: Intrinsics, planes: tuple[Plane, ...] | None = None
) -> tuple[ThermalCloud, View] | None:
    """Cloud of a frame, and what the reader sees of the person that its first labels show; None: nobody.

    planes: of the room, None = found here.
    """
    mask = person_of(first.parts) & (first.depth_mm > 0)
    if not mask.any():
        return None
    whole, coarse = _fusers(camera)
    cloud = whole.fuse(first.depth_mm)
    persons = mask.astype(np.uint8) if first.persons is None else first.persons
    where, pixels_per_m = rectangle(cloud, mask)
    planes = find_planes(coarse.fuse(first.depth_mm).cloud) if planes is None else planes
    room = DepthRoom(planes, cloud.temperature_c)
    seen = with_before(channels(cloud, room, PersonMask(mask, "depth", persons), where), first, where)
    return cloud, View(where, seen, cloud.color_rgb[where], pixels_per_m, np.zeros((0, 3), np.uint8))


def read_again(
    camera: Intrinsics, first: FrameLabels, reader: SuitNetwork, planes: tuple[Plane, ...] | None = None
) -> FrameLabels:
    """A frame with a reader's labels of its person; the same where it shows nobody.

    first: as the network labelled it. What else that says of the person stays, and so do other persons.
    planes: of the room, None = found from depth.
    """
    seen = depth_view(first, camera, planes)
    if seen is None:
        return first
    cloud, view = seen
    where, named, sure = fine_pass(cloud, view, _near(view), None, reader)
    own = (named != BACKGROUND) & (named != OTHER_PERSON)
    if first.persons is not None:
        own &= first.persons[where] <= 1
    parts: UInt8 = np.full(first.parts.shape, BACKGROUND, np.uint8)
    confidence: Float32 = np.zeros(first.parts.shape, np.float32)
    parts[where], confidence[where] = np.where(own, named, BACKGROUND), np.where(own, sure, 0)
    on_body = parts != BACKGROUND
    persons = first.persons
    if persons is not None:
        persons = np.where(on_body, np.uint8(1), np.where(persons == 1, np.uint8(0), persons))
    sure_of = round(float(confidence[on_body].mean()), 4) if on_body.any() else 0.0
    notes = first.notes | {"confidence": sure_of}
    return replace(first, parts=parts, confidence=confidence, notes=notes, persons=persons)


def _near(view: View) -> Rectangle:
    """Rows and columns of a view around the person that the first labels show."""
    own, margin = (view.planes[0] & SUBJECT) > 0, round(NEAR_M * view.pixels_per_m)
    ends = (np.flatnonzero(own.any(axis=1 - axis))[[0, -1]] for axis in (0, 1))
    sides = zip(ends, own.shape, strict=True)
    return Rectangle(*(slice(max(a - margin, 0), min(b + margin + 1, side)) for (a, b), side in sides))


@lru_cache(maxsize=2)
def _fusers(camera: Intrinsics) -> tuple[Fuser, CoarseFuser]:
    """Fusion of a pinhole camera's depth images, without colour and temperature."""
    alone = RigCalibration(camera)
    return Fuser(alone), CoarseFuser(alone)
