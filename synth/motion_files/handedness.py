"""Check that a recording is no mirror image: its axes are left-handed, or two were exchanged without a sign.

No turn of the axes mends that, and the solver fits twisted legs to it that are off by millimetres only. Feet
show it: with the left hip on the left, the toes of a mirror image point backwards.
"""

import numpy as np

from annotate.array_types import Bool, Float64, Int64
from synth.body.skeleton import JOINTS

MIRRORED = -0.2
"""Mean of ``feet_ahead`` below which a recording is mirrored. Measured: 0.82 to 0.98 over 96 takes of the CMU
library, 0.28 and more over 15 single poses, 0.17 and more in 20 exercises on the floor; a mirror image has
the negative."""
MIRROR_LINE = (
    "left and right are exchanged (left-handed axes, two axes exchanged, or names): "
    "the recording is mirrored back"
)
FOOT_M = 0.05
"""Distance at least of two places on a foot that show where it points. Untuned."""


def is_mirrored(positions_m: Float64, joint: Int64, at_m: Float64) -> bool:
    """Return whether markers (F, M, 3) in metres are a person's mirror image, as far as the feet show.

    joint, at_m: (M,) and (M, 3) of the marker set.
    """
    ahead = feet_ahead(positions_m, joint, at_m)
    known = ahead[np.isfinite(ahead)]
    return bool(known.size) and float(known.mean()) < MIRRORED


def feet_ahead(positions_m: Float64, joint: Int64, at_m: Float64) -> Float64:
    """Return for both feet (2 F,) how far they point ahead: the volume between directions from right to left,
    up the shank and along the foot; NaN where not seen. People's is positive however they stand or lie."""
    names = np.array([JOINTS[int(j)].name for j in joint])
    side = np.where(np.char.startswith(names, "left_hip"), 1, 0) - np.char.startswith(names, "right_hip")
    side = np.where(names == "pelvis", np.sign(at_m[:, 0]), side)
    across = _middle(positions_m, side > 0) - _middle(positions_m, side < 0)
    found = [np.empty(0)]
    for of in ("left", "right"):
        ends = ends_of_foot(positions_m, names == f"{of}_ankle", at_m)
        if ends is not None:
            knee, ankle = (_middle(positions_m, names == f"{of}_{place}") for place in ("knee", "ankle"))
            foot = positions_m[:, ends[1]] - positions_m[:, ends[0]]
            found.append((np.cross(_unit(across), _unit(knee - ankle)) * _unit(foot)).sum(axis=1))
    return np.concatenate(found)


def ends_of_foot(positions_m: Float64, on_foot: Bool, at_m: Float64) -> tuple[int, int] | None:
    """Return the columns of a foot's hindmost and foremost marker, None where it has no two."""
    columns = np.flatnonzero(on_foot & np.isfinite(positions_m).any(axis=(0, 2)))
    if not len(columns):
        return None
    back, front = columns[np.argmax(at_m[columns, 1])], columns[np.argmin(at_m[columns, 1])]
    return None if np.linalg.norm(at_m[front] - at_m[back]) < FOOT_M else (int(back), int(front))


def _middle(positions: Float64, chosen: Bool) -> Float64:
    """Return the mean (F, 3) of what is seen of the chosen columns, NaN where nothing is."""
    seen = np.isfinite(positions[:, chosen])
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(seen, positions[:, chosen], 0).sum(axis=1) / seen.sum(axis=1))


def _unit(ways: Float64) -> Float64:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))
