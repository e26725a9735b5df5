"""Small label set of two parts for correction sessions, and a clock that is set by hand."""

from pathlib import Path

import numpy as np

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from sensors.rig.camera import Intrinsics

H, W = 12, 16
FRAMES = ("000000", "000001", "000002")


class Clock:
    """Clock of which the seconds are set by hand."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def correctable(path: Path) -> Path:
    """Write a set of three equal frames, and return its path."""
    labels = LabelSet.create(path, Intrinsics(W, H, 20, 20, 8, 6), {"source": "test"})
    parts = np.zeros((H, W), np.uint8)
    parts[2:10, 2:8], parts[2:10, 8:14] = 2, 3
    depth = np.full((H, W), 1500, np.uint16)
    depth[0] = 0
    for frame_id in FRAMES:
        confidence = np.full((H, W), 0.8, np.float32)
        labels.write(FrameLabels(frame_id, depth, parts, confidence, subject="s", notes={"confidence": 0.5}))
    return labels.path
