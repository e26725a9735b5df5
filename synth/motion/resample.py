"""A motion at another number of frames a second."""

from dataclasses import replace

import numpy as np

from annotate.array_types import Float64
from synth.body.euler import euler_rad
from synth.body.skeleton import rotations
from synth.markers.motion_file import Motion

FLIP_RAD = 1.5
"""Angles that differ by more between two frames are the same rotation spelled otherwise. Untuned."""


def resampled(motion: Motion, frames_per_second: float) -> Motion:
    """The motion at these frames a second, between its own frames by linear angles, the pelvis by slerp."""
    from scipy.spatial.transform import Rotation, Slerp

    frames = max(1, round((len(motion) - 1) / motion.frames_per_second * frames_per_second) + 1)
    at = np.minimum(np.arange(frames) * motion.frames_per_second / frames_per_second, len(motion) - 1)
    before = np.minimum(at.astype(int), max(0, len(motion) - 2))
    after = np.minimum(before + 1, len(motion) - 1)
    share = at - before

    def between(values: Float64) -> Float64:
        s = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1 - s) * values[before] + s * values[after])

    angles = between(motion.angles_rad)
    flips = np.abs(motion.angles_rad[after] - motion.angles_rad[before]) > FLIP_RAD
    nearest = np.where(share < 0.5, before, after)
    angles = np.where(flips.any(axis=2, keepdims=True), motion.angles_rad[nearest], angles)
    if len(motion) > 1:
        turns = Rotation.from_matrix(np.array([rotations(a)[0] for a in motion.angles_rad]))
        angles[:, 0] = euler_rad(Slerp(np.arange(len(motion)), turns)(at)) * (1, -1, 1)
    # Markers have no part in a resampled motion.
    report = replace(
        motion.report,
        names=(),
        error_m=np.empty((frames, 0), np.float32),
        status=np.empty((frames, 0), np.uint8),
    )
    return replace(
        motion,
        angles_rad=angles,
        pelvis_m=between(motion.pelvis_m),
        frames_per_second=frames_per_second,
        report=report,
    )
