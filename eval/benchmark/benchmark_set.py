"""Recording with true joints, and the precision of a network's joints in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, Float64
from annotate.labelset.label_set import LabelSet
from eval.benchmark.mean_precision import MeanPrecision, joint_hits, mean_precision
from eval.network.body_state import BodyState
from eval.scores.joints import JOINT, JOINT_NAMES
from sensors.rig.frame import FrameSource

STANDS_FOR = {
    f"{side}_{theirs}": f"{side}_{own}"
    for side in ("left", "right")
    for theirs, own in (("hand", "wrist"), ("foot", "ankle"))
}
"""Joints of ITOP, and the network's joints that are measured as these."""
TORSO = "torso"  # of ITOP: the middle of neck and hips, to 2 mm in 99 % of 4,863 true frames
TRUE_NAMES = (*JOINT_NAMES, *STANDS_FOR, TORSO)


@dataclass(frozen=True, eq=False)
class BenchmarkSet:
    """Recording with true joints (F, J, 3), metres in depth-camera coordinates; NaN for unknown joints.

    joints: their J names, from ``TRUE_NAMES``. visible: bool (F, J), joints that the frame shows. subjects: F
    names.
    """

    source: FrameSource
    joints: tuple[str, ...]
    true_m: Float64
    visible: Bool
    subjects: tuple[str, ...]

    def precision(self, labels: LabelSet) -> tuple[MeanPrecision, MeanPrecision, int]:
        """Return the precision of a label set's joints: over all true joints, and over the visible ones.

        Third: number of frames with true joints but without a labelled person.
        """
        predicted_m, nobody = np.full(self.true_m.shape, np.nan), np.ones(len(self.true_m), np.bool_)
        for frame_id in labels.frame_ids:
            state = BodyState.from_note(labels.notes(frame_id).get("bearing"))
            if state is not None:
                found_m = state.joints_mm(labels.intrinsics.undistorted()) / 1000
                predicted_m[int(frame_id)] = as_named(found_m, self.joints)
                nobody[int(frame_id)] = False
        hits, counted = joint_hits(predicted_m, self.true_m), np.isfinite(self.true_m[..., 0])
        every, seen = (
            mean_precision(hits, some, self.subjects) for some in (counted, counted & self.visible)
        )
        return every, seen, int((nobody & counted.any(axis=1)).sum())


def as_named(found_m: Float64, names: Sequence[str]) -> Float64:
    """Return the joints (J, 3) called ``names`` from a network's joints (15, 3).

    Wrists stand for hands, ankles for feet; the torso is the middle of neck and hips.
    """
    hips = (found_m[JOINT["left_hip"]] + found_m[JOINT["right_hip"]]) / 2
    torso = (found_m[JOINT["neck"]] + hips) / 2
    return np.stack([torso if n == TORSO else found_m[JOINT[STANDS_FOR.get(n, n)]] for n in names])
