"""Refinement of a network's labels by a second network, trained for this.

Like the suit network it takes depth and the room's planes (floor, walls). The first labels of the frame
replace the labels of the previous frame; colour and temperature are left out (docs/adr/0025).
"""

from dataclasses import replace
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, UInt16
from annotate.cloud.coarse import CoarseFuser
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset import convert
from annotate.labelset.labelled_frames import LabelledFrames, camera_of, pinhole_of
from annotate.parts import PAPER
from annotate.person.extract import PersonMask
from annotate.person.planes import Plane, find_planes
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import BACKGROUND, Scheme
from annotate.segmentation.input_channels import (
    SUBJECT,
    Rectangle,
    channels,
    fitted_to,
    rectangle,
    with_before,
)
from annotate.segmentation.segment import View, fine_pass, parts_of, placed
from annotate.segmentation.suit_network import SuitNetwork
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration

SHIPPED_REFINEMENT_NETWORK = Path(str(files("eval").joinpath("weights", "refine.onnx")))
"""Made by ``python -m tools.fit.refinement_network``."""
NEAR_M = 0.1  # around the first labels, in which pixels are refined; untuned


@cache
def shipped_refinement_network() -> SuitNetwork:
    """Return the refinement network that ships with the package."""
    return SuitNetwork(SHIPPED_REFINEMENT_NETWORK)


class DepthRoom(NamedTuple):
    """Planes found from depth alone, without temperatures; an `annotate.segmentation.input_channels.Room`."""

    planes: tuple[Plane, ...]
    share: Float32
    window_c: tuple[float, float] = (0.0, 0.0)


def camera_in(labels: LabelledFrames, first: FrameLabels) -> Intrinsics:
    """Return the pinhole camera of a labelled frame. Raises FormatError for a malformed note on it."""
    return pinhole_of(first, camera_of(labels, first))


def planes_in(camera: Intrinsics, depth_mm: UInt16) -> tuple[Plane, ...]:
    """Return the planes of the room in a depth image (h, w)."""
    return find_planes(_fusers(camera)[1].fuse(depth_mm).cloud)


def depth_view(
    first: FrameLabels,
    camera: Intrinsics,
    planes: tuple[Plane, ...] | None = None,
    scheme: Scheme = PAPER,
) -> tuple[ThermalCloud, View] | None:
    """Return a frame's cloud and the network input around the person in its first labels; None without a
    person.

    planes: of the room; None = find them here. scheme: of the network. Raises FormatError where the first
    labels do not convert to the scheme.
    """
    mask = first.on_person & (first.depth_mm > 0)
    if not mask.any():
        return None
    cloud = _fusers(camera)[0].fuse(first.depth_mm)
    persons = mask.astype(np.uint8) if first.persons is None else first.persons
    where, pixels_per_m = rectangle(cloud, mask)
    planes = planes_in(camera, first.depth_mm) if planes is None else planes
    room = DepthRoom(planes, cloud.temperature_c)
    seen = fitted_to(channels(cloud, room, PersonMask(mask, "depth", persons), where), scheme)
    seen = with_before(seen, first, where, scheme)
    return cloud, View(where, seen, cloud.color_rgb[where], pixels_per_m, np.zeros((0, 3), np.uint8))


def refine(
    camera: Intrinsics, first: FrameLabels, network: SuitNetwork, planes: tuple[Plane, ...] | None = None
) -> FrameLabels:
    """Return a frame with refined labels, in the network's scheme, of its person; other persons and a frame
    without person are unchanged.

    first: labels of the network. planes: of the room; None = find them from depth. Raises FormatError where
    the first labels do not convert to the schemes of the network.
    """
    view_of_depth = depth_view(first, camera, planes, network.own)
    if view_of_depth is None:
        return in_scheme(first, network.scheme)
    cloud, view = view_of_depth
    where, named, sure = fine_pass(cloud, view, _near(view, network.own), None, network)
    own = parts_of(named, network.scheme)
    if first.persons is not None:
        own = np.where(first.persons[where] <= 1, own, np.uint8(BACKGROUND))
    parts, confidence = placed(first.parts.shape, where, own, sure)
    on_body = network.scheme.on_body(parts)
    persons = first.persons
    if persons is not None:
        persons = np.where(on_body, np.uint8(1), np.where(persons == 1, np.uint8(0), persons))
    mean = round(float(confidence[on_body].mean()), 4) if on_body.any() else 0.0
    notes = first.notes | {"confidence": mean}
    return replace(
        first,
        parts=parts,
        confidence=confidence,
        notes=notes,
        persons=persons,
        scheme=network.scheme,
    )


def in_scheme(frame: FrameLabels, scheme: Scheme) -> FrameLabels:
    """Return a frame with its labels in a coarser scheme. Raises FormatError where a part would be split."""
    if frame.scheme == scheme:
        return frame
    return convert.in_scheme(frame, scheme, conversion_table(frame.scheme, scheme))


def _near(view: View, scheme: Scheme) -> Rectangle:
    """Return slices of a view's rows and columns: the bounding box of its labelled person, enlarged
    by ``NEAR_M``; the whole view in a scheme with things.
    """
    if scheme.is_thing.any():
        return Rectangle(*(slice(0, side) for side in view.planes.shape[1:]))
    own, margin = (view.planes[0] & SUBJECT) > 0, round(NEAR_M * view.pixels_per_m)
    ends = (np.flatnonzero(own.any(axis=1 - axis))[[0, -1]] for axis in (0, 1))
    sides = zip(ends, own.shape, strict=True)
    return Rectangle(*(slice(max(a - margin, 0), min(b + margin + 1, side)) for (a, b), side in sides))


@lru_cache(maxsize=2)
def _fusers(camera: Intrinsics) -> tuple[Fuser, CoarseFuser]:
    alone = RigCalibration(camera)
    return Fuser(alone), CoarseFuser(alone)
