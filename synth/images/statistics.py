"""What a dataset holds, counted: pixels per part, depth, visibility, views and poses."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float64, Int64
from annotate.frame_labels import FrameLabels
from annotate.parts import N_CLASSES
from synth.body.skeleton import JOINT_ID, N_JOINTS

DEPTH_EDGES_MM = np.arange(500, 4501, 100)
AZIMUTH_EDGES_DEG = np.arange(-180, 181, 15)
HEIGHT_EDGES_M = np.arange(0.0, 3.01, 0.1)
"""Edges of the histograms of depth, and of the camera's azimuth and height."""


@dataclass(frozen=True)
class Statistics:
    """Counts over some frames.

    pixels: (12,) in each part, [0] background. shown: (12,) share of the frames that show the part at
    all, [0] all frames. depth: pixels between DEPTH_EDGES_MM. visible: (12,) mean share that nothing but
    the person's own body hides, [0] of the whole person. azimuth, height: frames between the edges.
    joints_mm: (n, J, 3), camera frame, relative to the pelvis. activities: frames by name, most first.
    occluded, cut: share of the frames with occluders, and with holes in the extraction.
    """

    frames: int
    pixels: Int64
    shown: Float64
    depth: Int64
    visible: Float64
    azimuth: Int64
    height: Int64
    joints_mm: Float64
    activities: dict[str, int]
    occluded: float
    cut: float

    @property
    def spread_mm(self) -> Float64:
        """RMS distance (J,) of every joint from its mean place relative to the pelvis."""
        away = self.joints_mm - self.joints_mm.mean(axis=0)
        return np.asarray(np.sqrt(np.square(away).sum(axis=2).mean(axis=0)))


def statistics_of(frames: Iterable[FrameLabels]) -> Statistics:
    """Go through generated frames once; their notes are those of ``presets``, one frame at least."""
    pixels, shown = np.zeros(N_CLASSES, np.int64), np.zeros(N_CLASSES, np.int64)
    depth = np.zeros(len(DEPTH_EDGES_MM) - 1, np.int64)
    notes = []
    for frame in frames:
        in_part = np.bincount(frame.parts.ravel(), minlength=N_CLASSES)[:N_CLASSES]
        pixels += in_part
        shown += in_part > 0
        depth += np.histogram(frame.depth_mm[frame.parts > 0], DEPTH_EDGES_MM)[0]
        notes.append(frame.notes)
    joints = np.array([n["joints_mm"] for n in notes], np.float64).reshape(-1, N_JOINTS, 3)
    return Statistics(
        len(notes),
        pixels,
        shown / len(notes),
        depth,
        np.array([n["visible"] for n in notes]).mean(axis=0),
        np.histogram([n["camera"]["azimuth_deg"] for n in notes], AZIMUTH_EDGES_DEG)[0],
        np.histogram([n["camera"]["height_m"] for n in notes], HEIGHT_EDGES_M)[0],
        joints - joints[:, JOINT_ID["pelvis"], None],
        dict(Counter(n["activity"] for n in notes).most_common()),
        float(np.mean([n["occluders"] > 0 for n in notes])),
        float(np.mean([n["cut"] > 0 for n in notes])),
    )
