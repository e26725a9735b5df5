"""The truth of the virtual rig: parts and persons (h, w) of the surfaces that readings lie on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64, Int32, UInt8
from annotate.cloud.fuse import undistortion_index
from annotate.frame_labels import FrameLabels
from annotate.parts import N_CLASSES, UNDEFINED
from sensors.rig.frame import RigFrame
from sensors.rig.kinect2_factory import KINECT2_DEPTH
from synth.cameras.depth_noise import DepthNoise
from synth.surface.furniture import Surface
from synth.surface.rasterize import ZBuffer

FLYING_MM = 60.0
"""A reading further than this from every surface behind its pixel and the next belongs to none: undefined."""


@dataclass(frozen=True)
class Truth:
    """The truth of a frame. Over the raw depth image: parts, persons uint8 (h, w), as ``FrameLabels``.

    joints_m: (J, 3), depth camera. hard: what makes the frame hard, in words.
    """

    parts: UInt8
    persons: UInt8
    joints_m: Float64
    subject: str
    hard: tuple[str, ...]


def whose_readings(
    seen: ZBuffer, tags: Int32, depth_mm: NDArray[np.uint16], noise: DepthNoise
) -> tuple[UInt8, UInt8]:
    """Parts and persons (h, w) of the surfaces that the readings lie on.

    A reading belongs to the surface behind its pixel or, where the edge has jittered, behind a neighbour;
    one that lies on none of them is undefined.
    """
    tag = np.append(tags, 0)[seen.face]
    expected = noise.offset_mm + 1000 * noise.scale * np.nan_to_num(seen.depth_m)
    off_mm = np.abs(depth_mm - expected)
    v, u = np.nonzero((depth_mm > 0) & (off_mm > FLYING_MM))
    nearest = np.full(len(v), FLYING_MM)
    found = np.zeros(len(v), np.int64) - 1
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            y, x = (v + dv).clip(0, tag.shape[0] - 1), (u + du).clip(0, tag.shape[1] - 1)
            gap = np.abs(depth_mm[v, u] - expected[y, x])
            found = np.where(gap < nearest, tag[y, x], found)
            nearest = np.minimum(nearest, gap)
    tag[v, u] = found
    parts = np.where((tag > 0) & (tag < N_CLASSES), tag, 0).astype(np.uint8)
    persons = (parts > 0) + np.uint8(2) * (tag == Surface.OTHER_PERSON)
    parts[tag < 0] = UNDEFINED
    parts[depth_mm == 0] = persons[depth_mm == 0] = 0
    return parts, persons.astype(np.uint8)


def truth_labels(frame: RigFrame, truth: Truth) -> FrameLabels:
    """The truth over the undistorted depth image, undistorted exactly as fusion does it."""
    source = undistortion_index(KINECT2_DEPTH)
    depth_mm, parts, persons = (
        np.where(source >= 0, image.ravel()[source], 0)
        for image in (frame.depth_mm, truth.parts, truth.persons)
    )
    notes = {"joints_mm": np.rint(truth.joints_m * 1000).astype(int).tolist(), "hard": list(truth.hard)}
    return FrameLabels(
        f"{frame.index:06d}",
        depth_mm.astype(np.uint16),
        parts.astype(np.uint8),
        subject=truth.subject,
        status="truth",
        notes=notes,
        persons=persons.astype(np.uint8),
    )
