"""Comparison of labelled frames to the bit."""

import numpy as np

from annotate.frame_labels import FrameLabels


def assert_same_frame(got: FrameLabels, expected: FrameLabels, lacks: tuple[str, ...] = ()) -> None:
    """Compare all fields; those in ``lacks`` must be None."""
    for name in ("frame_id", "status", "subject", "notes", "scheme"):
        assert getattr(got, name) == getattr(expected, name)
    for name in ("depth_mm", "parts", "confidence", "persons"):
        before, after = None if name in lacks else getattr(expected, name), getattr(got, name)
        assert (after is None) == (before is None), name
        if before is not None:
            assert after.dtype == before.dtype
            np.testing.assert_array_equal(after, before)
