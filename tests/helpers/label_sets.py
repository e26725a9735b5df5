"""Small label sets for exports."""

from pathlib import Path

import numpy as np

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from sensors.rig.camera import Intrinsics


def make(path: Path, camera: Intrinsics, frames: list[FrameLabels]) -> LabelSet:
    labels = LabelSet.create(path, camera, {})
    for frame in frames:
        labels.write(frame)
    return labels


def blocks(seed: int = 0) -> FrameLabels:
    """All parts and undefined in blocks, noise within; two persons; depth everywhere but in one corner."""
    rng = np.random.default_rng(seed)
    ids = np.array([0, *range(12), 255, 0, 3], np.uint8).reshape(4, 4)
    parts = np.kron(ids, np.ones((6, 8), np.uint8))
    parts[rng.random(parts.shape) < 0.1] = 0
    depth = rng.integers(500, 4500, parts.shape).astype(np.uint16)
    depth[:4, :5] = 0
    persons = (parts > 0).astype(np.uint8)
    persons[20:, 24:] = 2
    confidence = (rng.integers(0, 256, parts.shape) / np.float32(255)).astype(np.float32)
    return FrameLabels(f"{seed:06d}", depth, parts, confidence, "corrected", f"P{seed}", {}, persons)


CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.5)
